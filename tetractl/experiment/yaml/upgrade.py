"""Specs written for an earlier tetractl: keys and values that are called something else now.

A spec, a `--set` and the resolved spec in a log all go through here before they are checked. The
places of the values stay, so that errors point at what was written; each change leaves a notice in
the document.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from tetractl.experiment.yaml.document import Document
from tetractl.experiment.yaml.problems import Loc, SpecProblem, dotted
from tetractl.experiment.yaml.upgrade_lab import upgrade_labs

Note = TypeVar("Note")


@dataclass(frozen=True, slots=True)
class Renamed:
    """A key that has another name or place now; dotted paths, where `*` is any index of a list."""

    old: str
    new: str

    def apply(self, document: Document) -> None:
        """Rename the key wherever the document has it."""
        for loc in list(_matches(document.data, tuple(self.old.split(".")))):
            move(document, loc, self._target(loc))

    def path(self, steps: list[str]) -> list[str]:
        """Return the path of a `--set`, with the new name for the old one."""
        old = self.old.split(".")
        if len(steps) < len(old):
            return steps
        if any(o not in (s, "*") for o, s in zip(old, steps, strict=False)):
            return steps
        return [*map(str, self._target(tuple(steps[: len(old)]))), *steps[len(old) :]]

    def _target(self, loc: Loc) -> Loc:
        """Return where `new` is, with the indices that `*` stood for in `loc`."""
        indices = iter([step for step, o in zip(loc, self.old.split("."), strict=True) if o == "*"])
        return tuple(next(indices) if step == "*" else step for step in self.new.split("."))


@dataclass(frozen=True, slots=True)
class Revalued:
    """A value of a key that is called something else now."""

    at: str
    old: str
    new: str

    def apply(self, document: Document) -> None:
        """Replace the value wherever the document has it."""
        for loc in _matches(document.data, tuple(self.at.split("."))):
            holder = _value(document.data, loc[:-1])
            if holder[loc[-1]] == self.old:
                holder[loc[-1]] = self.new
                _notice(document, loc, f"{dotted(loc)}: {self.old} is now called {self.new}")

    def path(self, steps: list[str]) -> list[str]:
        """Return the path of a `--set`, which stays."""
        return steps


UPGRADES: tuple[Renamed | Revalued, ...] = (
    Renamed("controller.swarm", "controller.optimizer"),
    Renamed("controller.model", "controller.motion"),
    Revalued("controller.type", "pso-mpc", "mpc"),
    Revalued("plant.motion", "continuous", "exact"),
)
"""In the order in which they are applied: a later one may name what an earlier one renamed."""


def upgrade(document: Document) -> None:
    """Bring a document to today's names; what was changed joins its notices."""
    for change in UPGRADES:
        change.apply(document)
    upgrade_labs(document)


def upgraded_path(steps: list[str]) -> list[str]:
    """Return the path of a `--set` in today's names."""
    for change in UPGRADES:
        steps = change.path(steps)
    return steps


def move(document: Document, old: Loc, new: Loc) -> None:
    """Move the value at `old`, which exists, to `new`, with the places of all that is in it.

    A key that stays in its mapping keeps its rank there. Where something stands at `new` already,
    that is a problem of the document.
    """
    holder = _value(document.data, old[:-1])
    _notice(document, old, f"{dotted(old)} is now called {dotted(new)}")
    if _exists(document.data, new):
        place = document.keys.get(old) or document.place(old)
        message = f"is now called {dotted(new)}, which is given too; keep that one"
        document.problems.append(place.problem(old, message))
        del holder[old[-1]]
        return
    if old[:-1] == new[:-1]:
        items = [(new[-1] if key == old[-1] else key, value) for key, value in holder.items()]
        holder.clear()
        holder.update(items)
    else:
        value, home = holder.pop(old[-1]), cast(Any, document.data)
        for step in new[:-1]:
            home = home.setdefault(step, {}) if isinstance(home, dict) else home[step]
        home[new[-1]] = value
    _move_notes(document.values, old, new)
    _move_notes(document.keys, old, new)
    _move_notes(document.refused, old, new)


def _move_notes(notes: dict[Loc, Note], old: Loc, new: Loc) -> None:
    for loc in [loc for loc in notes if loc[: len(old)] == old]:
        notes[(*new, *loc[len(old) :])] = notes.pop(loc)


def _matches(data: Any, pattern: tuple[str, ...], at: Loc = ()) -> Iterator[Loc]:
    """Yield where a pattern is in the data."""
    if not pattern:
        yield at
    elif pattern[0] == "*" and isinstance(data, list):
        for i, item in enumerate(data):
            yield from _matches(item, pattern[1:], (*at, i))
    elif isinstance(data, dict) and pattern[0] in data:
        yield from _matches(data[pattern[0]], pattern[1:], (*at, pattern[0]))


def _value(data: Any, loc: Loc) -> Any:
    for step in loc:
        data = data[step]
    return data


def _exists(data: Any, loc: Loc) -> bool:
    if not loc:
        return True
    holder = _value(data, loc[:-1]) if _exists(data, loc[:-1]) else None
    if isinstance(holder, list):
        return isinstance(loc[-1], int) and loc[-1] < len(holder)
    return isinstance(holder, dict) and loc[-1] in holder


def _notice(document: Document, loc: Loc, text: str) -> None:
    place = document.keys.get(loc) or document.place(loc)
    notice = str(SpecProblem(place.origin, text, place.line, place.column))
    if notice not in document.notices:
        document.notices.append(notice)
