"""The JSON schema of a type of YAML file, such as a spec, and its parts by the path of a field."""

from collections.abc import Iterator
from functools import cache
from typing import Any

from pydantic import BaseModel

from tetractl.spec.yaml.problems import Loc

DRAFT = "https://json-schema.org/draft/2020-12/schema"


@cache
def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of a type of file.

    It is created only once, so callers must not change it.
    """
    return _unwrap_descriptions({"$schema": DRAFT, **model.model_json_schema()})


def find_schema(loc: Loc, data: Any, file_schema: dict[str, Any]) -> dict[str, Any]:
    """Find the schema of a value in a file. Empty if the file's schema does not describe the value.

    If the schema is a union, the `type` in the data selects the alternative.

    Args:
        loc: The location of the value.
        data: The file's data.
        file_schema: The schema of the file.
    """
    node = _choose_alternative(file_schema, data, file_schema)
    for step in loc:
        data = get_child(data, step)
        if isinstance(step, str):
            extra_schema = node.get("additionalProperties")
            extra_schema = extra_schema if isinstance(extra_schema, dict) else {}
            node = node.get("properties", {}).get(step, extra_schema)
        else:
            prefix = node.get("prefixItems", [])
            node = prefix[step] if step < len(prefix) else node.get("items") or {}
        node = _choose_alternative(node, data, file_schema)
    return node


def get_child(data: Any, step: str | int) -> Any:
    """Return the value at a key of a mapping, or at an index of a list.

    None if there is no such entry, or if the data is a single value.
    """
    if isinstance(data, dict):
        return data.get(step)
    if isinstance(data, list) and isinstance(step, int) and step < len(data):
        return data[step]
    return None


def list_alternatives(node: dict[str, Any], file_schema: dict[str, Any]) -> list[dict[str, Any]]:
    """List the alternatives of a union schema, without null and with references resolved.

    The list is empty for any other schema.
    """
    options = node.get("anyOf") or node.get("oneOf") or []
    return [
        _choose_alternative(option, None, file_schema)
        for option in options
        if option.get("type") != "null"
    ]


def get_type_name(node: dict[str, Any]) -> str | None:
    """Return the value of `type` that selects an alternative of a union schema.

    None if the alternative has no type.
    """
    return node.get("properties", {}).get("type", {}).get("const")


def find_field_paths(key: str, file_schema: dict[str, Any]) -> Iterator[str]:
    """Yield the dotted paths of all fields with a given name, at any depth.

    The paths have the form that `--set` accepts. Each path occurs once. The index of every list is
    0.
    """

    def walk(node: dict[str, Any], path: str) -> Iterator[str]:
        node = resolve_reference(node, file_schema)
        for option in node.get("anyOf") or node.get("oneOf") or []:
            yield from walk(option, path)
        if isinstance(node.get("items"), dict):
            yield from walk(node["items"], f"{path}0.")
        for name, field in node.get("properties", {}).items():
            if name == key:
                yield path + name
            yield from walk(field, f"{path}{name}.")

    yield from dict.fromkeys(walk(file_schema, ""))


def _choose_alternative(
    node: dict[str, Any], data: Any, file_schema: dict[str, Any]
) -> dict[str, Any]:
    """Return the alternative of a union schema that the data selects.

    If there are several alternatives, the data's `type` decides, or else the type of the default
    value. If neither decides, the only alternative for mappings or for lists is returned. If there
    is no such alternative either, the schema is returned unchanged.
    """
    node = resolve_reference(node, file_schema)
    options = list_alternatives(node, file_schema)
    if len(options) == 1:
        own_entries = {key: value for key, value in node.items() if key not in ("anyOf", "oneOf")}
        return _choose_alternative({**options[0], **own_entries}, data, file_schema)
    type_name = data.get("type") if isinstance(data, dict) else None
    if type_name is None and isinstance(node.get("default"), dict):
        type_name = node["default"].get("type")
        options = [option for option in options if "type" not in option.get("required", ())]
    for option in options:
        if get_type_name(option) is not None and get_type_name(option) == type_name:
            return option
    container_type = "object" if isinstance(data, dict) else "array"
    matching = [option for option in options if option.get("type") == container_type]
    return matching[0] if len(matching) == 1 else node


def resolve_reference(node: dict[str, Any], file_schema: dict[str, Any]) -> dict[str, Any]:
    """Resolve the `$ref` of a schema's node: merge the named schema with the node's other entries.

    The node's own entries take precedence. A node without a `$ref` is returned unchanged.
    """
    if "$ref" not in node:
        return node
    target = file_schema["$defs"][node["$ref"].rpartition("/")[2]]
    return {**target, **{key: value for key, value in node.items() if key != "$ref"}}


def _unwrap_descriptions(value: Any) -> Any:
    """Replace line breaks by spaces in descriptions, at every depth.

    The descriptions come from docstrings, whose lines are wrapped.
    """
    if isinstance(value, dict):
        return {
            key: " ".join(entry.split())
            if key == "description" and isinstance(entry, str)
            else _unwrap_descriptions(entry)
            for key, entry in value.items()
        }
    return [_unwrap_descriptions(entry) for entry in value] if isinstance(value, list) else value
