"""Tests of which fitted values are named below a table: unusual ones and undetermined ones."""

import math

import pytest
from tetractl_identify.unusual import (
    USUAL_RANGES,
    describe_undetermined_values,
    describe_unusual_values,
    is_determined,
    may_be_usual,
)

from tetractl.tools.likelihood import SampleInterval

NOT_STATED = math.nan


def interval(value, reach):
    return SampleInterval(value, value - reach, value + reach)


@pytest.mark.parametrize(
    ("name", "value", "reach", "determined"),
    [
        ("dead_time", 0.1, 0.29, True),
        ("dead_time", 0.1, 0.31, False),
        ("turning_gain", 0.9, 0.49, True),
        ("turning_gain", 0.9, 0.51, False),
        ("speed_gain", -0.2, 0.49, True),
        ("speed_gain", 4.0, 1.9, True),  # a half of the value, if it is above 1
        ("speed_gain", 4.0, 2.1, False),
        ("speed_gain", -4.0, 1.9, True),
        ("veer", 0.1, 1e6, True),  # with any finite interval
        ("veer", 0.1, math.inf, False),
    ],
)
def test_a_value_is_determined_if_its_interval_is_narrow_enough(name, value, reach, determined):
    assert is_determined(name, interval(value, reach)) is determined


@pytest.mark.parametrize(("low", "high"), [(-1.0, 0.15), (0.05, 1.0)])
def test_the_farther_end_of_an_interval_counts(low, high):
    assert not is_determined("dead_time", SampleInterval(0.1, low, high))


@pytest.mark.parametrize(("low", "high"), [(-math.inf, 0.2), (0.0, math.inf)])
def test_an_interval_with_an_open_end_is_not_determined(low, high):
    assert not is_determined("turning_lag", SampleInterval(0.1, low, high))


def test_a_value_whose_interval_is_not_stated_is_not_called_undetermined():
    assert is_determined("dead_time", SampleInterval(0.1, NOT_STATED, NOT_STATED))


@pytest.mark.parametrize(
    ("low", "high", "may_be"),
    [(0.1, 0.49, False), (0.1, 0.5, True), (0.9, 1.1, True), (2.0, 3.0, True), (2.1, 3.0, False),
     (0.1, 9.0, True)],
)  # fmt: skip
def test_an_interval_may_be_usual_if_it_touches_the_usual_range(low, high, may_be):
    assert may_be_usual("turning_gain", SampleInterval((low + high) / 2, low, high)) is may_be


@pytest.mark.parametrize("name", USUAL_RANGES)
def test_a_value_in_the_middle_of_its_usual_range_is_not_named(name):
    low, high = USUAL_RANGES[name]
    middle = (low + high) / 2
    for reach in (0.0, (high - low) / 4, 2 * (high - low), NOT_STATED):
        assert describe_unusual_values([("one", {name: interval(middle, reach)})]) == ""


@pytest.mark.parametrize("name", USUAL_RANGES)
@pytest.mark.parametrize("reach", [1e-6, NOT_STATED])
def test_a_value_beyond_either_end_of_its_usual_range_is_named(name, reach):
    low, high = USUAL_RANGES[name]
    for value in (low - 0.01, high + 0.01):
        said = describe_unusual_values([("one", {name: interval(value, reach)})])
        assert said.startswith(f"the {name.replace('_', ' ')} of one is {value:.3g} (usual: ")
        assert f"(usual: {low:.3g} to {high:.3g}): work through the checklist" in said
    for value in (low, high):
        assert describe_unusual_values([("one", {name: interval(value, reach)})]) == ""


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("dead_time", 0.59, 0.61),
        ("dead_time", 0.0, -0.01),
        ("a", 0.051, 0.049),
        ("a", 49, 51),
        ("turning_gain", 0.51, 0.49),
        ("speed_gain", 1.99, 2.01),
        ("heading_bias", 0.78, 0.79),  # an eighth of a turn
        ("heading_bias", -0.78, -0.79),
        ("heading_offset", -0.19, -0.21),
    ],
)
def test_what_is_usual(name, inside, outside):
    assert describe_unusual_values([("one", {name: interval(inside, 1e-6)})]) == ""
    assert describe_unusual_values([("one", {name: interval(outside, 1e-6)})]) != ""


@pytest.mark.parametrize("name", ["dead_time", "a", "heading_bias", "heading_offset"])
def test_a_value_whose_interval_reaches_into_the_usual_range_is_not_named(name):
    low, high = USUAL_RANGES[name]
    assert describe_unusual_values([("one", {name: interval(low - 0.01, 0.02)})]) == ""
    assert describe_unusual_values([("one", {name: interval(high + 0.01, 0.02)})]) == ""


@pytest.mark.parametrize("name", ["turning_gain", "speed_gain"])
def test_a_gain_beyond_its_range_is_named_although_its_interval_reaches_into_it(name):
    """Except for a gain that the data hardly determine."""
    assert "is 2.1 " in describe_unusual_values([("one", {name: interval(2.1, 0.3)})])
    assert describe_unusual_values([("one", {name: interval(2.1, 1.5)})]) == ""
    assert "is 0.4 " in describe_unusual_values([("one", {name: interval(0.4, 0.2)})])
    assert describe_unusual_values([("one", {name: interval(0.4, 0.6)})]) == ""
    assert "is 9 " in describe_unusual_values([("one", {name: interval(9, 6.0)})])


def test_every_unusual_value_of_every_robot_is_named_in_one_sentence():
    robots = [
        ("one", {"a": interval(99, 1), "dead_time": interval(0.1, 0.01)}),
        ("two", {"a": interval(3, 1), "dead_time": interval(0.9, 0.01)}),
        ("three", {"dead_time": interval(-0.5, 0.01), "a": interval(0.01, 0.001)}),
    ]
    said = describe_unusual_values(robots)
    assert said.count("(usual: ") == 4
    assert said.count("checklist") == 1
    named = [part.split(" is ")[0] for part in said.split("; ")]
    assert named == [
        "the a of one",
        "the dead time of two",
        "the dead time of three",
        "the a of three",
    ]


def test_a_value_that_a_robot_lacks_is_not_named():
    assert describe_unusual_values([("one", {})]) == ""
    assert describe_unusual_values([]) == ""


def test_undetermined_values_are_listed_by_robot():
    known, unknown = interval(0.1, 0.01), interval(0.1, 9.0)
    names = ("dead_time", "turning_gain")
    robots = [
        ("one", {"dead_time": unknown, "turning_gain": unknown}),
        ("two", {"dead_time": known, "turning_gain": known}),
        ("three", {"dead_time": known, "turning_gain": unknown}),
    ]
    said = describe_undetermined_values(robots, names)
    assert said.startswith(
        "the data do not determine dead time, turning gain of one; turning gain of three. Record"
    )
    assert describe_undetermined_values(robots[1:2], names) == ""
    assert describe_undetermined_values(robots, ["dead_time"]).count(" of ") == 1
    assert describe_undetermined_values(robots, []) == ""
