"""`--set PATH=VALUE`: values that replace those of a spec before it is checked."""

from typing import Any

from tetractl.core.text import printable
from tetractl.experiment.yaml.core_yaml import MAX_DEPTH
from tetractl.experiment.yaml.document import Document, Place, parse_value
from tetractl.experiment.yaml.problems import InvalidSpecError, Loc, SpecProblem, dotted
from tetractl.experiment.yaml.upgrade import upgrade, upgraded_path


def override(document: Document, setting: str) -> None:
    """Apply one `path=value` to a document; what is wrong joins its problems.

    A step of the path is a key, an index, or the `name` of an entry: `robots.0.a`,
    `robots.green.a`. Mappings that the spec leaves to their defaults are made.
    """
    origin = f"--set {printable(setting, 200)}"
    path, equals, text = setting.partition("=")
    try:
        if not equals or not path.strip():
            raise _wrong(
                origin, "must be PATH=VALUE, for instance controller.optimizer.particles=200"
            )
        written = path.strip().split(".")
        if len(written) > MAX_DEPTH:
            raise _wrong(origin, f"the path has more than {MAX_DEPTH} steps")
        steps = upgraded_path(written)
        loc, holder = _descend(document, steps, origin)
        value = parse_value(text, origin, loc)
    except InvalidSpecError as error:
        document.problems.extend(error.problems)
        return
    holder[loc[-1]] = value
    for notes in document.notes:
        for stale in [key for key in notes if key[: len(loc)] == loc]:
            del notes[stale]
    document.values[loc] = document.keys[loc] = Place(origin, text=printable(text, 60) or None)
    if steps != written:
        old, new = (printable(".".join(path), 200) for path in (written, steps))
        document.notices.append(f"{origin}: {old} is now called {new}")
    upgrade(document)


def _descend(document: Document, steps: list[str], origin: str) -> tuple[Loc, Any]:
    """Return the full loc and the mapping or list that holds its last step."""
    data: Any = document.data
    loc: Loc = ()
    for step in steps[:-1]:
        loc = (*loc, _step(data, loc, step, origin))
        if isinstance(data, dict) and data.get(step) is None:
            data[step] = {}
            document.values[loc] = document.keys[loc] = Place(origin)
            document.refused.pop(loc, None)
        data = data[loc[-1]]
    return (*loc, _step(data, loc, steps[-1], origin)), data


def _step(data: Any, loc: Loc, step: str, origin: str) -> str | int:
    if isinstance(data, dict):
        if not step:
            raise _wrong(origin, "a step of the path is empty", loc)
        return step
    if not isinstance(data, list):
        raise _wrong(origin, f"has no '{printable(step, 60)}'; it is a single value", loc)
    for i, entry in enumerate(data):
        if step == str(i) or (isinstance(entry, dict) and entry.get("name") == step):
            return i
    names = [str(e["name"]) for e in data if isinstance(e, dict) and "name" in e]
    known = f" or {', '.join(names)}" if names else ""
    indices = f"0 to {len(data) - 1}{known}" if data else "none: it is empty"
    raise _wrong(origin, f"has no entry '{printable(step, 60)}'; its entries are {indices}", loc)


def _wrong(origin: str, message: str, loc: Loc = ()) -> InvalidSpecError:
    return InvalidSpecError([SpecProblem(origin, message, field=dotted(loc))])
