"""Convert pydantic's errors in a spec to plain messages with their place in the YAML file.

The errors are unknown keys, for which the most similar known key is suggested, wrong types and
wrong values.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from tetractl.spec.schema import (
    alternatives,
    child,
    describe,
    homes,
    schema_of,
    tag,
)
from tetractl.spec.yaml.core_yaml import with_space
from tetractl.spec.yaml.document import Document
from tetractl.spec.yaml.problems import Loc, SpecProblem, did_you_mean

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
    "none_required": "must be a mapping of keys to values",
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


PLURAL_TYPES = {"number": "numbers", "integer": "whole numbers", "string": "texts"}
"""The plural of each type in a schema, for lists."""
ERRORS_MAX = 1000
"""Maximum number of pydantic's errors that are explained."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """An error of pydantic, with its location and value in the file's data.

    `about` is the part of the schema that describes the value.
    """

    details: ErrorDetails
    loc: Loc
    value: Any
    about: Schema

    @property
    def kind(self) -> str:
        """The name that the library pydantic gives to the error."""
        return self.details["type"]

    @property
    def context(self) -> dict[str, Any]:
        """The limits and names that a message about the mistake needs. Empty if it needs none."""
        return self.details.get("ctx", {})


def explain(
    error: ValidationError, document: Document, model: type[BaseModel]
) -> Iterator[SpecProblem]:
    """Convert pydantic's errors in a document to problems.

    Errors that are already in the document are left out.

    Args:
        error: Pydantic's errors.
        document: The document.
        model: The type that the document should have.
    """
    schema = schema_of(model)
    for details in error.errors(include_url=False, include_input=False)[:ERRORS_MAX]:
        loc = find_data_loc(details, document.data)
        mistake = Mistake(
            details,
            loc,
            value=reduce(child, loc, document.data),
            about=describe(loc, document.data, schema),
        )
        if not _is_reported_already(mistake, document):
            yield _create_problem(mistake, document, schema)


def _is_reported_already(mistake: Mistake, document: Document) -> bool:
    """Check whether an error only follows from another one that is already reported.

    This is so if a value that encloses it was refused, for example.
    """
    if mistake.kind == "default_factory_not_called":
        return True  # by the field from which this default is computed
    if mistake.kind == "too_short" and len(mistake.value or ()) >= mistake.context["min_length"]:
        return True  # pydantic counts only valid entries; the invalid ones are reported
    enclosing = [mistake.loc[:depth] for depth in range(len(mistake.loc) + 1)]
    return any(loc in document.places and document.places[loc].refused for loc in enclosing)


def find_data_loc(details: ErrorDetails, data: Any) -> Loc:
    """Return the location of an error in the file's data.

    The tags of unions in pydantic's location are left out. A validator can name a field of its
    model in the error's context, see `base.inconsistent`.
    """
    steps: list[str | int] = []
    last_index = len(details["loc"]) - 1
    names_a_key = details["type"] in ("missing", "extra_forbidden")
    for i, step in enumerate(details["loc"]):
        if not (i == last_index and names_a_key):
            is_tag = isinstance(data, dict) and (data.get("type") == step or step not in data)
            if is_tag or not isinstance(data, dict | list):
                continue
        data = child(data, step)
        steps.append(step)
    field = details.get("ctx", {}).get("field")
    return (*steps, field) if isinstance(field, str) else tuple(steps)


def _create_problem(mistake: Mistake, document: Document, schema: Schema) -> SpecProblem:
    """Convert a mistake in a spec to a problem with a message and a position."""
    loc = mistake.loc
    match mistake.kind:
        case "extra_forbidden":
            meant = _suggest_key(str(loc[-1]), loc[:-1], document.data, schema)
            return document.key(loc).problem(loc, f"unknown key{meant}")
        case "missing":
            return _explain_missing(mistake, document, schema)
        case "union_tag_not_found" | "union_tag_invalid":
            return _explain_wrong_type(mistake, document, schema)
        case "not_installed":
            loc_of_name = (*loc, mistake.context.get("key", "type"))
            place = document.place(loc_of_name)
            return place.problem(loc_of_name, mistake.context["why"], place.text)
    return _explain_wrong_value(mistake, document)


def _explain_wrong_type(mistake: Mistake, document: Document, schema: Schema) -> SpecProblem:
    """Create the problem of a section of the spec whose `type` is missing or unknown."""
    loc = (*mistake.loc, "type")
    place = document.place(loc)
    types = _list_types(mistake, schema)
    message = f"must be one of {', '.join(types.values())}"
    if mistake.kind == "union_tag_not_found":
        return place.problem(loc, f"is missing; {message}")
    unknown_type = str(child(mistake.value, "type"))
    guess = did_you_mean(unknown_type, list(types))
    return place.problem(loc, message + guess, place.text)


def _explain_missing(mistake: Mistake, document: Document, schema: Schema) -> SpecProblem:
    """Create the problem of a missing key, or of a list with too few entries.

    The latter is reported at the list instead of the missing entry.
    """
    place = document.place(mistake.loc)
    if isinstance(mistake.loc[-1], int):
        entries = mistake.loc[:-1]
        length = len(describe(entries, document.data, schema).get("prefixItems", ()))
        return place.problem(entries, f"must have {length} entries", place.text)
    message = "is missing; add it"
    description = mistake.about.get("description")
    if description:
        message += f": {_first_sentence(description)}"
    return place.problem(mistake.loc, message)


def _list_types(mistake: Mistake, schema: Schema) -> dict[str, str]:
    """Return {name: description} of each type that can be chosen here.

    If there is no description, the name takes its place.
    """
    if mistake.context.get("known"):
        return mistake.context["known"]
    tags = map(tag, alternatives(mistake.about, schema))
    return {name: name for name in tags if name is not None}


def _explain_wrong_value(mistake: Mistake, document: Document) -> SpecProblem:
    message = _compose_message(mistake)
    place = document.place(mistake.loc)
    is_written = mistake.loc in document.places
    if mistake.value is None and is_written and mistake.kind != "inconsistent":
        return place.problem(mistake.loc, f"has no value; {message}")
    text = place.text if is_written else None
    return place.problem(mistake.loc, message, mistake.context.get("value", text))


def _compose_message(mistake: Mistake) -> str:
    """Compose the message for a mistake, from the schema if possible."""
    about = mistake.about
    if mistake.kind == "literal_error":
        options = [str(option) for option in about.get("enum") or [about.get("const")]]
        guess = did_you_mean(str(mistake.value), options)
        return f"must be one of {', '.join(options)}{guess}"
    if mistake.kind == "string_pattern_mismatch":
        text = about.get("description", mistake.context["pattern"])
        return f"must be {_first_sentence(text.partition(': ')[2] or text)}"
    if mistake.kind == "tuple_type":
        return f"must be {describe_list(about)}"
    message = explain_in_words(mistake.details, mistake.value)
    if mistake.kind == "too_long" and mistake.loc[-1] == "start":
        return f"{message}; a heading is a field of its own, heading: {mistake.value[2]}"
    return message


def describe_list(about: Schema) -> str:
    """Describe the list that a schema requires, such as "a list of 2 numbers".

    If the schema has a description, its first sentence follows after a colon.
    """
    entries = about.get("prefixItems") or [about.get("items") or {}]
    count = f"{len(entries)} " if "prefixItems" in about else ""
    entry_type = PLURAL_TYPES.get(str(entries[0].get("type")), "entries")
    description = about.get("description")
    return f"a list of {count}{entry_type}" + (
        f": {_first_sentence(description)}" if description else ""
    )


def explain_in_words(details: ErrorDetails, value: Any) -> str:
    """Convert an error of the library pydantic to a message in plain words.

    If there is no text for this kind of error, return the library's message, beginning with a small
    letter.
    """
    kind = details["type"]
    context = details.get("ctx", {})
    if kind in MESSAGES:
        numbers = {k: f"{v:g}" if isinstance(v, float) else v for k, v in context.items()}
        message = MESSAGES[kind].format(**numbers) + _suggest_quotes(kind, value)
        hint = _suggest_value(kind, value)
        return f"{message}; {hint}" if hint else message
    if kind == "unknown_color":
        colors = context["known"]
        guess = did_you_mean(str(value), colors)
        return f"is an unknown colour{guess}; known are #rrggbb and {', '.join(colors)}"
    message = details["msg"].removeprefix("Value error, ")
    return message[:1].lower() + message[1:]


def _suggest_key(key: str, parent: Loc, data: Any, schema: Schema) -> str:
    """Suggest what was meant by an unknown key, as a text that follows "unknown key".

    If no field has a similar name, list the fields that are known at this place.
    """
    spaced = with_space(key)
    if spaced:
        return f"; {spaced}"
    fields = list(describe(parent, data, schema).get("properties", ()))
    guess = did_you_mean(key, fields)
    if guess:
        return guess
    inside = "".join(f"{step}." for step in parent)
    for home in homes(key, schema):
        if home.startswith(inside) and home != f"{inside}{key}":  # that of another kind
            return f" here; did you mean '{home}'?"
    return f"; known here: {', '.join(fields)}"


def _suggest_value(kind: str, value: Any) -> str:
    """Suggest how a wrong value was probably meant, such as with a decimal point. "" if unknown."""
    if isinstance(value, str):
        comma = re.fullmatch(r"([+-]?\d+),(\d+)", value)
        point_hint = f"a decimal number has a point: {comma[1]}.{comma[2]}" if comma else ""
        return with_space(value) or point_hint
    if kind == "too_long" and all(isinstance(entry, int | float) for entry in value):
        return "a decimal number has a point, not a comma"
    return ""


def _suggest_quotes(error_type: str, value: Any) -> str:
    if error_type == "string_type" and isinstance(value, int | float):
        return "; put it in quotes"
    if error_type in ("int_type", "float_type") and isinstance(value, str):
        try:
            float(value)
        except ValueError:
            return ""
        return "" if "_" in value else "; take the quotes away"
    return ""


def _first_sentence(text: str) -> str:
    sentence = text.split(". ")[0].rstrip(".")
    return sentence[:1].lower() + sentence[1:] if not sentence[:2].isupper() else sentence
