"""Converts specs of an earlier tetractl: keys and values that have been renamed since.

A spec, a `--set` and the resolved spec in a log all go through here before they are checked. Values
keep their locations, so that errors point at the original text; each change adds a notice to the
document.
"""

from dataclasses import dataclass
from typing import Any

from tetractl.experiment.yaml.document import Document
from tetractl.experiment.yaml.problems import Loc, SpecProblem


@dataclass(frozen=True, slots=True)
class Renamed:
    """A renamed key: old and new dotted path, which differ in the last step."""

    old: str
    new: str

    def apply(self, document: Document) -> None:
        """Rename the key in its place; if both names are given, the old one is a problem."""
        *home, old = loc = self.old.split(".")
        new = self.new.split(".")[-1]
        holder = _mapping(document.data, home)
        if old not in holder:
            return
        _notice(document, tuple(loc), f"{self.old} is now called {self.new}")
        if new in holder:
            message = f"is now called {self.new}, which is given too; keep that one"
            document.problems.append(document.key(tuple(loc)).problem(tuple(loc), message))
            del holder[old]
            return
        items = [(new if key == old else key, value) for key, value in holder.items()]
        holder.clear()
        holder.update(items)
        for notes in document.notes:
            for place in [place for place in notes if place[: len(loc)] == tuple(loc)]:
                notes[(*home, new, *place[len(loc) :])] = notes.pop(place)

    def path(self, steps: list[str]) -> list[str]:
        """Return the path of a `--set` with the new name."""
        old = self.old.split(".")
        same = steps[: len(old)] == old
        return [*self.new.split("."), *steps[len(old) :]] if same else steps


@dataclass(frozen=True, slots=True)
class Revalued:
    """A renamed value of a key."""

    at: str
    old: str
    new: str

    def apply(self, document: Document) -> None:
        """Replace the old value by the new one."""
        *home, key = loc = self.at.split(".")
        holder = _mapping(document.data, home)
        if holder.get(key) == self.old:
            holder[key] = self.new
            _notice(document, tuple(loc), f"{self.at}: {self.old} is now called {self.new}")

    def path(self, steps: list[str]) -> list[str]:
        """Return the path of a `--set`, which stays."""
        return steps


@dataclass(frozen=True, slots=True)
class Removed:
    """A key that no longer exists."""

    at: str
    why: str

    def apply(self, document: Document) -> None:
        """Remove the key."""
        *home, key = loc = self.at.split(".")
        if _mapping(document.data, home).pop(key, None) is not None:
            _notice(document, tuple(loc), f"{self.at} is left out: {self.why}")

    def path(self, steps: list[str]) -> list[str]:
        """Return the path of a `--set`, which stays."""
        return steps


UPGRADES: tuple[Renamed | Revalued | Removed, ...] = (
    Renamed("controller.swarm", "controller.optimizer"),
    Renamed("controller.model", "controller.motion"),
    Revalued("controller.type", "pso-mpc", "mpc"),
    Revalued("plant.motion", "continuous", "exact"),
    Renamed("controller.accept", "controller.accept_error"),
    Renamed("controller.first_lengths", "controller.initial_lengths"),
    Revalued("controller.initial_lengths", "spread", "geometric"),
    Renamed("controller.collision.check", "controller.collision.test"),
    Renamed("controller.collision.stop", "controller.collision.stop_before_collision"),
    Removed("controller.losses", "with 'estimate' lost commands are always detected"),
    Removed("controller.optimizer.precision", "particles are in double precision always"),
)
"""All upgrades in the order of application: a later one may refer to a key that an earlier one
renamed.
"""

OLD_LAB = {"mocap", "radio", "protocol", "robots"}
LAB_PAGE = "docs/reference/spec.md#lab shows them"


def upgrade(document: Document) -> None:
    """Convert a document to the current names; each change adds a notice."""
    for change in UPGRADES:
        change.apply(document)
    _refuse_old_lab(document)


def upgraded_path(steps: list[str]) -> list[str]:
    """Return the path of a `--set` with the current names."""
    for change in UPGRADES:
        steps = change.path(steps)
    return steps


def _refuse_old_lab(document: Document) -> None:
    """Report a lab in the old format, without camera and actuator, once, and remove it from the
    data.
    """
    for key in ("plant", "lab"):
        section = document.data.get(key)
        if not isinstance(section, dict) or {"camera", "actuator"} & section.keys():
            continue
        if OLD_LAB & section.keys():
            message = f"is of an old form; write camera and actuator: {LAB_PAGE}"
            document.problems.append(document.place((key,)).problem((key,), message))
            del document.data[key]


def _mapping(data: Any, home: list[str]) -> dict[str, Any]:
    """Return the mapping at a path, an empty one if there is none."""
    for step in home:
        data = data.get(step) if isinstance(data, dict) else None
    return data if isinstance(data, dict) else {}


def _notice(document: Document, loc: Loc, text: str) -> None:
    place = document.key(loc)
    notice = str(SpecProblem(place.origin, text, place.line, place.column))
    if notice not in document.notices:
        document.notices.append(notice)
