import json
from typing import Annotated, Literal

import pytest
from pydantic import Discriminator, Field, Tag, ValidationError

from tetractl.experiment.base import Model, inconsistent
from tetractl.experiment.yaml.explain import data_loc


class Inner(Model):
    type: Literal["inner"] = "inner"
    size: int


class Other(Model):
    type: Literal["other"] = "other"
    parts: tuple[Inner, ...]


class Root(Model):
    plain: Inner | None = None
    tagged: Annotated[Inner | Other, Field(discriminator="type")] | None = None
    chosen: (
        Annotated[
            Annotated[Inner, Tag("inner")] | Annotated[Other, Tag("other")],
            Discriminator(lambda value: value.get("type", "inner")),
        ]
        | None
    ) = None


@pytest.mark.parametrize(
    ("data", "loc"),
    [
        ({"plain": {"size": "x"}}, ("plain", "size")),
        ({"plain": {"size": 1, "inner": 2}}, ("plain", "inner")),
        ({"plain": {"type": "inner", "size": 1, "inner": 2}}, ("plain", "inner")),
        ({"plain": {"type": "other", "size": 1}}, ("plain", "type")),
        ({"tagged": {"type": "inner", "size": "x"}}, ("tagged", "size")),
        ({"tagged": {"type": "inner"}}, ("tagged", "size")),
        ({"tagged": {"type": "inner", "size": 1, "inner": 2}}, ("tagged", "inner")),
        ({"tagged": {"type": "other", "parts": ({"size": "x"},)}}, ("tagged", "parts", 0, "size")),
        ({"tagged": {"type": "other", "parts": (3,)}}, ("tagged", "parts", 0)),
        ({"tagged": {"type": "neither"}}, ("tagged",)),
        ({"tagged": 3}, ("tagged",)),
        ({"chosen": {"size": "x"}}, ("chosen", "size")),
        ({"chosen": {"type": "inner"}}, ("chosen", "size")),
        ({"chosen": {"sizes": 1, "size": 1}}, ("chosen", "sizes")),
    ],
)
def test_the_tags_of_unions_are_no_part_of_the_place(data, loc):
    with pytest.raises(ValidationError) as caught:
        Root.model_validate(data, strict=True)
    (details,) = caught.value.errors()
    as_read = json.loads(json.dumps(data))  # lists for tuples, as YAML gives them
    assert data_loc(details, as_read) == loc


def test_a_validator_can_blame_a_field():
    error = inconsistent("size", "must be {even}, 100%")
    assert error.context == {"field": "size", "message": "must be {even}, 100%"}
    assert error.message() == "must be {even}, 100%"
