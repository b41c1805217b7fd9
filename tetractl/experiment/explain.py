"""Turns pydantic's errors in a spec into plain messages with their location in the YAML."""

import re
from collections.abc import Iterator
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from tetractl.experiment.base import with_tuples
from tetractl.experiment.controller import retired_hint
from tetractl.experiment.registry_fields import STRICT
from tetractl.experiment.schema import alternatives, child, describe, homes, schema_of, tag
from tetractl.experiment.yaml.core_yaml import with_space
from tetractl.experiment.yaml.document import Document
from tetractl.experiment.yaml.problems import InvalidSpecError, Loc, SpecProblem, did_you_mean

Schema = dict[str, Any]

MESSAGES = {
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "bool_type": "must be true or false",
    "string_type": "must be text",
    "string_unicode": "must be valid Unicode text",
    "tuple_type": "must be a list",
    "model_type": "must be a mapping of keys to values",
    "model_attributes_type": "must be a mapping of keys to values",
    "dict_type": "must be a mapping of keys to values",
    "missing": "is missing",
    "extra_forbidden": "unknown key",
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
    "string_too_short": "must have at least {min_length} characters",
    "string_too_long": "must have at most {max_length} characters",
    "too_short": "must have at least {min_length} entries",
    "too_long": "must have at most {max_length} entries, not {actual_length}",
    "literal_error": "must be {expected}",
    "string_pattern_mismatch": "must match {pattern}",
}


Section = TypeVar("Section", bound=BaseModel)


def validated(model: type[Section], document: Document) -> Section:
    """Validate a document as a given type; InvalidSpecError lists its problems."""
    try:
        found = model.model_validate(with_tuples(document.data), strict=True, context=STRICT)
    except ValidationError as error:
        problems = explain(error, document, schema_of(model))
        raise InvalidSpecError([*document.all_problems, *problems]) from None
    if document.all_problems:
        raise InvalidSpecError(document.all_problems)
    return found


def explain(
    error: ValidationError, document: Document, schema: Schema | None = None
) -> Iterator[SpecProblem]:
    """Yield pydantic's errors as problems, except errors already in the document.

    `schema` is the JSON schema of the file, by default the schema of a spec.
    """
    every = error.errors(include_url=False, include_input=False)
    for details in every[:1000]:
        loc = data_loc(details, document.data)
        value = _at(document.data, loc)
        context = details.get("ctx", {})
        if details["type"] == "default_factory_not_called":
            continue  # the field from which this default is computed is reported already
        if details["type"] == "too_short" and len(value or ()) >= context["min_length"]:
            continue  # pydantic counts only valid entries; the invalid ones are reported already
        if any(loc[:depth] in document.refused for depth in range(len(loc) + 1)):
            continue
        yield _problem(details, loc, value, document, schema)


def data_loc(details: ErrorDetails, data: Any) -> Loc:
    """Return the location of an error in the data: pydantic's loc without the tags of unions.

    A validator can name a field of its model in the error's context, see `base.inconsistent`.
    """
    steps: list[str | int] = []
    last = len(details["loc"]) - 1
    names_a_key = details["type"] in ("missing", "extra_forbidden")
    for i, step in enumerate(details["loc"]):
        if not (i == last and names_a_key):
            is_tag = isinstance(data, dict) and (data.get("type") == step or step not in data)
            if is_tag or not isinstance(data, dict | list):
                continue
        data = child(data, step)
        steps.append(step)
    field = details.get("ctx", {}).get("field")
    return (*steps, field) if isinstance(field, str) else tuple(steps)


def _problem(
    details: ErrorDetails, loc: Loc, value: Any, document: Document, schema: Schema | None
) -> SpecProblem:
    kind, context = details["type"], details.get("ctx", {})
    if kind == "extra_forbidden":
        place = document.key(loc)
        return place.problem(loc, _unknown_key(str(loc[-1]), loc[:-1], document.data, schema))
    if kind == "missing":
        place = document.place(loc)
        if isinstance(loc[-1], int):
            length = len(describe(loc[:-1], document.data, schema).get("prefixItems", ()))
            return place.problem(loc[:-1], f"must have {length} entries", place.text)
        about = describe(loc, document.data, schema).get("description")
        return place.problem(loc, f"is missing; add it{f': {_sentence(about)}' if about else ''}")
    if kind.startswith("union_tag"):
        options: dict[str, str] = context.get("known") or {
            option: option
            for option in map(tag, alternatives(describe(loc, document.data, schema), schema))
            if option is not None
        }
        known = f"must be one of {', '.join(options.values())}"
        if kind == "union_tag_not_found":
            return document.place(loc).problem((*loc, "type"), f"is missing; {known}")
        wrong = child(value, "type")
        place = document.place((*loc, "type"))
        return place.problem(
            (*loc, "type"), known + did_you_mean(str(wrong), list(options)), place.text
        )
    if kind == "not_installed":
        key = context.get("key", "type")
        place = document.place((*loc, key))
        return place.problem((*loc, key), context["why"], place.text)
    place = document.place(loc)
    message = _words(details, loc, value, document.data, schema)
    if value is None and loc in document.values and kind != "inconsistent":
        return place.problem(loc, f"has no value; {message}")
    text = place.text if loc in document.values else None
    return place.problem(loc, message, context.get("value", text))


def _words(details: ErrorDetails, loc: Loc, value: Any, data: Any, schema: Schema | None) -> str:
    """Return a message, made from the schema for a wrong choice or pattern, else by `words`."""
    kind, context = details["type"], details.get("ctx", {})
    about = describe(loc, data, schema)
    if kind == "literal_error":
        options = [str(option) for option in about.get("enum") or [about.get("const")]]
        return f"must be one of {', '.join(options)}{did_you_mean(str(value), options)}"
    if kind == "string_pattern_mismatch":
        text = about.get("description", context["pattern"])
        return f"must be {_sentence(text.partition(': ')[2] or text)}"
    return words(details, value)


def words(details: ErrorDetails, value: Any) -> str:
    """Return a plain message for pydantic's error."""
    kind, context = details["type"], details.get("ctx", {})
    if kind in MESSAGES:
        numbers = {k: f"{v:g}" if isinstance(v, float) else v for k, v in context.items()}
        message = MESSAGES[kind].format(**numbers) + _quotes(kind, value)
        hint = _hint(kind, value)
        return f"{message}; {hint}" if hint else message
    if kind == "unknown_color":
        known = context["known"]
        guess = did_you_mean(str(value), known)
        return f"is an unknown colour{guess}; known are #rrggbb and {', '.join(known)}"
    message = details["msg"].removeprefix("Value error, ")
    return message[:1].lower() + message[1:]


def _unknown_key(key: str, parent: Loc, data: Any, schema: Schema | None) -> str:
    if spaced := with_space(key):
        return f"unknown key; {spaced}"
    if told := retired_hint(key, _at(data, parent)):
        return f"unknown key; {told}"
    known = list(describe(parent, data, schema).get("properties", ()))
    if guess := did_you_mean(key, known):
        return f"unknown key{guess}"
    inside = "".join(f"{step}." for step in parent)
    for home in homes(key, schema):
        if home.startswith(inside):
            return f"unknown key here; did you mean '{home}'?"
    return f"unknown key; known here: {', '.join(known)}"


def _hint(kind: str, value: Any) -> str:
    """Return how a value was probably meant, "" if nothing says so."""
    if isinstance(value, str):
        return with_space(value) or _with_point(value)
    if kind == "too_long" and all(isinstance(entry, int | float) for entry in value):
        return "a decimal number has a point, not a comma"
    return ""


def _with_point(text: str) -> str:
    """Return a hint for a number with a decimal comma; "" for other texts."""
    match = re.fullmatch(r"([+-]?\d+),(\d+)", text)
    return f"a decimal number has a point: {match[1]}.{match[2]}" if match else ""


def _quotes(kind: str, value: Any) -> str:
    if kind == "string_type" and isinstance(value, int | float):
        return "; put it in quotes"
    if kind in ("int_type", "float_type") and isinstance(value, str):
        try:
            float(value)
        except ValueError:
            return ""
        return "; take the quotes away"
    return ""


def _sentence(text: str) -> str:
    first = text.split(". ")[0].rstrip(".")
    return first[:1].lower() + first[1:] if not first[:2].isupper() else first


def _at(data: Any, loc: Loc) -> Any:
    for step in loc:
        data = child(data, step)
    return data
