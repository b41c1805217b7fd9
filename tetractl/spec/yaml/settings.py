"""Apply the values of options such as `--set` to a parsed spec.

with_settings(document, ["robots.green.a=5", FieldValue("trials.seed", 3, "--seed")])
"""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

from tetractl.core.errors import printable
from tetractl.spec.yaml.core_yaml import MAX_DEPTH
from tetractl.spec.yaml.document import Document, Place, parse_value
from tetractl.spec.yaml.problems import InvalidSpecError, Loc


@dataclass(frozen=True, slots=True)
class FieldValue:
    """The value that an option such as `--seed 3` gives to a field.

    Attributes:
        path: The field, such as `trials.seed`.
        value: The value.
        option: The option, which problems with the value name.
    """

    path: str
    value: Any
    option: str

    @property
    def origin(self) -> str:
        """The option and its value, as the user has typed them."""
        return f"{self.option} {self.value}"


SpecSetting = str | FieldValue
"""A value of one field: `PATH=VALUE`, with a value in YAML, or a `FieldValue`."""


def with_settings(document: Document, settings: Sequence[SpecSetting]) -> Document:
    """Return a copy of a document in which settings replace values or add them.

    Errors in the settings are added to the problems of the copy. The path of a setting consists of
    steps that are separated by dots. Each step is a key, an index, or the `name` of an entry, as in
    `robots.0.a` and `robots.green.a`. Mappings that the spec omits are created.
    """
    document_copy = replace(
        document,
        data=deepcopy(document.data),
        places=dict(document.places),
        problems=list(document.problems),
    )
    for setting in settings:
        try:
            if isinstance(setting, str):
                _apply_setting(document_copy, setting)
            else:
                place = Place(setting.origin, text=str(setting.value))
                loc = create_path(document_copy, setting.path.split("."), place)
                document_copy.put(loc, setting.value, place)
        except InvalidSpecError as error:
            document_copy.problems.extend(error.problems)
    return document_copy


def _apply_setting(document: Document, setting: str) -> None:
    """Apply a setting such as `robots.0.a=6`, whose value is YAML, to a parsed spec.

    Mappings that the path needs but the spec omits are created.

    Raises:
        InvalidSpecError: If the setting is malformed, or its path leads nowhere.
    """
    place = Place(f"--set {printable(setting, 200)}")
    path, equals, text = setting.partition("=")
    path = path.strip()
    if not (equals and path):
        message = "must have the form PATH=VALUE, for instance controller.optimizer.particles=200"
        raise InvalidSpecError([place.problem((), message)])
    steps = path.split(".")
    if len(steps) > MAX_DEPTH:
        raise InvalidSpecError([place.problem((), f"the path has more than {MAX_DEPTH} parts")])
    loc = create_path(document, steps, place)
    value = parse_value(text, place.origin, loc)
    document.put(loc, value, replace(place, text=printable(text, 60) or None))


def create_path(document: Document, steps: Sequence[str], place: Place) -> Loc:
    """Find the location that a setting's path means, and create the mappings that are missing.

    Args:
        document: The parsed spec.
        steps: The steps of the path. A step is a key, the `name` of a list's entry, or an index.
        place: The option that gives the path, for error messages.

    Raises:
        InvalidSpecError: If there is no such location.
    """
    loc: Loc = ()
    holder: Any = document.data
    for step in steps[:-1]:
        loc = (*loc, _find_key(holder, loc, step, place))
        if isinstance(holder, dict) and holder.get(step) is None:
            document.put(loc, {}, replace(place, text=None))
        holder = holder[loc[-1]]
    return (*loc, _find_key(holder, loc, steps[-1], place))


def _find_key(holder: Any, loc: Loc, step: str, place: Place) -> str | int:
    """Find the key or index that one step of a path means in `holder`, the value at `loc`.

    Raises:
        InvalidSpecError: If the step is empty, if it is no index of a list, or if the value is
            neither a list nor a mapping.
    """
    if isinstance(holder, list):
        return _find_index(holder, loc, step, place)
    if not isinstance(holder, dict):
        message = f"has no '{printable(step, 60)}', because it is a single value"
        raise InvalidSpecError([place.problem(loc, message)])
    if not step:
        raise InvalidSpecError([place.problem(loc, "a part of the path is empty")])
    return step


def _find_index(entries: list[Any], loc: Loc, step: str, place: Place) -> int:
    """Find the index of the list entry that a step of a path means, by index from 0 or by name.

    Raises:
        InvalidSpecError: If the list has no such entry.
    """
    names = {
        i: str(entry["name"])
        for i, entry in enumerate(entries)
        if isinstance(entry, dict) and "name" in entry
    }
    for i in range(len(entries)):
        if step in (str(i), names.get(i)):
            return i
    choices = "none, because it is empty"
    if entries:
        choices = f"0 to {len(entries) - 1}"
    if names:
        choices += f" or {', '.join(names.values())}"
    message = f"has no entry '{printable(step, 60)}'; its entries are {choices}"
    raise InvalidSpecError([place.problem(loc, message)])
