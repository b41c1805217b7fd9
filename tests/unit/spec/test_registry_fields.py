"""Tests of fields that choose a kind by its name, with kinds of a made-up registry."""

from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, ValidationError

from tetractl.core.registry import Registry
from tetractl.spec.base import STRICT_CONTEXT, Model
from tetractl.spec.registry_fields import KindName, KindSection, OrMapping
from tetractl.spec.schema import resolve_reference


class Base(Model):
    """What every kind is."""

    type: Any


class Red(Base):
    """The default kind."""

    type: Literal["red"] = "red"
    depth: float = 1.0


class Blue(Base):
    """Another kind."""

    type: Literal["blue"]
    size: int


class Alien(Model):
    """A kind of something else."""

    type: Literal["alien"] = "alien"


KINDS = Registry("tetractl.hues", {name: f"x:{name}" for name in ("red", "blue", "alien")})
CLASSES = {"red": Red, "blue": Blue, "alien": Alien}


@pytest.fixture(autouse=True)
def classes(monkeypatch):
    monkeypatch.setattr(KINDS, "load", CLASSES.__getitem__)
    monkeypatch.setattr(KINDS, "_installed", {})


RED = KindSection(KINDS, Base, default="red")
ANY = KindSection(KINDS, Base)


class Holder(Model):
    """Has a field of each form."""

    hue: Annotated[Base, RED] = Field(default_factory=RED.make)
    other: Annotated[Base, ANY] | None = None
    name: Annotated[str, KindName(KINDS)] = "red"
    rate: Annotated[float | Red, OrMapping(float, Red, lambda mapping: Red, lambda: [Red])] = 1.0


def error(**fields):
    with pytest.raises(ValidationError) as caught:
        Holder.model_validate(fields)
    (only,) = caught.value.errors()
    return only


def test_a_mapping_is_of_the_kind_that_its_type_names():
    holder = Holder.model_validate({"hue": {"type": "blue", "size": 3}, "other": {"type": "red"}})
    assert holder.hue == Blue(type="blue", size=3)
    assert holder.other == Red()


def test_the_default_kind_needs_no_type_and_is_made_if_nothing_is_given():
    assert Holder.model_validate({"hue": {"depth": 2}}).hue == Red(depth=2)
    assert Holder().hue == Red()
    assert Holder.model_validate({"hue": Red(depth=7)}).hue == Red(depth=7)


def test_a_kind_without_a_default_needs_a_type():
    found = error(other={"size": 3})
    assert found["type"] == "union_tag_not_found"
    assert found["ctx"]["known"] == {"red": "red", "blue": "blue", "alien": "alien"}


@pytest.mark.parametrize("name", ["green", 3, ["red"]])
def test_an_unknown_kind_is_refused_with_those_that_are_known(name):
    found = error(hue={"type": name})
    assert found["type"] == "union_tag_invalid"
    assert list(found["ctx"]["known"]) == ["red", "blue", "alien"]


def test_a_kind_of_another_base_cannot_be_chosen_and_is_not_listed():
    found = error(hue={"type": "alien"})
    assert found["type"] == "union_tag_invalid"
    assert list(found["ctx"]["known"]) == ["red", "blue"]


@pytest.mark.parametrize("value", [5, "red", [1], None])
def test_a_section_is_a_mapping(value):
    assert error(hue=value)["type"] == "model_type"


def test_a_kind_of_a_package_that_is_not_installed_names_the_package(monkeypatch):
    monkeypatch.setattr(KINDS, "group", "tetractl.cameras")
    found = error(hue={"type": "cells"})
    assert found["type"] == "not_installed"
    assert found["ctx"]["why"].startswith("needs tetractl-microscope, which is not installed: pip")


def test_a_wrong_field_of_a_kind_is_an_error_of_that_field():
    assert error(hue={"type": "blue", "size": "x"})["loc"] == ("hue", "size")
    assert error(hue={"depth": 1, "size": 2})["type"] == "extra_forbidden"


@pytest.mark.parametrize(
    ("context", "is_strict"), [(STRICT_CONTEXT, True), (None, False), ({}, False)]
)
def test_a_section_is_as_strict_as_what_holds_it(context, is_strict):
    fields = {"hue": {"depth": "2"}, "rate": {"depth": "3"}}
    if is_strict:
        with pytest.raises(ValidationError):
            Holder.model_validate(fields, context=context)
    else:
        holder = Holder.model_validate(fields, context=context)
        assert (holder.hue.depth, holder.rate.depth) == (2, 3)


def test_a_value_or_a_mapping():
    assert Holder.model_validate({"rate": 2.5}).rate == 2.5
    assert Holder.model_validate({"rate": {"depth": 3}}).rate == Red(depth=3)
    assert Holder.model_validate({"rate": Red(depth=4)}).rate == Red(depth=4)
    assert error(rate="fast")["loc"] == ("rate",)
    assert error(rate={"size": 4})["loc"] == ("rate", "size")


def test_the_name_of_a_kind_must_be_registered():
    assert Holder.model_validate({"name": "blue"}).name == "blue"
    assert error(name="green")["type"] == "literal_error"
    assert error(name=5)["type"] == "string_type"


def test_the_schema_lists_the_kinds_that_can_be_used():
    schema = Holder.model_json_schema()
    hue = schema["properties"]["hue"]
    assert hue["default"] == {"type": "red"}
    red, blue = (resolve_reference(option, schema) for option in hue["oneOf"])
    assert "type" not in red.get("required", [])  # a mapping without `type` is red
    assert blue["required"] == ["type", "size"]
    other = schema["properties"]["other"]["anyOf"][0]
    assert "default" not in other
    red, blue = (resolve_reference(option, schema) for option in other["oneOf"])
    assert red["required"] == ["type"]
    assert blue["required"] == ["type", "size"]
    assert schema["properties"]["name"]["enum"] == ["red", "blue", "alien"]
    number, mapping = schema["properties"]["rate"]["anyOf"]
    assert number["type"] == "number"
    assert "depth" in resolve_reference(mapping, schema)["properties"]


def test_a_kind_that_cannot_be_used_is_left_out_of_the_schema(monkeypatch):
    monkeypatch.setattr(KINDS, "load_usable", lambda: {"blue": Blue, "alien": Alien})
    hue = Holder.model_json_schema()["properties"]["hue"]
    assert len(hue["oneOf"]) == 1
