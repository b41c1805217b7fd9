"""Tests of pydantic's errors in plain words: what is said, at which place, and what is not."""

from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from tetractl.spec.base import Model, validate_document
from tetractl.spec.explain_errors import ERRORS_MAX, describe_list, explain_in_words
from tetractl.spec.load import parse_contents, parse_spec
from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import InvalidSpecError


class Inner(Model):
    """A section."""

    depth: float = Field(default=1.0, ge=0, lt=10)
    """How deep it is [m]. It is measured from the top."""
    label: str = Field(default="x", min_length=2, max_length=4)
    """Label: two to four letters. Used in figures."""
    code: str = Field(default="a", pattern="^[a-z]+$")
    """The code: lower-case letters."""


class Other(Model):
    """Another section."""

    kind: str = "other"


class Outer(Model):
    """A file."""

    count: int = Field(default=1, ge=1, le=5)
    """Number of things."""
    wide: bool = False
    """Whether it is wide."""
    inner: Inner = Inner()
    """A section of its own."""
    pair: tuple[float, float] = (0, 0)
    """Two numbers: the first and the last."""
    many: tuple[int, ...] = Field(default=(), max_length=2)
    few: Annotated[tuple[str, ...], Field(min_length=1)] = ("a",)
    mode: Literal["slow", "fast"] = "slow"
    """How it goes."""
    needed: float
    """IT is needed. Really."""
    also: str | None = None
    table: dict[str, int] = Field(default={})


GOOD = "needed: 1\n"


def problems(text, model: Any = Outer):
    with pytest.raises(InvalidSpecError) as caught:
        validate_document(model, parse_document(GOOD + text if model is Outer else text, "f"))
    return [str(problem).removeprefix("f:") for problem in caught.value.problems]


def problem(text):
    (only,) = problems(text)
    return only


CASES = {
    "count: 0": "2:8: count: 0: must be at least 1",
    "count: 6": "2:8: count: 6: must be at most 5",
    "count: 1.5": "2:8: count: 1.5: must be a whole number",
    "count: '3'": "2:8: count: '3': must be a whole number; take the quotes away",
    "count: three": "2:8: count: three: must be a whole number",
    "count: '1_000'": "2:8: count: '1_000': must be a whole number",
    "count: true": "2:8: count: true: must be a whole number",
    "count:": "2:7: count: has no value; must be a whole number",
    "wide: 1": "2:7: wide: 1: must be true or false",
    "inner: {depth: -1}": "2:16: inner.depth: -1: must be at least 0",
    "inner: {depth: 10}": "2:16: inner.depth: 10: must be less than 10",
    "inner: {depth: '0,5'}": "2:16: inner.depth: '0,5': must be a number; "
    "a decimal number has a point: 0.5",
    "inner: {depth: '1,2,3'}": "2:16: inner.depth: '1,2,3': must be a number",
    "inner: {depth: '.inf'}": "2:16: inner.depth: '.inf': must be a number",
    "inner: {depth: .inf}": "2:16: inner.depth: .inf: must be a finite number",
    "inner: {label: a}": "2:16: inner.label: a: must have at least 2 characters",
    "inner: {label: abcde}": "2:16: inner.label: abcde: must have at most 4 characters",
    "inner: {label: 12}": "2:16: inner.label: 12: must be text; put it in quotes",
    "inner: {label: [ab]}": "2:16: inner.label: [ab]: must be text",
    "inner: {code: A}": "2:15: inner.code: A: must be lower-case letters",
    "inner: {deph: 1}": "2:9: inner.deph: unknown key; did you mean 'depth'?",
    "inner: {count: 1}": "2:9: inner.count: unknown key; known here: depth, label, code",
    "inner: 5": "2:8: inner: 5: must be a mapping of keys to values",
    "inner:": "2:7: inner: has no value; must be a mapping of keys to values",
    "pair: [1]": "2:7: pair: [1]: must have 2 entries",
    "pair: [1, 2, 3]": "2:7: pair: [1, 2, 3]: must have at most 2 entries, not 3; "
    "a decimal number has a point, not a comma",
    "pair: [1, 2, x]": "2:7: pair: [1, 2, x]: must have at most 2 entries, not 3",
    "pair: [1, x]": "2:11: pair.1: x: must be a number",
    "pair: 5": "2:7: pair: 5: must be a list of 2 numbers: two numbers: the first and the last",
    "many: 5": "2:7: many: 5: must be a list of whole numbers",
    "many: [1, 2, 3]": "2:7: many: [1, 2, 3]: must have at most 2 entries, not 3; "
    "a decimal number has a point, not a comma",
    "few: []": "2:6: few: []: must have at least 1 entries",
    "few: {}": "2:6: few: must be a list of texts",
    "mode: fats": "2:7: mode: fats: must be one of slow, fast; did you mean 'fast'?",
    "mode: 7": "2:7: mode: 7: must be one of slow, fast",
    "depth: 1": "2:1: depth: unknown key here; did you mean 'inner.depth'?",
    "zzz: 1": "2:1: zzz: unknown key; known here: count, wide, inner, pair, many, few, mode, "
    "needed, also, table",
    "count:3: 1": "2:1: count:3: unknown key; a space is missing after the colon: count: 3",
    "also: 5": "2:7: also: 5: must be text; put it in quotes",
    "table: {a: x}": "2:12: table.a: x: must be a whole number",
    "table: 5": "2:8: table: 5: must be a mapping of keys to values",
}


@pytest.mark.parametrize("text", CASES)
def test_each_mistake_is_one_line_at_its_place(text):
    assert problem(f"{text}\n") == CASES[text]


def test_a_missing_field_is_named_with_the_first_sentence_about_it():
    assert problems("count: 1\n", _Needy)[0] == "1:1: needed: is missing; add it: IT is needed"
    assert problems("count: 1\n", _Bare) == ["1:1: needed: is missing; add it"]


class _Needy(Model):
    """Lacks a field."""

    count: int
    needed: float
    """IT is needed. Really."""


class _Bare(Model):
    """Lacks a field that nothing describes."""

    count: int
    needed: float


def test_all_mistakes_are_told_but_no_more_than_the_limit():
    assert len(problems("count: 0\nwide: 1\ninner: {depth: -1, label: a}\n")) == 4
    many = "".join(f"- {i}\n" for i in range(ERRORS_MAX + 5))
    with pytest.raises(InvalidSpecError) as caught:
        validate_document(_Texts, parse_document(f"texts:\n{many}", "f"))
    assert len(caught.value.problems) == ERRORS_MAX


class _Texts(Model):
    """Many texts."""

    texts: tuple[str, ...]


def test_a_value_that_yaml_refuses_is_one_mistake_and_not_two():
    assert problem("count: !!set {a}\n").startswith("2:8: count: the tag !!set does not fit")
    lines = problems("inner: {depth: !!set {a}, label: a}\n")
    assert [line.split(": ")[1] for line in lines] == ["inner.depth", "inner.label"]


def test_a_list_that_is_too_short_only_because_entries_are_wrong_is_not_called_short():
    assert problem("few: [5]\n") == "2:7: few.0: 5: must be text; put it in quotes"


@pytest.mark.parametrize(
    ("about", "text"),
    [
        ({"prefixItems": [{"type": "number"}] * 3}, "a list of 3 numbers"),
        ({"items": {"type": "string"}}, "a list of texts"),
        ({"items": {"type": "object"}, "description": "The points. More."}, "a list of entries: "
         "the points"),
        ({}, "a list of entries"),
    ],
)  # fmt: skip
def test_a_list_is_described_by_its_entries(about, text):
    assert describe_list(about) == text


def test_an_error_without_words_keeps_those_of_its_validator():
    details: Any = {"type": "value_error", "msg": "Value error, Must be even", "loc": ()}
    assert explain_in_words(details, 3) == "must be even"
    numbers: Any = {"type": "less_than", "msg": "", "loc": (), "ctx": {"lt": 10.0}}
    assert explain_in_words(numbers, 11) == "must be less than 10"


# in a spec

SPEC = {
    "name": "s",
    "arena": {"left": 0, "bottom": 0, "width": 100, "height": 100},
    "robots": [{"name": "r", "start": [10, 10], "target": [20, 20], "a": 3, "speed": 20}],
}


def in_spec(**changes):
    with pytest.raises(InvalidSpecError) as caught:
        parse_contents(SPEC | changes, "s")
    return [(problem.field, problem.message) for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("controller", "field", "says"),
    [
        ({"type": "mcp"}, "controller.type", "must be one of mpc, "),
        ({"type": 3}, "controller.type", "must be one of mpc, "),
        ({"type": "pso-mpc", "zzzz": 1}, "controller.zzzz", "unknown key; known here: "),
        ({"type": "mpc", "period": "x"}, "controller.period", "must be a number"),
        ({"horizon": 3}, "controller.horizon", "unknown key; did you mean 'horizon_max'?"),
        ({"optimizer": {"type": "pso", "starts": 1}}, "controller.optimizer.starts", "unknown key"),
        ({"optimizer": {}, "speed": 1}, "controller.speed", "unknown key"),
        (5, "controller", "must be a mapping of keys to values"),
    ],
)
def test_a_mistake_in_a_section_is_explained_by_its_own_kind(controller, field, says):
    ((found, message),) = in_spec(controller=controller)
    assert found == field
    assert message.startswith(says)


def test_the_type_of_an_obstacle_has_no_default():
    ((field, message),) = in_spec(obstacles=[{"radius": 3}])
    assert field == "obstacles.0.type"
    assert message == "is missing; must be one of rectangle, circle, polygon"


def test_robots_of_a_rule_that_is_not_there_are_explained():
    ((field, message),) = in_spec(robots={"pick": 3})
    assert field == "robots"
    assert message.startswith("must be a list, with each robot after a '-', or a mapping with the")


def test_a_rate_is_a_number_or_a_mapping():
    robot = SPEC["robots"][0]
    assert in_spec(robots=[robot | {"a": "x"}]) == [("robots.0.a", "must be a number")]
    ((field, message),) = in_spec(robots=[robot | {"a": {"per_mT": "x"}}], strength=1)
    assert (field, message) == ("robots.0.a.per_mT", "must be a number")


def test_two_mistakes_of_one_robot_are_two_lines():
    robot = SPEC["robots"][0] | {"speed": -1, "start": [1]}
    assert [field for field, _ in in_spec(robots=[robot])] == ["robots.0.start", "robots.0.speed"]


def test_a_start_with_a_heading_is_told_where_the_heading_belongs():
    robot = SPEC["robots"][0]
    ((_, message),) = in_spec(robots=[robot | {"start": [1, 2, 0.7]}])
    assert message.endswith("a heading is a field of its own, heading: 0.7")
    ((_, message),) = in_spec(robots=[robot | {"target": [1, 2, 0.7]}])
    assert "heading" not in message


def test_a_valid_spec_is_explained_by_nothing():
    assert parse_contents(SPEC, "s").experiment.name == "s"
    assert parse_spec("\n".join(f"{key}: {value}" for key, value in SPEC.items()), "s")
