"""Tests of finding the part of a schema that describes a value, and the homes of a field."""

import pytest

from tetractl.spec.experiment import Experiment
from tetractl.spec.schema import (
    find_field_paths,
    find_schema,
    get_child,
    get_type_name,
    list_alternatives,
    resolve_reference,
    schema_of,
)

ROOT = {
    "properties": {
        "size": {"type": "number"},
        "pair": {"prefixItems": [{"type": "number"}, {"type": "string"}]},
        "many": {"items": {"$ref": "#/$defs/Red"}},
        "table": {"additionalProperties": {"type": "boolean"}},
        "closed": {"properties": {"a": {}}, "additionalProperties": False},
        "maybe": {"anyOf": [{"$ref": "#/$defs/Red"}, {"type": "null"}], "description": "Maybe."},
        "hue": {
            "oneOf": [{"$ref": "#/$defs/Red"}, {"$ref": "#/$defs/Blue"}],
            "default": {"type": "red"},
        },
        "any": {"oneOf": [{"$ref": "#/$defs/NeedyRed"}, {"$ref": "#/$defs/Blue"}]},
        "form": {"anyOf": [{"type": "object", "title": "O"}, {"type": "array", "title": "A"},
                           {"type": "string"}]},
    },
    "$defs": {
        "Red": {
            "type": "object",
            "properties": {"type": {"const": "red"}, "depth": {"type": "number"}},
        },
        "NeedyRed": {
            "type": "object",
            "properties": {"type": {"const": "red"}, "depth": {"type": "integer"}},
            "required": ["type"],
        },
        "Blue": {
            "type": "object",
            "properties": {"type": {"const": "blue"}, "size": {"type": "string"}},
            "required": ["type"],
        },
    },
}  # fmt: skip


def about(*loc, data=None):
    return find_schema(loc, data, ROOT)


def test_a_field_is_described_by_its_entry():
    assert about("size") == {"type": "number"}
    assert about("pair", 0) == {"type": "number"}
    assert about("pair", 1) == {"type": "string"}
    assert about("table", "any name") == {"type": "boolean"}
    assert about("many", 7, "depth") == {"type": "number"}


@pytest.mark.parametrize(
    "loc", [("none",), ("size", "x"), ("pair", 2), ("closed", "b"), ("none", "x", 3)]
)
def test_what_the_schema_lacks_is_described_by_nothing(loc):
    assert about(*loc) == {}


def test_the_only_alternative_is_taken_with_the_words_about_the_field():
    maybe = about("maybe")
    assert maybe["description"] == "Maybe."
    assert "depth" in maybe["properties"]
    assert "anyOf" not in maybe
    assert about("maybe", "depth") == {"type": "number"}


def test_the_type_in_the_data_chooses_the_alternative():
    assert about("hue", "size", data={"hue": {"type": "blue"}}) == {"type": "string"}
    assert about("hue", "size", data={"hue": {"type": "red"}}) == {}
    assert about("any", "depth", data={"any": {"type": "red"}}) == {"type": "integer"}


def test_a_mapping_without_a_type_is_of_the_default():
    assert about("hue", "depth", data={"hue": {}}) == {"type": "number"}
    assert "oneOf" in about("any", data={"any": {}})


def test_an_unknown_type_leaves_all_alternatives():
    assert len(about("hue", data={"hue": {"type": "green"}})["oneOf"]) == 2


def test_the_form_of_the_data_chooses_between_a_mapping_and_a_list():
    assert about("form", data={"form": {}})["title"] == "O"
    assert about("form", data={"form": []})["title"] == "A"


@pytest.mark.parametrize(
    ("data", "step", "value"),
    [
        ({"a": 1}, "a", 1), ({"a": 1}, "b", None), ([1, 2], 1, 2), ([1, 2], 2, None),
        ([1, 2], "a", None), (5, "a", None), ("text", 0, None), (None, "a", None),
    ],
)  # fmt: skip
def test_the_value_at_a_key_or_index(data, step, value):
    assert get_child(data, step) == value


def test_alternatives_are_those_without_null():
    assert len(list_alternatives(ROOT["properties"]["maybe"], ROOT)) == 1
    assert [get_type_name(one) for one in list_alternatives(ROOT["properties"]["hue"], ROOT)] == [
        "red",
        "blue",
    ]
    assert list_alternatives(ROOT["properties"]["size"], ROOT) == []
    assert get_type_name({"type": "number"}) is None


def test_a_reference_is_replaced_and_what_stands_beside_it_counts_more():
    node = {"$ref": "#/$defs/Red", "type": "mine"}
    assert resolve_reference(node, ROOT)["type"] == "mine"
    assert "properties" in resolve_reference(node, ROOT)
    assert resolve_reference({"type": "x"}, ROOT) == {"type": "x"}


def test_every_place_of_a_field_is_found_once():
    assert list(find_field_paths("depth", ROOT)) == [
        "many.0.depth",
        "maybe.depth",
        "hue.depth",
        "any.depth",
    ]
    assert list(find_field_paths("size", ROOT)) == ["size", "hue.size", "any.size"]
    assert list(find_field_paths("nothing", ROOT)) == []


def test_the_schema_of_a_spec_has_its_parts():
    schema = schema_of(Experiment)
    assert schema is schema_of(Experiment)
    assert "\n" not in schema["properties"]["robots"]["description"]
    data = {"robots": [{"a": 3}], "controller": {"type": "mpc"}}
    speed = find_schema(("robots", 0, "speed"), data, schema)
    assert speed["description"].startswith("Speed v [length unit/s]")
    period = find_schema(("controller", "period"), data, schema)
    assert period["minimum"] == 0.001
    assert "controller.optimizer.particles" in list(find_field_paths("particles", schema))
