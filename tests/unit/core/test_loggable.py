"""Tests of what a controller may decide: what can be sent and logged passes, anything else not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.loggable import (
    DRAWING_PRECISION,
    NUMBER_NAME_MAX,
    NUMBERS_MAX,
    STOP_REASON_MAX,
    check_actions,
    check_plan,
    require_finite,
    round_for_drawing,
    stop_reason,
)
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Plan, Search, StopReason

NAN, INF = math.nan, math.inf
SINGLE = 2.0**-24
"""Relative rounding error of single precision, to which a number is converted first."""
SEARCH = Search(2, np.array([0.1, 0.2]), 5.0, np.array([9.0, 5.0]), 40, StopReason.CRITERION)
PLAN = Plan(
    signals=np.array([0.1, 0.2]),
    path=np.zeros((3, 4, 3)),
    cost=5.0,
    target_cost=4.0,
    obstacle_cost=1.0,
    searches=(SEARCH,),
    chosen=0,
    generator=1,
    numbers={"margin_mm": 3.0},
)
ROBOTS = 4


def with_search(**fields):
    return replace(PLAN, searches=(SEARCH, replace(SEARCH, **fields)))


def with_estimate(**fields):
    ones = np.ones(ROBOTS)
    return replace(PLAN, estimate=replace(Estimate(ones, ones, ones, ones), **fields))


def path_with(row, value):
    path = np.zeros((3, ROBOTS, 3))
    path[2, 3, row] = value
    return path


INNOCENT = {
    "as it is": PLAN,
    "no searches": replace(PLAN, searches=(), signals=np.zeros(0), path=np.zeros((1, ROBOTS, 3))),
    "a heading that is unknown": replace(PLAN, path=path_with(2, NAN)),
    "a reason of its own": with_search(stopped="because"),
    "one entry of history": with_search(history=np.array([5.0])),
    "many numbers": replace(PLAN, numbers={f"n{i}": 1.0 for i in range(NUMBERS_MAX)}),
    "a long name": replace(PLAN, numbers={"n" * NUMBER_NAME_MAX: 1.0}),
    "an estimate": with_estimate(dead_time=0.1, misfit=np.ones((ROBOTS, 3)), lag=np.ones(ROBOTS)),
    "a negative cost": replace(PLAN, cost=-1.0),
}


@pytest.mark.parametrize("case", INNOCENT)
def test_a_plan_that_can_be_logged_passes(case):
    check_plan(INNOCENT[case], ROBOTS)


REFUSED = {
    "signals in rows": (replace(PLAN, signals=np.zeros((2, 1))), "a path has shape"),
    "a path too short": (replace(PLAN, path=np.zeros((2, ROBOTS, 3))), "a path has shape"),
    "a path too long": (replace(PLAN, path=np.zeros((4, ROBOTS, 3))), "a path has shape"),
    "a robot too few": (replace(PLAN, path=np.zeros((3, 3, 3))), "a path has shape"),
    "no headings": (replace(PLAN, path=np.zeros((3, ROBOTS, 2))), "a path has shape"),
    "a search of another length": (with_search(length=3), "of a search is 3, but"),
    "a search of no length": (with_search(length=0, signals=np.zeros(0)), "of a search is 0, but"),
    "a search of a huge length": (with_search(length=10**30), "more than 20 digits"),
    "no history": (
        with_search(history=np.zeros(0)),
        "the history of a search must be a list of one or more numbers",
    ),
    "history in rows": (
        with_search(history=np.zeros((2, 2))),
        "the history of a search must be a list of one or more numbers",
    ),
    "a reason that is no text": (with_search(stopped=5), "must be a string, but it is of type int"),
    "too many numbers": (
        replace(PLAN, numbers={f"n{i}": 1.0 for i in range(NUMBERS_MAX + 1)}),
        "has 101 entries",
    ),
    "a name of two words": (replace(PLAN, numbers={"a b": 1.0}), "the entry 'a b'"),
    "an empty name": (replace(PLAN, numbers={"": 1.0}), "the entry ''"),
    "a name too long": (replace(PLAN, numbers={"n" * 61: 1.0}), "the entry 'nnn"),
    "a position": (replace(PLAN, path=path_with(1, NAN)), "a predicted position is nan"),
    "a position too large": (
        replace(PLAN, path=path_with(0, 1e300)),
        "a predicted position is inf",
    ),
    "a signal": (replace(PLAN, signals=np.array([0.1, INF])), "a signal is inf"),
    "a signal of a search": (with_search(signals=np.array([0.1, NAN])), "a signal is nan"),
    "a cost": (replace(PLAN, cost=NAN), "a cost is nan"),
    "the cost of targets": (replace(PLAN, target_cost=INF), "a cost is inf"),
    "the cost of obstacles": (replace(PLAN, obstacle_cost=NAN), "a cost is nan"),
    "the cost of a search": (with_search(cost=NAN), "a cost is nan"),
    "a cost of history": (with_search(history=np.array([NAN, 1.0])), "a cost is nan"),
    "a number": (replace(PLAN, numbers={"a": 1.0, "b": NAN}), "the number b is nan"),
    "an a": (with_estimate(a=np.array([1, 1, 1, NAN])), "an estimated a is nan"),
    "a dead time": (with_estimate(dead_time=INF), "an estimated dead_time is inf"),
    "a lag of fewer": (with_estimate(lag=np.ones(3)), r"an estimated lag has shape \(3,\)"),
    "a misfit per robot": (with_estimate(misfit=np.ones(ROBOTS)), "an estimated misfit has shape"),
    "an a in columns": (with_estimate(a=np.ones((ROBOTS, 3))), "an estimated a has shape"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_plan_that_cannot_be_logged_is_refused_with_its_first_wrong_value(case):
    wrong, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        check_plan(wrong, ROBOTS)


def test_actions_with_finite_numbers_pass():
    check_actions([Steer(0.1), Steer(-9.0, 0.2), Turn(1.0), Stop(), FieldOff()])
    check_actions([])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (Steer(NAN), "a direction is nan"),
        (Steer(INF, 0.1), "a direction is inf"),
        (Turn(-INF), "a direction is -inf"),
        (Steer(0.1, NAN), "the lag of the wheels is nan"),
    ],
)
def test_an_action_without_a_finite_number_is_refused(action, message):
    with pytest.raises(ValueError, match=message):
        check_actions([Steer(0.1), action])


def test_only_values_that_are_not_finite_are_refused():
    require_finite("x", [])
    require_finite("x", [1e308, -1e308, 0.0])
    for wrong in (NAN, INF, -INF):
        with pytest.raises(ValueError, match=f"^x is {wrong!r}$"):
            require_finite("x", [1.0, wrong, 2.0])


@given(st.floats(-1e30, 1e30).filter(lambda x: x == 0 or abs(x) > 1e-30))
def test_a_number_for_drawing_is_rounded_to_fourteen_bits(x):
    (rounded,) = round_for_drawing(np.array([x])).tolist()
    assert abs(rounded - x) <= (DRAWING_PRECISION + SINGLE) * abs(x)
    fraction, _ = math.frexp(rounded)
    assert (fraction * 2**15).is_integer()
    assert round_for_drawing(np.array([rounded])).tolist() == [rounded]


def test_the_stated_precision_is_that_of_the_worst_number():
    values = np.random.default_rng(3).uniform(1, 2, 10_000)
    worst = np.abs(round_for_drawing(values) / values - 1).max()
    assert DRAWING_PRECISION / 2 < worst <= DRAWING_PRECISION + SINGLE


def test_what_is_exact_in_fourteen_bits_stays():
    values = np.array([0.0, 1.0, -1.5, 1024.0, 0.25])
    assert round_for_drawing(values).tolist() == values.tolist()
    assert round_for_drawing(np.array([[1.0, 2.0]])).shape == (1, 2)


@pytest.mark.parametrize("reason", StopReason)
def test_a_known_reason_is_found_by_its_text(reason):
    assert stop_reason(reason.value) is reason


def test_an_unknown_reason_is_kept_but_short_and_printable():
    assert stop_reason("of its own") == "of its own"
    long = stop_reason("x" * 1000)
    assert len(long) == STOP_REASON_MAX
    assert stop_reason("a\x1b[2J").isprintable()
