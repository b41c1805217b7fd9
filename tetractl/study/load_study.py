"""Loads a study's file and its arms, and reports all problems at once.

An arm is the combination of one point of the sweep with one controller.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag

from tetractl.core.errors import SpecError, printable
from tetractl.core.registries import SWEEPS
from tetractl.experiment.base import Model, Name
from tetractl.experiment.experiment import Trials
from tetractl.experiment.explain import validated
from tetractl.experiment.load import (
    LoadedSpec,
    arm_hash,
    as_text,
    load_document,
    without_lines,
)
from tetractl.experiment.registry_fields import KindSection
from tetractl.experiment.schema import schema_of
from tetractl.experiment.yaml.document import Document, parse_document, read_document
from tetractl.experiment.yaml.problems import InvalidSpecError, Loc, SpecProblem, dotted, near_files
from tetractl.run.store import BatchFolder, Store
from tetractl.run.task import code_of
from tetractl.run.trial_limits import check
from tetractl.study.sweep import FieldPath, Setting, Sweep


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm of a study: the spec of its trials, and its differences from the study's base spec.

    `values` has the values of the swept fields by path. `hash` is the SHA-256 of the experiment
    without the number of trials.
    """

    name: str  # name of the arm's folder
    controller: str  # "" if the study names none
    values: Mapping[str, Any]
    sets: tuple[str, ...]  # differences from the base, in the form of `--set`
    spec: LoadedSpec
    hash: str
    code: str  # hash of the code that runs its trials


def arm_name(controller: str, values: Mapping[str, Any]) -> str:
    """Return the name of an arm and of its folder, such as `ours-dead_time=0.07`.

    A field is named by the last part of its path if that is unique, otherwise by the whole path.
    """
    ends = [path.rpartition(".")[2] for path in values]
    paths = ends if len(set(ends)) == len(ends) else list(values)
    words = [controller] * bool(controller)
    words += [f"{path}={shown(value)}" for path, value in zip(paths, values.values(), strict=True)]
    # largest length of a folder's name, far below the limit of file systems
    name = re.sub(r"[^A-Za-z0-9._=+-]+", "_", "-".join(words))[:100]
    return name.lstrip(".-") or "base"


def shown(value: Any) -> str:
    """Return a value as text: numbers with six digits, a list of mappings as its length."""
    if isinstance(value, float):
        return f"{value:.6g}"  # significant digits of a number in a name or a figure
    if isinstance(value, list | tuple) and value and isinstance(value[0], dict):
        return f"{len(value)}"  # the length of a list such as `robots`
    return value if isinstance(value, str) else as_yaml(value)


def as_cell(value: Any) -> Any:
    """Return a value for a table: numbers, truth values and text unchanged, others as YAML."""
    return value if isinstance(value, int | float | str) or value is None else as_yaml(value)


def as_yaml(value: Any) -> str:
    """Return a value as YAML in one line, as in `--set`."""
    return json.dumps(value, ensure_ascii=False)  # JSON is YAML


def _kind_of_base(base: object) -> str:
    return "contents" if isinstance(base, dict) else "file"


class Study(Model):
    """One study, as read from a YAML file. Each point of the sweep is run with each controller; all
    arms have the same seeds, so that trials with the same number are pairs."""

    name: str = Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """Name of the study and of its folder: letters without accents (a to z, A to Z), digits, dots,
    underscores and hyphens, starting with a letter or digit."""
    description: str = ""
    """Description in one or two sentences."""
    base: Annotated[
        Annotated[str, Field(min_length=1, max_length=1000), Tag("file")]
        | Annotated[dict[str, Any], Tag("contents")],
        Discriminator(_kind_of_base),
    ]
    """Path of the spec that every arm changes, relative to the study's file. In Python also the
    spec's contents."""
    sweep: Annotated[Sweep, KindSection(SWEEPS)] | None = None
    """The swept fields with their values; without a sweep, the base's values are used."""
    controllers: dict[Name, dict[FieldPath, Any]] = Field(default={}, max_length=1000)
    """The controllers to compare, by name: each a mapping of paths to values, set before the
    sweep's values."""
    trials: Trials = Trials()
    """Number and seed of the trials of each arm; those of the base are ignored."""


MAX_ARMS = 100_000
SWEEP_KEY = (0,)  # spawn key of a sweep's random draws; the keys of trials have two numbers


@dataclass(frozen=True, slots=True)
class LoadedStudy:
    """A valid study with its arms, in the order in which tables list them."""

    study: Study
    arms: tuple[Arm, ...]

    @property
    def unit(self) -> str:
        """The length unit that all arms share."""
        return self.arms[0].spec.experiment.units.length

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths of the swept fields."""
        return tuple(dict.fromkeys(path for arm in self.arms for path in arm.values))

    def store(self, folder: Path) -> Store:
        """Return the store of the study, with the folder of each arm."""
        return Store(
            folder,
            {arm.name: BatchFolder(folder / arm.name, arm.spec.experiment) for arm in self.arms},
        )


@dataclass(frozen=True)
class Base:
    """The spec that every arm changes: a file, or contents that stand in the study."""

    source: Path | dict[str, Any]

    @cached_property
    def document(self) -> Document:
        """The base, parsed once for all arms; InvalidSpecError if it cannot be read."""
        if isinstance(self.source, dict):
            return parse_document(as_text(self.source, "base"), "base")
        return read_document(self.source)

    @property
    def named(self) -> str | None:
        """What a problem with the whole base quotes, None for contents."""
        return None if isinstance(self.source, dict) else printable(self.source.name)

    def load(self, sets: Sequence[str]) -> LoadedSpec:
        """Return the spec with `path=value` settings; raises InvalidSpecError."""
        if isinstance(self.source, dict):
            with without_lines():
                return load_document(self.document, sets)
        return load_document(self.document, sets)


def load_study(source: Path | Mapping[str, Any]) -> LoadedStudy:
    """Read and check a study, a file or its contents, and the spec of every arm.

    Raises InvalidSpecError, with one line per problem. A problem is located in the study if a value
    of the study causes it, and in the base spec if that is invalid by itself.
    """
    if isinstance(source, Path):
        return _loaded(read_document(source), source.parent)
    document = parse_document(as_text(source, "study"), "study")
    with without_lines():
        return _loaded(document, Path())


def _loaded(document: Document, folder: Path) -> LoadedStudy:
    """Check a study whose base is relative to `folder`."""
    study = _study(document)
    base = Base(study.base if isinstance(study.base, dict) else folder / study.base)
    if isinstance(base.source, Path) and not base.source.exists():
        text = f"there is no such file: {printable(str(base.source))}{near_files(base.source)}"
        raise InvalidSpecError([document.place(("base",)).problem(("base",), text, base.named)])
    arms, problems, hint = list[Arm](), dict[SpecProblem, None](), None
    for controller, values, settings in _arms(study, document):
        try:
            arms.append(_arm(base, study, controller, values, settings, document))
        except InvalidSpecError as error:
            problems |= dict.fromkeys(error.problems)
            if settings and any(p.origin != document.origin for p in error.problems):
                hint = hint or f"in the arm {arm_name(controller, values)} of {document.origin}"
    if not problems:
        problems = dict.fromkeys(_disagreements(arms, document))
    if problems:
        raise InvalidSpecError(problems, hint)
    return LoadedStudy(study, tuple(_with_unique_names(arms)))


def is_study(path: Path) -> bool:
    """Return whether the keys of a file are those of a study, not of a spec."""
    data = read_document(path).data
    return "base" in data and "robots" not in data


@cache
def study_schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of a study; callers must not change it."""
    return schema_of(Study)


def _study(document: Document) -> Study:
    if "robots" in document.data and "base" not in document.data:
        origin = document.origin
        hint = f"run it with: tetractl run {origin}; a study names it as its 'base:'"
        raise InvalidSpecError([SpecProblem(origin, "is a spec, not a study")], hint)
    return validated(Study, document)


_Placed = list[tuple[str, Loc]]  # settings, each with its location in the study


def _arms(study: Study, document: Document) -> Iterable[tuple[str, dict[str, Any], _Placed]]:
    """Yield controller, swept values and settings of every arm."""
    points: list[Mapping[str, Setting]] = [{}]
    if study.sweep is not None:
        seeds = np.random.SeedSequence(study.trials.seed, spawn_key=SWEEP_KEY)
        points = study.sweep.draw(np.random.default_rng(seeds))
    named = study.controllers or {"": {}}
    if len(points) * len(named) > MAX_ARMS:
        text = f"gives {len(points) * len(named)} arms; a study has at most {MAX_ARMS}"
        raise InvalidSpecError([document.place(("sweep",)).problem(("sweep",), text)])
    for controller, values in named.items():
        chosen = [
            (f"{path}={as_yaml(value)}", ("controllers", controller, path))
            for path, value in values.items()
        ]
        for point in points:
            swept = [
                (f"{path}={as_yaml(one.value)}", ("sweep", *one.loc)) for path, one in point.items()
            ]
            yield controller, {path: one.value for path, one in point.items()}, [*chosen, *swept]


def _arm(
    base: Base,
    study: Study,
    controller: str,
    values: Mapping[str, Any],
    settings: _Placed,
    document: Document,
) -> Arm:
    """Return one arm; InvalidSpecError with locations in the study if its settings are invalid."""
    for setting, loc in settings:
        if setting.partition("=")[0].split(".")[0] == "trials":
            text = "cannot be swept; give count and seed in the study's 'trials:'"
            raise InvalidSpecError([document.place(loc).problem(loc, text)])
    sets = tuple(setting for setting, _ in settings)
    trials = (f"trials.count={study.trials.count}", f"trials.seed={study.trials.seed}")
    try:
        spec = base.load((*sets, *trials))
    except InvalidSpecError as error:
        found = {f"--set {printable(setting, 200)}": loc for setting, loc in settings}
        raise InvalidSpecError([_placed(p, found, document) for p in error.problems]) from None
    if not spec.experiment.plant.simulated:
        loc: Loc = ("base",)
        text = "runs in a lab, but a study only simulates: name a spec whose plant has 'type: sim'"
        raise InvalidSpecError([document.place(loc).problem(loc, text, base.named)])
    try:
        check(spec.experiment)
    except SpecError as error:
        place = document.place(("base",))
        raise InvalidSpecError([place.problem(("base",), error.message, base.named)]) from None
    name, known_by = arm_name(controller, values), arm_hash(spec.experiment)
    return Arm(name, controller, values, sets, spec, known_by, code_of(spec.experiment))


def _placed(problem: SpecProblem, settings: Mapping[str, Loc], document: Document) -> SpecProblem:
    """Return a problem of a spec, located in the study if a setting of the study causes it."""
    loc = settings.get(problem.origin)
    if loc is None:
        return problem
    place = document.place(loc)
    path = str(loc[-1]) if not isinstance(loc[-1], int) else str(loc[-2])
    inside = f"{problem.field}: " if problem.field not in ("", path) else ""
    text = f"{inside}{problem.message}"
    return replace(place.problem(loc, text, problem.value), field=dotted(loc))


def _disagreements(arms: list[Arm], document: Document) -> Iterable[SpecProblem]:
    """Yield the problems that concern several arms."""
    units = dict.fromkeys(arm.spec.experiment.units.length for arm in arms)
    if len(units) > 1:
        text = f"has arms in {' and '.join(units)}, but a table has one length unit"
        yield document.place(("sweep",)).problem(("sweep",), text)
    seen: dict[tuple[str, str], Arm] = {}
    for arm in arms:
        twin = seen.setdefault((arm.controller, arm.hash), arm)
        if twin is not arm:
            text = f"gives the arm {arm.name} twice, once as {twin.name}; keep one"
            yield document.place(("sweep",)).problem(("sweep",), text)


def _with_unique_names(arms: list[Arm]) -> Iterable[Arm]:
    """Yield the arms; if several have the same name, a part of the arm's hash is added."""
    names = Counter(arm.name.lower() for arm in arms)  # some file systems ignore case
    for arm in arms:
        several = names[arm.name.lower()] > 1
        yield replace(arm, name=f"{arm.name}-{arm.hash[:8]}") if several else arm
