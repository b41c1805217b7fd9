"""A valid spec, with its experiment, its text, the files that it names, and its hash."""

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tetractl.core.errors import SpecError, printable
from tetractl.core.shown import NotebookDisplay
from tetractl.core.trial import RESERVED_FILE_NAMES, PlantInfo, Start
from tetractl.spec.controller import ControllerSection
from tetractl.spec.experiment import Experiment, Trials, find_packages
from tetractl.spec.yaml.core_yaml import format_yaml
from tetractl.spec.yaml.document import Document

AttachedFiles = tuple[tuple[str, str], ...]
"""Names and texts of the files that a spec names. The log stores them with the spec."""


@dataclass(frozen=True)
class LoadedSpec(NotebookDisplay):
    """A valid spec: the experiment with `--set` applied, and the spec's original text.

    `resolved`, the YAML with every field, and `hash` are computed once for all trials.

    Attributes:
        experiment: The fields of the spec.
        text: The spec as written.
        name: The file name, without its folder.
        path: The file. None if the spec comes from no file.
        attached: Further files that belong to the spec, as names and texts.
        logged: Data of a resolved spec that tetractl wrote into a log. None for other specs.
        document: The parsed spec, which states the file and line, or the option, from which each
            value comes. None if the spec was not read from text.
    """

    experiment: Experiment
    text: str = field(repr=False)
    name: str  # file name, without its folder
    path: Path | None = None
    attached: AttachedFiles = field(default=(), repr=False)
    logged: Any = field(default=None, repr=False)
    document: Document | None = field(default=None, repr=False, compare=False)

    @cached_property
    def resolved(self) -> str:
        """The complete spec of the experiment as YAML, with every field and its value."""
        return resolved_yaml(self.experiment)

    @cached_property
    def hash(self) -> str:
        """The SHA-256 of the experiment; see `spec_hash`."""
        return spec_hash(self.experiment, self.logged)


def with_controller(spec: LoadedSpec, controller: ControllerSection) -> LoadedSpec:
    """Return a copy of a spec with another controller, without checking the new spec.

    The text of the new spec has every field.
    """
    experiment = spec.experiment.model_copy(update={"controller": controller})
    return LoadedSpec(experiment, resolved_yaml(experiment), spec.name)


def with_seed(spec: LoadedSpec, seed: int) -> LoadedSpec:
    """Return a copy of a spec with another seed. Its text states every field.

    Raises:
        SpecError: If the seed is negative, or is 2**64 or more.
    """
    try:
        trials = Trials(count=spec.experiment.trials.count, seed=seed)
    except ValidationError as error:
        raise SpecError(f"seed: {error.errors()[0]['msg']}") from None
    experiment = spec.experiment.model_copy(update={"trials": trials})
    return LoadedSpec(experiment, resolved_yaml(experiment), spec.name)


def resolved_yaml(experiment: Experiment) -> str:
    """Return a spec with every field as YAML text, which loads as the same experiment."""
    return format_yaml(experiment.model_dump(mode="json"))


def spec_hash(experiment: Experiment, logged: Any = None) -> str:
    """Compute the SHA-256 of an experiment, as 64 hex digits.

    Comments and the order of keys do not change it.

    Args:
        experiment: The experiment.
        logged: Data of the spec in an earlier log. If it is given, only the keys that it contains
            are hashed, because later versions may have more keys. None to hash all keys.
    """
    # -0.0 equals 0.0 but is written differently; adding 0.0 turns it into 0.0
    fields = json.loads(experiment.model_dump_json(), parse_float=lambda text: float(text) + 0.0)
    if logged is not None:
        fields = _with_logged_keys(fields, logged)
    canonical = json.dumps(fields, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _with_logged_keys(fields: Any, logged: Any) -> Any:
    """Restrict the fields of a spec to the keys of a logged spec, at every depth.

    This removes fields that were added to tetractl later. If a logged key is unknown now, its
    logged value is kept.
    """
    if isinstance(fields, dict) and isinstance(logged, dict):
        return {
            key: _with_logged_keys(fields[key], value) if key in fields else value
            for key, value in logged.items()
        }
    both_lists = isinstance(fields, list) and isinstance(logged, list)
    if both_lists and len(fields) == len(logged):
        return [
            _with_logged_keys(*field_and_logged)
            for field_and_logged in zip(fields, logged, strict=True)
        ]
    return fields


def arm_hash(experiment: Experiment) -> str:
    """Compute the hash of an experiment without its number of trials.

    The number of trials does not affect any single trial.
    """
    trials = experiment.trials.model_copy(update={"count": 1})
    return spec_hash(experiment.model_copy(update={"trials": trials}))


def create_start(spec: LoadedSpec, trial: int, plant: PlantInfo, start_unix_ns: int) -> Start:
    """Create the record of a trial's start from its spec.

    Args:
        spec: The spec of the trial.
        trial: Index of the trial, from 0.
        plant: Description of the plant. It can be replaced once the plant is opened.
        start_unix_ns: When the trial starts [ns since 1970].
    """
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
        packages=find_packages(experiment),
    )


def attach_file(attached: AttachedFiles, path: Path, text: str) -> AttachedFiles:
    """Add a file to the files that are attached to a log.

    Args:
        attached: The files that are already attached.
        path: The new file.
        text: Its contents.

    Raises:
        SpecError: If the log already has a file with this name.
    """
    name = printable(path.name)
    if name in RESERVED_FILE_NAMES or name in dict(attached):
        raise SpecError(
            f"{printable(str(path))}: every log already has a file named {name}",
            "rename this file",
        )
    return (*attached, (name, text))
