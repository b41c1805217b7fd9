"""Load a study's file, which describes many variants of a spec, and report all its problems.

A variant is called an arm: the combination of one point of the sweep with one controller. In the
order of the arms,

    _combinations      yields the combinations
    _load_arm          loads the base spec with the settings of a combination, and checks the spec
    _locate_in_study   reports a problem of this spec at the setting that causes it

and then `_disagreements` looks for problems that concern several arms.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag

from tetractl.core.errors import printable
from tetractl.core.registries import SWEEPS
from tetractl.run.store import BatchFolder, Store
from tetractl.run.task import code_hash
from tetractl.spec.base import Model, Name, validate_document
from tetractl.spec.experiment import Trials
from tetractl.spec.load import format_as_json, is_study, load_document, omit_line_numbers
from tetractl.spec.loaded_spec import LoadedSpec, arm_hash
from tetractl.spec.registry_fields import KindSection
from tetractl.spec.yaml.document import Document, parse_document, read_document
from tetractl.spec.yaml.problems import (
    InvalidSpecError,
    Loc,
    SpecProblem,
    format_loc,
    suggest_files,
)
from tetractl.spec.yaml.settings import SpecSetting
from tetractl.study.sweep import FieldPath, Setting, Sweep

ARMS_MAX = 100_000
"""Maximum number of arms of a study."""
NAME_LENGTH_MAX = 100
"""Maximum length of the name of an arm's folder [characters], far below that of file systems."""
SWEEP_SPAWN_KEY = (0,)
"""Spawn key of a sweep's random numbers. The spawn keys of trials have two numbers."""


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm of a study: the spec of its trials, and its differences from the study's base spec.

    Attributes:
        name: Name of the arm and of its folder.
        controller: Name of the arm's controller. Empty if the study names no controllers.
        values: Values of the swept fields, by path.
        sets: Differences from the base spec, in the form of `--set`.
        spec: The spec of the arm's trials.
        hash: SHA-256 of the experiment without the number of trials.
        code_hash: Hash of the code that runs the arm's trials.
    """

    name: str
    controller: str
    values: Mapping[str, Any]
    sets: tuple[str, ...]
    spec: LoadedSpec
    hash: str
    code_hash: str


def arm_name(controller: str, values: Mapping[str, Any]) -> str:
    """Compose the name of an arm and of its folder, such as `ours-dead_time=0.07`.

    Fields are named by the last part of their paths, or all by their whole paths if two would have
    the same name. Characters that a file name may not have become `_`, and the name is cut after
    `NAME_LENGTH_MAX` characters. An arm without controller and values is `base`.
    """
    last_parts = [path.rpartition(".")[2] for path in values]
    are_unique = len(set(last_parts)) == len(last_parts)
    paths = last_parts if are_unique else list(values)
    name_parts = [controller] if controller else []
    name_parts += [
        f"{path}={format_value(value)}" for path, value in zip(paths, values.values(), strict=True)
    ]
    name = re.sub(r"[^A-Za-z0-9._=+-]+", "_", "-".join(name_parts))
    return name[:NAME_LENGTH_MAX].lstrip(".-") or "base"


def format_value(value: Any) -> str:
    """Format a value of a swept field for people.

    Floats get six significant digits, strings stay as they are, and a list of mappings is
    replaced by its length. Any other value is written as YAML in one line.
    """
    if isinstance(value, float):
        return f"{value:.6g}"  # significant digits of a number in a name or a figure
    if isinstance(value, list | tuple) and value and isinstance(value[0], dict):
        return f"{len(value)}"  # the length of a list such as `robots`
    return value if isinstance(value, str) else as_yaml(value)


def as_yaml(value: Any) -> str:
    """Format a value as YAML in one line, as in `--set`."""
    return json.dumps(value, ensure_ascii=False)  # JSON is YAML


class Study(Model):
    """A study, which compares many variants of a spec, as read from a YAML file.

    Each point of the sweep is run with each controller; such a combination is an *arm*. All arms
    have the same seeds, so trials with the same number in two arms have the same disturbances, and
    are compared in pairs.
    """

    name: str = Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """Name of the study and of its folder: letters without accents (a to z, A to Z), digits, dots,
    underscores and hyphens, starting with a letter or digit."""
    description: str = ""
    """Description in one or two sentences."""
    base: Annotated[
        Annotated[str, Field(min_length=1, max_length=1000), Tag("file")]
        | Annotated[dict[str, Any], Tag("contents")],
        Discriminator(lambda base: "contents" if isinstance(base, dict) else "file"),
    ]
    """Path of the spec that every arm changes, relative to the study's file. In Python, also the
    spec's contents.
    """
    sweep: Annotated[Sweep, KindSection(SWEEPS, Sweep)] | None = None
    """The swept fields with their values. Without a sweep, the base's values are used."""
    controllers: dict[Name, dict[FieldPath, Any]] = Field(default={}, max_length=1000)
    """The controllers to compare, by name. Each is a mapping of paths to values, which are set
    before the sweep's values.
    """
    trials: Trials = Trials()
    """Number and seed of the trials of each arm. Those of the base are ignored."""


@dataclass(frozen=True, slots=True)
class LoadedStudy:
    """A study that was read and is valid, with its arms, the variants of its experiment."""

    study: Study
    arms: tuple[Arm, ...]

    @property
    def unit(self) -> str:
        """The length unit that all arms of the study share."""
        return self.arms[0].spec.experiment.units.length

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths of the fields that the study varies, such as `plant.dead_time`."""
        return tuple(dict.fromkeys(path for arm in self.arms for path in arm.values))

    def store(self, folder: Path) -> Store:
        """Return the store of the study, with the folder of each arm."""
        batches = {
            arm.name: BatchFolder(folder / arm.name, arm.spec.experiment) for arm in self.arms
        }
        return Store(folder, batches)


def load_study(
    source: Path | Mapping[str, Any], settings: Sequence[SpecSetting] = ()
) -> LoadedStudy:
    """Read and check a study, and the spec of every arm.

    A problem is located in the study if a value of the study causes it, and in the base spec if
    that is invalid by itself.

    Args:
        source: A file, or its contents.
        settings: Values that replace others last in every arm.

    Raises:
        InvalidSpecError: With one line for each problem.
    """
    if isinstance(source, Path):
        return _check_and_load(read_document(source), source.parent, settings)
    document = parse_document(format_as_json(source, "study"), "study")
    with omit_line_numbers():
        return _check_and_load(document, Path(), settings)


def _check_and_load(
    document: Document, folder: Path, settings: Sequence[SpecSetting]
) -> LoadedStudy:
    """Check a study, and load its arms.

    The path of the base spec is relative to `folder`.

    Raises:
        InvalidSpecError: If the study, its base or an arm is invalid, or if arms disagree.
    """
    study = _check_study(document)
    arms = _load_arms(study, _load_base(study, document, folder), document, settings)
    disagreements = list(dict.fromkeys(_disagreements(arms, document)))
    if disagreements:
        raise InvalidSpecError(disagreements)
    return LoadedStudy(study, tuple(_with_unique_names(arms)))


def _load_base(study: Study, document: Document, folder: Path) -> Document:
    """Return the base spec of a study, which every arm changes.

    It comes from a file, or is part of the study.

    Raises:
        InvalidSpecError: If it cannot be read.
    """
    if isinstance(study.base, dict):
        return parse_document(format_as_json(study.base, "base"), "base")
    path = folder / study.base
    if not path.exists():
        message = f"there is no file {printable(str(path))}{suggest_files(path)}"
        raise InvalidSpecError([document.problem_at(("base",), message, _base_file_name(study))])
    base = read_document(path)
    if is_study(base):
        message = "is a study, but the base of a study must be a spec"
        raise InvalidSpecError([document.problem_at(("base",), message, _base_file_name(study))])
    return base


def _base_file_name(study: Study) -> str | None:
    """Return the name of the base spec's file, for problems with the whole base spec.

    The result is None if the study itself contains the base spec.
    """
    return None if isinstance(study.base, dict) else printable(Path(study.base).name)


def _load_arms(
    study: Study, base: Document, document: Document, settings: Sequence[SpecSetting]
) -> list[Arm]:
    """Return all arms of a study, one for each combination of its values.

    Raises:
        InvalidSpecError: With the problems of all arms, each once. Its hint names the first arm
            with a problem that its settings cause in the base.
    """
    arms: list[Arm] = []
    problems: dict[SpecProblem, None] = {}
    hint: str | None = None
    for controller, point in _combinations(study, document):
        try:
            arms.append(_load_arm(base, study, controller, point, document, settings))
        except InvalidSpecError as error:
            problems |= dict.fromkeys(error.problems)
            in_base = any(problem.origin != document.origin for problem in error.problems)
            if hint is None and in_base and (point or study.controllers.get(controller)):
                name = arm_name(controller, _values_by_path(point))
                hint = f"in the arm {name} of {document.origin}"
    if problems:
        raise InvalidSpecError(problems, hint)
    return arms


def _check_study(document: Document) -> Study:
    """Check a document, and return the study that it describes.

    Raises:
        InvalidSpecError: If it is invalid, or a spec.
    """
    if "robots" in document.data and "base" not in document.data:
        origin = document.origin
        hint = f"run it with: tetractl run {origin}; a study names it in its field 'base:'"
        raise InvalidSpecError([SpecProblem(origin, "is a spec, not a study")], hint)
    study = validate_document(Study, document)
    document.require_no_problems()
    return study


def _combinations(study: Study, document: Document) -> Iterable[tuple[str, Mapping[str, Setting]]]:
    """Yield each controller's name with each point of the sweep, controller by controller.

    The name is "" if the study lists no controllers. An `InvalidSpecError` is raised if there
    are more than ARMS_MAX combinations.
    """
    points = _sweep_points(study)
    controllers = study.controllers or {"": {}}
    arm_count = len(points) * len(controllers)
    if arm_count > ARMS_MAX:
        message = f"gives {arm_count} arms, but a study can have at most {ARMS_MAX}"
        raise InvalidSpecError([document.problem_at(("sweep",), message)])
    return product(controllers, points)


def _sweep_points(study: Study) -> list[Mapping[str, Setting]]:
    """Return the points of the sweep, generated with the study's seed.

    Without a sweep, there is one point that sets nothing.
    """
    if study.sweep is None:
        return [{}]
    seeds = np.random.SeedSequence(study.trials.seed, spawn_key=SWEEP_SPAWN_KEY)
    return study.sweep.draw(np.random.default_rng(seeds))


def _values_by_path(point: Mapping[str, Setting]) -> dict[str, Any]:
    """Return the values of the swept fields at a point of the sweep, keyed by path."""
    return {path: setting.value for path, setting in point.items()}


def _load_arm(
    base: Document,
    study: Study,
    controller: str,
    point: Mapping[str, Setting],
    document: Document,
    settings: Sequence[SpecSetting],
) -> Arm:
    """Return one arm of a study, with its complete spec.

    Raises:
        InvalidSpecError: With locations in the study, if its settings are invalid.
    """
    fields = study.controllers.get(controller, {})
    located_values = [
        (path, value, ("controllers", controller, path)) for path, value in fields.items()
    ]
    located_values += [
        (path, setting.value, ("sweep", *setting.loc)) for path, setting in point.items()
    ]
    settings_texts: list[str] = []
    locations: dict[str, Loc] = {}  # of the settings in the study, by the origin a problem names
    for path, value, loc in located_values:
        if path.split(".")[0] == "trials":
            message = "cannot be swept; set count and seed in the study's 'trials:'"
            raise InvalidSpecError([document.problem_at(loc, message)])
        settings_texts.append(f"{path}={as_yaml(value)}")
        locations[f"--set {printable(settings_texts[-1], 200)}"] = loc
    trials_settings = (f"trials.count={study.trials.count}", f"trials.seed={study.trials.seed}")
    try:
        # contents have no lines that a problem could name
        with omit_line_numbers() if isinstance(study.base, dict) else nullcontext():
            spec = load_document(base, (*settings_texts, *trials_settings, *settings))
    except InvalidSpecError as error:
        problems = [_locate_in_study(problem, locations, document) for problem in error.problems]
        raise InvalidSpecError(problems) from None
    if not spec.experiment.plant.simulated:
        message = (
            "runs in a lab, but a study can only simulate: name a spec whose plant has 'type: sim'"
        )
        raise InvalidSpecError([document.problem_at(("base",), message, _base_file_name(study))])
    values = _values_by_path(point)
    return Arm(
        name=arm_name(controller, values),
        controller=controller,
        values=values,
        sets=tuple(settings_texts),
        spec=spec,
        hash=arm_hash(spec.experiment),
        code_hash=code_hash(spec.experiment),
    )


def _locate_in_study(
    problem: SpecProblem, locations: Mapping[str, Loc], document: Document
) -> SpecProblem:
    """Locate a problem of an arm's spec in the study, if a setting of the study causes it.

    `locations` are the locations of the settings, by the origin that a problem names.
    """
    loc = locations.get(problem.origin)
    if loc is None:
        return problem
    in_list = isinstance(loc[-1], int)
    path = str(loc[-2] if in_list else loc[-1])
    message = problem.message
    if problem.field not in ("", path):
        message = f"{problem.field}: {message}"
    located = document.problem_at(loc, message, problem.value)
    return replace(located, field=format_loc(loc))


def _disagreements(arms: list[Arm], document: Document) -> Iterable[SpecProblem]:
    """Yield a problem if the length units of arms differ, and one for each repeated arm."""
    units = dict.fromkeys(arm.spec.experiment.units.length for arm in arms)
    if len(units) > 1:
        message = f"has arms in {' and '.join(units)}, but all arms must have the same length unit"
        yield document.problem_at(("sweep",), message)
    arm_by_key: dict[tuple[str, str], Arm] = {}
    for arm in arms:
        earlier = arm_by_key.setdefault((arm.controller, arm.hash), arm)
        if earlier is not arm:
            message = (
                f"gives the arm {arm.name} twice, the second time as {earlier.name}; remove "
                "one of them"
            )
            yield document.problem_at(("sweep",), message)


def _with_unique_names(arms: list[Arm]) -> Iterable[Arm]:
    """Yield the arms of a study with unique names, in their order.

    The first eight digits of an arm's hash are added to each name that several arms share.
    Upper and lower case count as the same.
    """
    name_counts = Counter(arm.name.lower() for arm in arms)  # some file systems ignore case
    for arm in arms:
        is_shared = name_counts[arm.name.lower()] > 1
        yield replace(arm, name=f"{arm.name}-{arm.hash[:8]}") if is_shared else arm
