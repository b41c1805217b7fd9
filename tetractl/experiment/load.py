"""Converts a spec's text to an Experiment and back; reports all problems at once.

The way of a value from a file to the experiment:

    read_document          the file's data, with the place of each value (`yaml.document`)
    with_settings          values of `--set` and other options take their places (`yaml.settings`)
    _with_identified       values of the file of `tetractl identify`, if the spec names one
    _with_weights          layers of the file of a policy's weights, if the spec names one
    validated_experiment   sections, or pydantic's errors in plain words (`explain`); then the rules
                           between sections (`consistency`)

Problems of settings, values and rules are collected, and raised together with their places; a file
that cannot be read is an error at once.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tetractl.core.commands import PlantInfo
from tetractl.core.errors import SpecError, printable
from tetractl.core.registries import CONTROLLERS
from tetractl.core.trial import OWN_FILES, Start
from tetractl.experiment.base import with_tuples
from tetractl.experiment.consistency import errors_of
from tetractl.experiment.controller import ControllerSection, with_logged_keys, without_retired
from tetractl.experiment.experiment import (
    DEFAULT_CONTROLLER,
    Experiment,
    Trials,
    packages,
)
from tetractl.experiment.explain import explain
from tetractl.experiment.identified import merge, read_identified
from tetractl.experiment.policy_weights import put_layers, read_weights
from tetractl.experiment.registry_fields import STRICT
from tetractl.experiment.schema import schema_of
from tetractl.experiment.yaml.core_yaml import dump
from tetractl.experiment.yaml.document import Document, parse_document, read_document
from tetractl.experiment.yaml.problems import InvalidSpecError, SpecProblem
from tetractl.experiment.yaml.settings import SpecSetting, copied, with_settings

Attached = tuple[tuple[str, str], ...]
"""Names and texts of the files that a spec names, which the log stores with it."""


@dataclass(frozen=True)
class LoadedSpec:
    """A valid spec: the experiment with `--set` applied, and the spec's original text.

    `resolved`, its YAML with every field, and `hash` are computed once, for all trials. `logged` is
    the data of a resolved spec that tetractl has written into a log.
    """

    experiment: Experiment
    text: str = field(repr=False)
    name: str  # file name, without its folder
    path: Path | None = None
    attached: Attached = field(default=(), repr=False)
    logged: Any = field(default=None, repr=False)

    @cached_property
    def resolved(self) -> str:
        """The experiment's spec as YAML with every field, by `resolved_yaml`."""
        return resolved_yaml(self.experiment)

    @cached_property
    def hash(self) -> str:
        """The SHA-256 of the experiment, by `spec_hash`."""
        return spec_hash(self.experiment, self.logged)


def load_document(document: Document, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check a parsed spec, which stays as it is; settings replace its values.

    The files that it names are in the folder of its own file; a spec that comes from no file must
    not name any. Raises InvalidSpecError with one line per problem: `file:line:column: field:
    value: what is wrong; what would be right`.
    """
    settled = with_settings(document, settings)
    _refuse_study(settled)
    attached: Attached = ()
    name = document.origin
    if document.path is None:
        _refuse_named_files(settled)
    else:
        name = printable(document.path.name)
        folder = document.path.parent
        identified_file = _identified_file(settled)
        if identified_file is not None:
            path = folder / identified_file
            estimates = _estimates(settled)
            settled, attached = _with_identified(document, path, settings, estimates)
        attached = _with_weights(settled, folder, attached)
    experiment = validated_experiment(settled, written=False)
    return LoadedSpec(experiment, document.text, name, document.path, attached)


def load_spec(path: Path, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Read and check a spec file, as `load_document` does."""
    return load_document(read_document(path), settings)


def parse_spec(text: str, name: str, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check the text of a spec, as `load_document` does; `name` is its name in error messages.

    The spec must not name a file, as there is no folder to find it in.
    """
    return load_document(parse_document(text, name), settings)


def parse_written(text: str, name: str, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check a resolved spec that tetractl has written into a log.

    Its places are not checked: a trial may have measured them.
    """
    document = with_settings(parse_document(text, name), settings)
    _refuse_study(document)
    _refuse_named_files(document)
    logged = deepcopy(document.data)
    without_retired(document.data)
    experiment = validated_experiment(document, written=True)
    return LoadedSpec(experiment, text, name, logged=logged)


def parse_contents(
    contents: Mapping[str, Any], name: str, settings: Sequence[SpecSetting] = ()
) -> LoadedSpec:
    """Check a spec given as its contents, as `parse_spec` does; problems name fields, but no lines,
    which no file has."""
    text = as_text(contents, name)
    with without_lines():
        return parse_spec(text, name, settings)


@contextmanager
def without_lines() -> Iterator[None]:
    """Raise the problems of contents again, without the lines that no file has."""
    try:
        yield
    except InvalidSpecError as error:
        problems = [replace(problem, line=None, column=None) for problem in error.problems]
        raise InvalidSpecError(problems, error.hint) from None


def with_controller(spec: LoadedSpec, controller: ControllerSection) -> LoadedSpec:
    """Return a spec with another controller, unchecked; its text has every field."""
    experiment = spec.experiment.model_copy(update={"controller": controller})
    return LoadedSpec(experiment, resolved_yaml(experiment), spec.name)


def with_seed(spec: LoadedSpec, seed: int) -> LoadedSpec:
    """Return a spec whose random numbers have another seed; its text has every field. Raises
    SpecError for a wrong seed."""
    try:
        trials = Trials(count=spec.experiment.trials.count, seed=seed)
    except ValidationError as error:
        raise SpecError(f"seed: {error.errors()[0]['msg']}") from None
    experiment = spec.experiment.model_copy(update={"trials": trials})
    return LoadedSpec(experiment, resolved_yaml(experiment), spec.name)


def as_text(contents: Mapping[str, Any], name: str) -> str:
    """Return contents as YAML text; SpecError if they hold an object that YAML does not."""
    try:
        return json.dumps(contents)
    except (TypeError, ValueError) as error:
        hint = "give text, numbers, lists and dicts, such as array.tolist()"
        raise SpecError(f"{name}: {printable(str(error), 200)}", hint) from None


def resolved_yaml(experiment: Experiment) -> str:
    """Return a spec with every field as YAML text, which loads as the same experiment."""
    return dump(experiment.model_dump(mode="json"))


def spec_hash(experiment: Experiment, logged: Any = None) -> str:
    """Return the SHA-256 of the experiment, as 64 hex digits; comments and order do not count. Of
    an earlier log it is that of the keys of its resolved spec, `logged`."""
    # -0.0 equals 0.0 but is written differently; adding 0.0 turns it into 0.0
    fields = json.loads(experiment.model_dump_json(), parse_float=lambda text: float(text) + 0.0)
    if logged is not None:
        fields = with_logged_keys(fields, logged)
    canonical = json.dumps(fields, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def arm_hash(experiment: Experiment) -> str:
    """Return the hash of an experiment without its number of trials, which affects no trial."""
    trials = experiment.trials.model_copy(update={"count": 1})
    return spec_hash(experiment.model_copy(update={"trials": trials}))


def start_of(spec: LoadedSpec, trial: int, plant: PlantInfo, start_unix_ns: int) -> Start:
    """Return the start record of a trial; its `plant` may be replaced once the plant is opened."""
    experiment = spec.experiment
    return Start(
        setup=experiment.setup,
        spec_text=spec.text,
        spec_name=spec.name,
        resolved=spec.resolved,
        spec_hash=spec.hash,
        seed=experiment.trials.seed,
        trial=trial,
        plant=plant,
        start_unix_ns=start_unix_ns,
        attached=spec.attached,
        packages=packages(experiment),
    )


def attach(attached: Attached, path: Path, text: str) -> Attached:
    """Return the attached files and the further file `path`; SpecError if a file with its name is
    attached to the log already."""
    name = printable(path.name)
    if name in OWN_FILES or name in dict(attached):
        raise SpecError(
            f"{printable(str(path))}: every log already has a file named {name}",
            "rename this file",
        )
    return (*attached, (name, text))


def _refuse_study(document: Document) -> None:
    if "base" in document.data and "robots" not in document.data:
        hint = f"run it with: tetractl study {document.origin}"
        raise InvalidSpecError([SpecProblem(document.origin, "is a study, not a spec")], hint)


def _identified_file(document: Document) -> str | None:
    """Return the name of the file with identified values, None if the spec names none."""
    name = document.data.get("identified")
    return name if isinstance(name, str) else None


def _weights_file(document: Document) -> str | None:
    """Return the name of the file with a policy's weights, None if the spec names none or has them
    itself.
    """
    controller = document.data.get("controller")
    if not isinstance(controller, dict) or "layers" in controller:
        return None
    name = controller.get("weights")
    return name if isinstance(name, str) else None


def _refuse_named_files(document: Document) -> None:
    """Add a problem for each file that is named, as there is no folder to find it in."""
    files = {
        ("identified",): _identified_file(document),
        ("controller", "weights"): _weights_file(document),
    }
    for loc, name in files.items():
        if name is not None:
            place = document.place(loc)
            message = "can be named only in a spec file"
            document.problems.append(place.problem(loc, message, place.text))


def _estimates(document: Document) -> bool:
    """Return whether a document's controller identifies robots while it drives: by its field
    `estimate` or, where that is not given, by the default of its kind."""
    controller = document.data.get("controller", {})
    if not isinstance(controller, dict):
        return False
    kind = controller.get("type", DEFAULT_CONTROLLER)
    if not isinstance(kind, str) or kind not in CONTROLLERS:
        return False
    field_of_kind = CONTROLLERS.load(kind).model_fields.get("estimate")
    by_default = field_of_kind is not None and field_of_kind.default
    return controller.get("estimate", by_default) is True


def _with_identified(
    document: Document, path: Path, settings: Sequence[SpecSetting], estimates: bool
) -> tuple[Document, Attached]:
    """Return the spec's data with the values of the file of identified values, then the settings;
    and the file for the log. `estimates` is as in `merge`.
    """
    identified, text = read_identified(path)
    merged = copied(document)
    merge(merged, identified, str(path), estimates)
    settled = with_settings(merged, settings)
    del settled.data["identified"]  # its values are now in the spec
    return settled, attach((), path, text)


def _with_weights(document: Document, folder: Path, attached: Attached) -> Attached:
    """Put the layers of a policy's file of weights, if the spec names one, into the document, and
    return the attached files with that file."""
    name = _weights_file(document)
    if name is None:
        return attached
    path = folder / name
    layers, text = read_weights(path)
    put_layers(document, layers, str(path))
    return attach(attached, path, text)


def validated_experiment(document: Document, written: bool) -> Experiment:
    """Return the experiment of a document; InvalidSpecError with all its wrong values at once or,
    if there are none, with all that contradicts each other."""
    try:
        experiment = Experiment.model_validate(
            with_tuples(document.data), strict=True, context=STRICT
        )
    except ValidationError as error:
        document.problems.extend(explain(error, document, schema_of(Experiment)))
        raise InvalidSpecError(document.all_problems) from None
    for error in errors_of(experiment, written):
        place = document.place(error.where)
        document.problems.append(place.problem(error.where, error.text, place.text))
    if document.all_problems:
        raise InvalidSpecError(document.all_problems)
    return experiment
