"""Converts a spec's text to an Experiment and back; reports all problems at once."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from tetractl.core.commands import PlantInfo
from tetractl.core.errors import SpecError, printable
from tetractl.core.trial import OWN_FILES, Start
from tetractl.experiment.consistency import Entries, errors_of
from tetractl.experiment.controller import ControllerSection, as_given, without_retired
from tetractl.experiment.experiment import Arena, Experiment, Obstacle, Robot, Trials
from tetractl.experiment.explain import explain
from tetractl.experiment.identified import Identified, merge, read_identified
from tetractl.experiment.policy_weights import put_layers, read_weights
from tetractl.experiment.registry_fields import STRICT, packages
from tetractl.experiment.yaml.core_yaml import MAX_DEPTH, dump
from tetractl.experiment.yaml.document import (
    Document,
    Place,
    frozen,
    parse_document,
    parse_value,
    read_text,
)
from tetractl.experiment.yaml.problems import InvalidSpecError, SpecProblem


def override(document: Document, setting: str) -> None:
    """Apply one `path=value` setting to a document; add errors to the document's problems.

    A step of the path is a key, an index, or the `name` of an entry: `robots.0.a`,
    `robots.green.a`. Mappings that the spec omits are created.
    """
    place = Place(f"--set {printable(setting, 200)}")
    path, equals, text = setting.partition("=")
    steps = path.strip().split(".")
    try:
        if not equals or not path.strip():
            message = "must be PATH=VALUE, for instance controller.optimizer.particles=200"
            raise InvalidSpecError([place.problem((), message)])
        if len(steps) > MAX_DEPTH:
            message = f"the path has more than {MAX_DEPTH} steps"
            raise InvalidSpecError([place.problem((), message)])
        holder, loc = document.holder(steps, place)
        value = parse_value(text, place.origin, loc)
    except InvalidSpecError as error:
        document.problems.extend(error.problems)
        return
    document.put(holder, loc, value, replace(place, text=printable(text, 60) or None))


Attached = tuple[tuple[str, str], ...]
"""Names and texts of the files that a spec names, which the log stores with it."""


@dataclass(frozen=True)
class LoadedSpec:
    """A valid spec: the experiment with `--set` applied, and the spec's original text.

    `resolved`, its YAML with every field, and `hash` are computed once, for all trials. `given` is
    the data of a resolved spec that tetractl has written.
    """

    experiment: Experiment
    text: str = field(repr=False)
    name: str  # file name, without its folder
    path: Path | None = None
    attached: Attached = field(default=(), repr=False)
    given: Any = field(default=None, repr=False)

    @cached_property
    def resolved(self) -> str:
        """The experiment's spec as YAML with every field, by `resolved_yaml`."""
        return resolved_yaml(self.experiment)

    @cached_property
    def hash(self) -> str:
        """The SHA-256 of the experiment, by `spec_hash`."""
        return spec_hash(self.experiment, self.given)


def load_spec(path: Path, sets: Sequence[str] = ()) -> LoadedSpec:
    """Read and check a spec file; `path=value` settings replace its values.

    Raises InvalidSpecError with one line per problem: `file:line:column: field: value: what is
    wrong; what would be right`.
    """
    text = read_text(path)
    experiment, attached, _ = _experiment(text, str(path), sets, path.parent)
    return LoadedSpec(experiment, text, printable(path.name), path, attached)


def parse_spec(text: str, name: str, sets: Sequence[str] = (), written: bool = False) -> LoadedSpec:
    """Check the text of a spec, as `load_spec` does; `name` is its name in error messages.

    The spec must not name a file, as there is no folder to find it in. The
    places of a resolved spec that tetractl has `written` are not checked: a trial may have measured
    them.
    """
    experiment, _, given = _experiment(text, name, sets, None, written)
    return LoadedSpec(experiment, text, name, given=given)


def parse_contents(contents: Mapping[str, Any], name: str, sets: Sequence[str] = ()) -> LoadedSpec:
    """Check a spec given as its contents, as `parse_spec` does; problems name fields, but no lines,
    which no file has."""
    text = as_text(contents, name)
    with without_lines():
        return parse_spec(text, name, sets)


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


def spec_hash(experiment: Experiment, given: Any = None) -> str:
    """Return the SHA-256 of the experiment, as 64 hex digits; comments and order do not count. Of
    an earlier log it is that of the keys `given` in its resolved spec."""
    # -0.0 equals 0.0 but is written differently; adding 0.0 turns it into 0.0
    fields = json.loads(experiment.model_dump_json(), parse_float=lambda text: float(text) + 0.0)
    if given is not None:
        fields = as_given(fields, given)
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


def document_of(
    text: str, origin: str, sets: Sequence[str], identified: tuple[Identified, str] | None = None
) -> Document:
    """Parse the text of a spec and apply `sets`.

    Values `identified` in a file replace the text's values before `sets` are applied. Errors are
    added to the document's problems; InvalidSpecError if the text cannot be read as YAML.
    """
    document = parse_document(text, origin)
    if identified is not None:
        merge(document, *identified)
    for setting in sets:
        override(document, setting)
    return document


def _experiment(
    text: str, origin: str, sets: Sequence[str], folder: Path | None, written: bool = False
) -> tuple[Experiment, Attached, Any]:
    """Return the experiment, the texts of files in `folder` that the spec names, and what is given
    in a spec that tetractl has `written`."""
    document, given = document_of(text, origin, sets), None
    if written:
        given = deepcopy(document.data)
        without_retired(document.data)
    if "base" in document.data and "robots" not in document.data:
        hint = f"run it with: tetractl study {origin}"
        raise InvalidSpecError([SpecProblem(origin, "is a study, not a spec")], hint)
    attached: Attached = ()
    named = document.data.get("identified")
    if isinstance(named, str) and folder is None:
        place = document.place(("identified",))
        message = "can be named only in a spec file"
        document.problems.append(place.problem(("identified",), message, place.text))
    elif isinstance(named, str) and folder is not None:
        path = folder / named
        found, held = read_identified(path)
        attached = attach((), path, held)
        document = document_of(text, origin, sets, (found, str(path)))
        del document.data["identified"]  # its values are now in the spec
    attached = _with_weights(document, folder, attached)
    experiment = None
    try:
        experiment = Experiment.model_validate(frozen(document.data), strict=True, context=STRICT)
    except ValidationError as error:
        document.problems.extend(explain(error, document))
    for error in errors_of(_valid_entries(document.data), experiment, written):
        place = document.place(error.where)
        document.problems.append(place.problem(error.where, error.text, place.text))
    if document.found or experiment is None:
        raise InvalidSpecError(document.found)
    return experiment, attached, given


def _with_weights(document: Document, folder: Path | None, attached: Attached) -> Attached:
    """Put the layers of a policy's file of weights, if the spec names one, into the document, and
    return the attached files with that file."""
    controller = document.data.get("controller")
    if not isinstance(controller, dict) or "layers" in controller:
        return attached
    named = controller.get("weights")
    if not isinstance(named, str):
        return attached
    if folder is None:
        loc = ("controller", "weights")
        place = document.place(loc)
        document.problems.append(place.problem(loc, "can be named only in a spec file", place.text))
        return attached
    path = folder / named
    layers, text = read_weights(path)
    put_layers(document, layers, str(path))
    return attach(attached, path, text)


def _valid_entries(data: dict[str, Any]) -> Entries:
    """Return the valid arena, robots and obstacles, even if other parts of the spec are invalid."""

    def valid(kind: Any, values: Any) -> Iterator[tuple[int, Any]]:
        adapter = TypeAdapter(kind)
        for i, value in enumerate(values if isinstance(values, list) else ()):
            try:
                yield i, adapter.validate_python(frozen(value), strict=True, context=STRICT)
            except ValidationError:
                continue

    arena = dict(valid(Arena, [data.get("arena")])).get(0)
    robots = dict(valid(Robot, data.get("robots")))
    return Entries(arena, robots, dict(valid(Obstacle, data.get("obstacles"))))
