import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.registries import SWEEPS
from tetractl.study.sweep import Grid, Points, Random, Range, Sobol


def values(sweep, seed=1):
    points = sweep.draw(np.random.default_rng(seed))
    return [{path: one.value for path, one in point.items()} for point in points]


def test_every_kind_is_found_by_its_name():
    for name in SWEEPS.names():
        assert SWEEPS.load(name).model_fields["type"].annotation.__args__ == (name,)


def test_a_grid_is_every_combination_and_knows_where_each_value_is_written():
    sweep = Grid(type="grid", fields={"x": (1, 2), "y": ("a", "b", "c")})
    found = values(sweep)
    assert found[:4] == [
        {"x": 1, "y": "a"},
        {"x": 1, "y": "b"},
        {"x": 1, "y": "c"},
        {"x": 2, "y": "a"},
    ]
    assert len(found) == 6
    last = sweep.draw(np.random.default_rng(1))[-1]
    assert (last["x"].loc, last["y"].loc) == (("fields", "x", 1), ("fields", "y", 2))


def test_a_list_keeps_its_points():
    sweep = Points(type="list", points=({"x": 1}, {"x": 2, "y": (1, 2)}))
    assert values(sweep) == [{"x": 1}, {"x": 2, "y": (1, 2)}]
    assert sweep.draw(np.random.default_rng(1))[1]["y"].loc == ("points", 1, "y")


@pytest.mark.parametrize("kind", [Random, Sobol])
def test_draws_repeat_and_more_of_them_leave_the_first_alone(kind):
    fields = {"x": Range(low=0, high=1), "y": Range(low=1, high=100, scale="log")}
    few, many = (kind(type=kind.__name__.lower(), count=n, fields=fields) for n in (5, 23))
    assert values(few) == values(few) == values(many)[:5]
    assert values(few) != values(few, seed=2)
    assert len(values(many)) == 23


def test_sobol_fills_each_axis_evenly():
    """Of 2^m points of the sequence each interval of 1/2^m holds one, in every field."""
    fields = {name: Range(low=0, high=1) for name in "xyz"}
    found = values(Sobol(type="sobol", count=64, fields=fields))
    for name in "xyz":
        assert sorted(int(point[name] * 64) for point in found) == list(range(64))


@given(
    st.floats(-1e6, 1e6),
    st.floats(1e-3, 1e6),
    st.floats(0, 1, exclude_max=True),
    st.booleans(),
    st.booleans(),
)
def test_values_stay_in_their_range(low, width, share, log, whole):
    if log:
        low = abs(low) + 1
    if whole:
        low, width = float(round(low)), float(max(round(width), 1))
    range_ = Range(low=low, high=low + width, scale="log" if log else "linear", whole=whole)
    value = range_.at(share)
    assert range_.low <= value <= range_.high
    assert not whole or isinstance(value, int)
    assert range_.at(0.0) == pytest.approx(range_.low)


def test_whole_numbers_are_drawn_alike_often():
    found = [Range(low=2, high=5, whole=True).at(share) for share in np.arange(0, 1, 0.01)]
    assert [found.count(n) for n in (2, 3, 4, 5)] == [25] * 4


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
