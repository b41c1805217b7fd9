"""Converts specs of an earlier version of tetractl, whose keys or values have been renamed.

A spec, a `--set` and the resolved spec in a log are converted before they are checked. Values keep
their locations, so that errors point at the original text; each change adds a notice to the
document.
"""

from typing import Any

from tetractl.experiment.yaml.document import Document
from tetractl.experiment.yaml.problems import Loc, SpecProblem

RENAMED = {
    "controller.swarm": "controller.optimizer",
    "controller.model": "controller.motion",
    "controller.accept": "controller.accept_error",
    "controller.first_lengths": "controller.initial_lengths",
    "controller.collision.check": "controller.collision.test",
    "controller.collision.stop": "controller.collision.stop_before_collision",
}
"""{old path of a renamed key: new path}; the two paths differ only in the last step."""
REVALUED = (
    ("controller.type", "pso-mpc", "mpc"),
    ("plant.motion", "continuous", "exact"),
    ("controller.initial_lengths", "spread", "geometric"),
)
"""Renamed values: path of the key, old value, new value."""
REMOVED = {
    "controller.losses": "lost commands are always detected with 'estimate'",
    "controller.optimizer.precision": "particles always have double precision",
    **{
        f"{plant}.camera.source.adapters": "adapters are taken from the installed Micro-Manager"
        for plant in ("plant", "lab")
    },
}
"""{path of a key that is no longer needed: reason}."""


def upgrade(document: Document) -> None:
    """Convert a document to the current names; each change adds a notice."""
    for old, new in RENAMED.items():
        _rename(document, old, new)
    for at, old, new in REVALUED:
        holder, loc = _holder(document, at)
        if holder.get(loc[-1]) == old:
            holder[loc[-1]] = new
            _notice(document, loc, f"{at}: {old} is now called {new}")
    for at, why in REMOVED.items():
        holder, loc = _holder(document, at)
        if holder.pop(loc[-1], None) is not None:
            _notice(document, loc, f"{at} is left out: {why}")


def upgraded_path(steps: list[str]) -> list[str]:
    """Return the path of a `--set` with the current names."""
    for old, new in RENAMED.items():
        length = old.count(".") + 1
        if steps[:length] == old.split("."):
            steps = [*new.split("."), *steps[length:]]
    return steps


def _rename(document: Document, old: str, new: str) -> None:
    """Rename a key without moving it; add a problem if both the old and the new key are given."""
    holder, loc = _holder(document, old)
    key, name = loc[-1], new.split(".")[-1]
    if key not in holder:
        return
    _notice(document, loc, f"{old} is now called {new}")
    if name in holder:
        message = f"is now called {new}, which is also given; remove the old key"
        document.problems.append(document.key(loc).problem(loc, message))
        del holder[key]
        return
    items = [(name if one == key else one, value) for one, value in holder.items()]
    holder.clear()
    holder.update(items)
    for notes in document.notes:
        for place in [place for place in notes if place[: len(loc)] == loc]:
            notes[(*loc[:-1], name, *place[len(loc) :])] = notes.pop(place)


def _holder(document: Document, path: str) -> tuple[dict[Any, Any], Loc]:
    """Return the mapping that holds a key, or an empty one, and the location of the key."""
    *home, key = path.split(".")
    data: Any = document.data
    for step in home:
        data = data.get(step) if isinstance(data, dict) else None
    return data if isinstance(data, dict) else {}, (*home, key)


def _notice(document: Document, loc: Loc, text: str) -> None:
    place = document.key(loc)
    notice = str(SpecProblem(place.origin, text, place.line, place.column))
    if notice not in document.notices:
        document.notices.append(notice)
