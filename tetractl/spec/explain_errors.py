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
    find_field_paths,
    find_schema,
    get_child,
    get_type_name,
    list_alternatives,
    schema_of,
)
from tetractl.spec.yaml.core_yaml import suggest_space
from tetractl.spec.yaml.document import Document
from tetractl.spec.yaml.problems import Loc, SpecProblem, suggest_similar

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
    """An error that pydantic found in a spec.

    Attributes:
        details: Pydantic's description of the error.
        loc: Location of the wrong value in the file's data.
        value: The wrong value. None if it is missing.
        schema: The part of the spec's schema that describes the value.
    """

    details: ErrorDetails
    loc: Loc
    value: Any
    schema: Schema

    @property
    def error_type(self) -> str:
        """The name that pydantic gives to this type of error, such as "missing"."""
        return self.details["type"]

    @property
    def context(self) -> dict[str, Any]:
        """The limits and names that the error's message needs. Empty if it needs none."""
        return self.details.get("ctx", {})


def explain(
    error: ValidationError, document: Document, model: type[BaseModel]
) -> Iterator[SpecProblem]:
    """Convert pydantic's errors in a spec to problems in plain words.

    Errors that are already in the document's problems are left out.

    Args:
        error: Pydantic's errors.
        document: The parsed spec.
        model: The class to which the spec's data should be converted.
    """
    schema = schema_of(model)
    for details in error.errors(include_url=False, include_input=False)[:ERRORS_MAX]:
        loc = find_data_loc(details, document.data)
        mistake = Mistake(
            details,
            loc,
            value=reduce(get_child, loc, document.data),
            schema=find_schema(loc, document.data, schema),
        )
        if not _is_reported_already(mistake, document):
            yield _create_problem(mistake, document, schema)


def _is_reported_already(mistake: Mistake, document: Document) -> bool:
    """Check whether an error only follows from another error that is already reported.

    For example, a value that encloses the wrong value may have been refused.
    """
    if mistake.error_type == "default_factory_not_called":
        return True  # by the field from which this default is computed
    if (
        mistake.error_type == "too_short"
        and len(mistake.value or ()) >= mistake.context["min_length"]
    ):
        return True  # pydantic counts only valid entries; the invalid ones are reported
    enclosing = [mistake.loc[:depth] for depth in range(len(mistake.loc) + 1)]
    return any(loc in document.places and document.places[loc].refused for loc in enclosing)


def find_data_loc(details: ErrorDetails, data: Any) -> Loc:
    """Find the location of pydantic's error in the file's data.

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
        data = get_child(data, step)
        steps.append(step)
    field = details.get("ctx", {}).get("field")
    return (*steps, field) if isinstance(field, str) else tuple(steps)


def _create_problem(mistake: Mistake, document: Document, schema: Schema) -> SpecProblem:
    """Convert a mistake in a spec to a problem with a message and a position."""
    loc = mistake.loc
    match mistake.error_type:
        case "extra_forbidden":
            suggestion = _suggest_key(str(loc[-1]), loc[:-1], document.data, schema)
            return document.key(loc).problem(loc, f"unknown key{suggestion}")
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
    if mistake.error_type == "union_tag_not_found":
        return place.problem(loc, f"is missing; {message}")
    unknown_type = str(get_child(mistake.value, "type"))
    guess = suggest_similar(unknown_type, list(types))
    return place.problem(loc, message + guess, place.text)


def _explain_missing(mistake: Mistake, document: Document, schema: Schema) -> SpecProblem:
    """Create the problem of a missing key, or of a list with too few entries.

    The latter is reported at the list instead of the missing entry.
    """
    place = document.place(mistake.loc)
    if isinstance(mistake.loc[-1], int):
        list_loc = mistake.loc[:-1]
        length = len(find_schema(list_loc, document.data, schema).get("prefixItems", ()))
        return place.problem(list_loc, f"must have {length} entries", place.text)
    message = "is missing; add it"
    description = mistake.schema.get("description")
    if description:
        message += f": {_first_sentence(description)}"
    return place.problem(mistake.loc, message)


def _list_types(mistake: Mistake, schema: Schema) -> dict[str, str]:
    """List the types that can be chosen for a section, as {name: description}.

    If a type has no description, its name takes the place of the description.
    """
    if mistake.context.get("known"):
        return mistake.context["known"]
    tags = map(get_type_name, list_alternatives(mistake.schema, schema))
    return {name: name for name in tags if name is not None}


def _explain_wrong_value(mistake: Mistake, document: Document) -> SpecProblem:
    message = _compose_message(mistake)
    place = document.place(mistake.loc)
    is_written = mistake.loc in document.places
    if mistake.value is None and is_written and mistake.error_type != "inconsistent":
        return place.problem(mistake.loc, f"has no value; {message}")
    text = place.text if is_written else None
    return place.problem(mistake.loc, message, mistake.context.get("value", text))


def _compose_message(mistake: Mistake) -> str:
    """Compose the message for a mistake, from the schema if possible."""
    value_schema = mistake.schema
    if mistake.error_type == "literal_error":
        options = [
            str(option) for option in value_schema.get("enum") or [value_schema.get("const")]
        ]
        guess = suggest_similar(str(mistake.value), options)
        return f"must be one of {', '.join(options)}{guess}"
    if mistake.error_type == "string_pattern_mismatch":
        text = value_schema.get("description", mistake.context["pattern"])
        return f"must be {_first_sentence(text.partition(': ')[2] or text)}"
    if mistake.error_type == "tuple_type":
        return f"must be {describe_list(value_schema)}"
    message = explain_in_words(mistake.details, mistake.value)
    if mistake.error_type == "too_long" and mistake.loc[-1] == "start":
        return f"{message}; a heading is a field of its own, heading: {mistake.value[2]}"
    return message


def describe_list(list_schema: Schema) -> str:
    """Describe the list that a schema requires, such as "a list of 2 numbers".

    If the schema has a description, its first sentence follows after a colon.
    """
    entry_schemas = list_schema.get("prefixItems") or [list_schema.get("items") or {}]
    count = f"{len(entry_schemas)} " if "prefixItems" in list_schema else ""
    entry_type = PLURAL_TYPES.get(str(entry_schemas[0].get("type")), "entries")
    description = list_schema.get("description")
    return f"a list of {count}{entry_type}" + (
        f": {_first_sentence(description)}" if description else ""
    )


def explain_in_words(details: ErrorDetails, value: Any) -> str:
    """Convert an error of the library pydantic to a message in plain words.

    If there is no text for this kind of error, return the library's message, beginning with a small
    letter.
    """
    error_type = details["type"]
    context = details.get("ctx", {})
    if error_type in MESSAGES:
        numbers = {
            limit_name: f"{limit:g}" if isinstance(limit, float) else limit
            for limit_name, limit in context.items()
        }
        message = MESSAGES[error_type].format(**numbers) + _suggest_quotes(error_type, value)
        hint = _suggest_value(error_type, value)
        return f"{message}; {hint}" if hint else message
    if error_type == "unknown_color":
        colors = context["known"]
        guess = suggest_similar(str(value), colors)
        return f"is an unknown colour{guess}; known are #rrggbb and {', '.join(colors)}"
    message = details["msg"].removeprefix("Value error, ")
    return message[:1].lower() + message[1:]


def _suggest_key(key: str, parent: Loc, data: Any, schema: Schema) -> str:
    """Suggest the key that an unknown key was meant to be, as the end of a message.

    If no field has a similar name, list the fields that are known at this place.
    """
    space_hint = suggest_space(key)
    if space_hint:
        return f"; {space_hint}"
    fields = list(find_schema(parent, data, schema).get("properties", ()))
    guess = suggest_similar(key, fields)
    if guess:
        return guess
    parent_path = "".join(f"{step}." for step in parent)
    for field_path in find_field_paths(key, schema):
        if (
            field_path.startswith(parent_path) and field_path != f"{parent_path}{key}"
        ):  # that of another kind
            return f" here; did you mean '{field_path}'?"
    return f"; known here: {', '.join(fields)}"


def _suggest_value(error_type: str, value: Any) -> str:
    """Suggest how to write a wrong value, such as with a decimal point. "" if unknown."""
    if isinstance(value, str):
        comma_match = re.fullmatch(r"([+-]?\d+),(\d+)", value)
        point_hint = (
            f"a decimal number has a point: {comma_match[1]}.{comma_match[2]}"
            if comma_match
            else ""
        )
        return suggest_space(value) or point_hint
    if error_type == "too_long" and all(isinstance(entry, int | float) for entry in value):
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
