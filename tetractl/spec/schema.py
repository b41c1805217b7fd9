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
    return _unwrapped({"$schema": DRAFT, **model.model_json_schema()})


def describe(loc: Loc, data: Any, root: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a value in a file. Empty if there is none.

    If the schema is a union, the `type` in the data selects the alternative.

    Args:
        loc: The location of the value.
        data: The file's data.
        root: The schema of the file.
    """
    node = _resolved(root, data, root)
    for step in loc:
        data = child(data, step)
        if isinstance(step, str):
            others = node.get("additionalProperties")
            others = others if isinstance(others, dict) else {}
            node = node.get("properties", {}).get(step, others)
        else:
            prefix = node.get("prefixItems", [])
            node = prefix[step] if step < len(prefix) else node.get("items") or {}
        node = _resolved(node, data, root)
    return node


def child(data: Any, step: str | int) -> Any:
    """Return the value at a key or index.

    None if it does not exist, or if the data has no entries.
    """
    if isinstance(data, dict):
        return data.get(step)
    if isinstance(data, list) and isinstance(step, int) and step < len(data):
        return data[step]
    return None


def alternatives(node: dict[str, Any], root: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the alternatives of a union schema, without null and with references resolved.

    Empty for any other schema.
    """
    listed = node.get("anyOf") or node.get("oneOf") or []
    return [_resolved(option, None, root) for option in listed if option.get("type") != "null"]


def tag(node: dict[str, Any]) -> str | None:
    """Return the value of `type` that selects this alternative of a union.

    None if it has no type.
    """
    return node.get("properties", {}).get("type", {}).get("const")


def homes(key: str, root: dict[str, Any]) -> Iterator[str]:
    """Yield the dotted paths of all fields with this name, as `--set` takes them, at any depth.

    Each path occurs once. The index of every list is 0.
    """

    def walk(node: dict[str, Any], path: str) -> Iterator[str]:
        node = dereferenced(node, root)
        for option in node.get("anyOf") or node.get("oneOf") or []:
            yield from walk(option, path)
        if isinstance(node.get("items"), dict):
            yield from walk(node["items"], f"{path}0.")
        for name, field in node.get("properties", {}).items():
            if name == key:
                yield path + name
            yield from walk(field, f"{path}{name}.")

    yield from dict.fromkeys(walk(root, ""))


def _resolved(node: dict[str, Any], data: Any, root: dict[str, Any]) -> dict[str, Any]:
    """Return the alternative of a union schema that the data selects.

    That is the only alternative, or the one with the data's `type`, or the default's `type` if the
    data has none, or the only alternative for mappings or lists. If none of these decides, the
    schema is returned unchanged.
    """
    node = dereferenced(node, root)
    options = alternatives(node, root)
    if len(options) == 1:
        about = {key: value for key, value in node.items() if key not in ("anyOf", "oneOf")}
        return _resolved({**options[0], **about}, data, root)
    wanted = data.get("type") if isinstance(data, dict) else None
    if wanted is None and isinstance(node.get("default"), dict):
        wanted = node["default"].get("type")
        options = [option for option in options if "type" not in option.get("required", ())]
    for option in options:
        if tag(option) is not None and tag(option) == wanted:
            return option
    kind = "object" if isinstance(data, dict) else "array"
    fitting = [option for option in options if option.get("type") == kind]
    return fitting[0] if len(fitting) == 1 else node


def dereferenced(node: dict[str, Any], root: dict[str, Any]) -> dict[str, Any]:
    """Return the schema that a node's `$ref` names, merged with the node's other entries.

    The node's own entries take precedence. A node without a `$ref` is returned as it is.
    """
    if "$ref" not in node:
        return node
    target = root["$defs"][node["$ref"].rpartition("/")[2]]
    return {**target, **{key: value for key, value in node.items() if key != "$ref"}}


def _unwrapped(value: Any) -> Any:
    """Replace line breaks by spaces in descriptions, at every depth.

    The descriptions come from docstrings, whose lines are wrapped.
    """
    if isinstance(value, dict):
        return {
            key: " ".join(item.split())
            if key == "description" and isinstance(item, str)
            else _unwrapped(item)
            for key, item in value.items()
        }
    return [_unwrapped(item) for item in value] if isinstance(value, list) else value
