"""Rollers with unequal step-out, steered by direction and frequency of one field."""

import numpy as np
import pytest
from scipy.optimize import linprog

from tetractl.core.errors import UsageError
from tetractl.reproduce.roller_plan import Rollers

PAIR = Rollers(("one", "two"), np.array([1.0, 0.7]), np.array([69.8, 28.6]))


def test_below_the_step_out_speed_is_proportional_and_above_it_falls():
    assert PAIR.speeds([10.0, 28.6]) == pytest.approx(np.array([[10, 7], [28.6, 0.7 * 28.6]]))
    slipping = 0.7 * (69.8 - np.sqrt(69.8**2 - 28.6**2))
    assert PAIR.speeds(69.8) == pytest.approx([69.8, slipping])
    assert PAIR.speeds(1e9) == pytest.approx([0, 0], abs=1e-4)


def adler(frequency, step_out, seconds=300.0, step=2e-4):
    """Return the mean rate of a dipole that lags by p in a rotating field: p' = f - f_i sin p."""
    lag = 0.0
    for _ in range(round(seconds / step)):
        middle = lag + step / 2 * (frequency - step_out * np.sin(lag))
        lag += step * (frequency - step_out * np.sin(middle))
    return frequency - lag / seconds


@pytest.mark.parametrize("frequency", [2.0, 3.5, 8.0])
def test_the_speed_above_the_step_out_is_that_of_adlers_equation(frequency):
    roller = Rollers(("one",), np.ones(1), np.array([3.0]))
    assert roller.speeds(frequency)[0] == pytest.approx(
        adler(frequency, 3.0, seconds=60.0, step=2e-3), abs=0.06
    )


def test_a_plan_moves_every_robot_to_its_goal_in_any_number():
    three = Rollers(("a", "b", "c"), np.array([1.0, 2.0, 0.5]), np.array([70.0, 30.0, 12.0]))
    for rollers in (PAIR, three):
        goals = np.random.default_rng(1).normal(0, 300, (len(rollers.names), 2))
        legs = rollers.plan(goals)
        assert sum(rollers.moved(leg) for leg in legs) == pytest.approx(goals)
        assert [leg.seconds for leg in legs] == sorted((leg.seconds for leg in legs), reverse=True)


@pytest.mark.parametrize("seed", range(4))
def test_for_two_robots_no_plan_of_any_frequencies_is_faster(seed):
    goals = np.random.default_rng(seed).normal(0, 300, (2, 2))
    ours = sum(leg.seconds for leg in PAIR.plan(goals))
    f = np.linspace(0.5, 150, 150)
    u = np.linspace(-np.pi, np.pi, 120, endpoint=False)
    v = np.concatenate([PAIR.speeds(f), PAIR.speeds(PAIR.step_out)])
    moves = np.stack([np.outer(v[:, i], part) for i in (0, 1) for part in (np.cos(u), np.sin(u))])
    least = linprog(np.ones(moves[0].size), A_eq=moves.reshape(4, -1), b_eq=goals.ravel())
    assert ours <= least.fun * (1 + 1e-9)
    assert least.fun <= ours * 1.001  # of 120 directions one is within 1.5 degrees


def test_equal_step_outs_are_refused_in_one_line_that_says_why():
    same = Rollers(("one", "two"), np.array([1.0, 0.7]), np.array([28.6, 28.6]))
    with pytest.raises(UsageError) as caught:
        same.plan(np.ones((2, 2)))
    assert caught.value.message == (
        "reach 2 of 4: one and two move alike at every frequency, as their step-outs 28.6 and "
        "28.6 rad/s hardly differ"
    )
    assert PAIR.rank == 4
