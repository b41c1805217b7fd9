"""Tests of the points of a study: grids, lists, and values sampled from ranges."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tetractl.core.registries import SWEEPS
from tetractl.study.sweep import Grid, Points, Random, Range, Sobol


def drawn(sweep, seed=1):
    """The points that a sweep draws, each with its entries by their paths."""
    return sweep.draw(np.random.default_rng(seed))


def plain(point):
    """The values of a point, without where they are written."""
    return {path: entry.value for path, entry in point.items()}


def values(sweep, seed=1):
    return [plain(point) for point in drawn(sweep, seed)]


GRID = Grid(type="grid", fields={"x": (1, 2), "y": ("a", "b", "c")})


def test_a_grid_is_every_combination():
    assert values(GRID) == [
        {"x": 1, "y": "a"},
        {"x": 1, "y": "b"},
        {"x": 1, "y": "c"},
        {"x": 2, "y": "a"},
        {"x": 2, "y": "b"},
        {"x": 2, "y": "c"},
    ]


def test_a_grid_knows_where_each_value_is_written():
    last = drawn(GRID)[-1]
    assert last["x"].loc == ("fields", "x", 1)
    assert last["y"].loc == ("fields", "y", 2)


FIELDS = {"x": Range(low=0, high=1), "y": Range(low=1, high=100, scale="log")}
FEW_RANDOM = Random(type="random", count=5, fields=FIELDS)
MANY_RANDOM = Random(type="random", count=23, fields=FIELDS)
FEW_SOBOL = Sobol(type="sobol", count=5, fields=FIELDS)
MANY_SOBOL = Sobol(type="sobol", count=23, fields=FIELDS)


@pytest.mark.parametrize("sweep", [FEW_RANDOM, FEW_SOBOL], ids=["random", "sobol"])
def test_draws_of_one_seed_repeat(sweep):
    assert values(sweep) == values(sweep)
    assert values(sweep) != values(sweep, seed=2)


@pytest.mark.parametrize(
    ("few", "many"),
    [(FEW_RANDOM, MANY_RANDOM), (FEW_SOBOL, MANY_SOBOL)],
    ids=["random", "sobol"],
)
def test_more_draws_leave_the_first_alone(few, many):
    assert len(values(many)) == 23
    assert values(many)[:5] == values(few)


def test_sobol_fills_each_axis_evenly():
    """Of 2^m points of the sequence each interval of 1/2^m holds one, in every field."""
    fields = {name: Range(low=0, high=1) for name in "xyz"}
    points = values(Sobol(type="sobol", count=64, fields=fields))
    for name in "xyz":
        intervals = sorted(int(point[name] * 64) for point in points)
        assert intervals == list(range(64))


widths = st.floats(1e-3, 1e6)
shares = st.floats(0, 1, exclude_max=True)


@given(st.floats(1, 1e6), widths, shares, st.sampled_from(["linear", "log"]))
def test_values_stay_in_their_range(low, width, share, scale):
    values_between = Range(low=low, high=low + width, scale=scale)
    assert values_between.low <= values_between.at(share) <= values_between.high
    assert values_between.at(0.0) == pytest.approx(values_between.low)


@given(
    st.integers(-1_000_000, 1_000_000),
    st.integers(1, 1_000_000),
    shares,
    st.sampled_from(["linear", "log"]),
)
def test_whole_numbers_stay_in_their_range(low, width, share, scale):
    assume(scale == "linear" or low > 0)
    whole_numbers = Range(low=low, high=low + width, scale=scale, whole=True)
    value = whole_numbers.at(share)
    assert isinstance(value, int)
    assert whole_numbers.low <= value <= whole_numbers.high
    assert whole_numbers.at(0.0) == whole_numbers.low


def test_whole_numbers_are_drawn_alike_often():
    two_to_five = Range(low=2, high=5, whole=True)
    numbers = [two_to_five.at(share) for share in np.arange(0, 1, 0.01)]
    assert [numbers.count(number) for number in (2, 3, 4, 5)] == [25, 25, 25, 25]


@pytest.mark.parametrize(
    "wrong",
    [
        {"low": 1, "high": 1},
        {"low": 0, "high": 1, "scale": "log"},
        {"low": 0.5, "high": 2, "whole": True},
    ],
)
def test_ranges_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=r"must be greater|needs whole"):
        Range(**wrong)


def test_every_kind_is_found_by_its_name():
    for name in SWEEPS.names():
        assert SWEEPS.load(name).model_fields["type"].annotation.__args__ == (name,)


LIST = Points(type="list", points=({"x": 1}, {"x": 2, "y": (1, 2)}))


def test_a_list_keeps_its_points():
    assert values(LIST) == [{"x": 1}, {"x": 2, "y": (1, 2)}]


def test_a_list_knows_where_each_value_is_written():
    assert drawn(LIST)[1]["y"].loc == ("points", 1, "y")
