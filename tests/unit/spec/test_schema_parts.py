"""Tests of finding the part of a schema that describes a value, and the homes of a field."""

import pytest

from tetractl.spec.experiment import Experiment
from tetractl.spec.schema import (
    alternatives,
    child,
    dereferenced,
    describe,
    homes,
    schema_of,
    tag,
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
    return describe(loc, data, ROOT)


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
    assert child(data, step) == value


def test_alternatives_are_those_without_null():
    assert len(alternatives(ROOT["properties"]["maybe"], ROOT)) == 1
    assert [tag(one) for one in alternatives(ROOT["properties"]["hue"], ROOT)] == ["red", "blue"]
    assert alternatives(ROOT["properties"]["size"], ROOT) == []
    assert tag({"type": "number"}) is None


def test_a_reference_is_replaced_and_what_stands_beside_it_counts_more():
    node = {"$ref": "#/$defs/Red", "type": "mine"}
    assert dereferenced(node, ROOT)["type"] == "mine"
    assert "properties" in dereferenced(node, ROOT)
    assert dereferenced({"type": "x"}, ROOT) == {"type": "x"}


def test_every_place_of_a_field_is_found_once():
    assert list(homes("depth", ROOT)) == ["many.0.depth", "maybe.depth", "hue.depth", "any.depth"]
    assert list(homes("size", ROOT)) == ["size", "hue.size", "any.size"]
    assert list(homes("nothing", ROOT)) == []


def test_the_schema_of_a_spec_has_its_parts():
    schema = schema_of(Experiment)
    assert schema is schema_of(Experiment)
    assert "\n" not in schema["properties"]["robots"]["description"]
    data = {"robots": [{"a": 3}], "controller": {"type": "mpc"}}
    speed = describe(("robots", 0, "speed"), data, schema)
    assert speed["description"].startswith("Speed v [length unit/s]")
    period = describe(("controller", "period"), data, schema)
    assert period["minimum"] == 0.001
    assert "controller.optimizer.particles" in list(homes("particles", schema))
