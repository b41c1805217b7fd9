"""Tests of the records of planning: problems for some robots, limits, and what a plan sends."""

from dataclasses import replace

import numpy as np
import pytest

from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.motion_estimate import Estimate
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Limits, Outcome, Plan, Problem, Search, StopReason, never_expires
from tetractl.core.poses import Poses

POSES = Poses.from_array(np.arange(9.0).reshape(3, 3))
PROBLEM = Problem(
    poses=POSES,
    targets=np.arange(6.0).reshape(3, 2),
    a=np.array([1.0, 2.0, 3.0]),
    speed=np.array([10.0, 20.0, 30.0]),
    motion="exact",
    period=0.2,
    first_period=0.05,
    obstacles=Obstacles.from_shapes(),
    obstacle_weight=1.0,
    swept=True,
)
MOVED = {
    "bias": np.array([0.0, 0.1, -0.2]),
    "flow": np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
    "side": np.array([0.3, 0.2, 0.1]),
    "saturation": np.array([0.7, 0.8, 0.9]),
}


def test_a_problem_of_some_robots_has_the_values_of_these():
    some = replace(PROBLEM, **MOVED).select_robots(np.array([True, False, True]))
    assert some.poses.array().tolist() == [[0, 1, 2], [6, 7, 8]]
    assert some.targets.tolist() == [[0, 1], [4, 5]]
    assert some.a.tolist() == [1, 3]
    assert some.speed.tolist() == [10, 30]
    assert some.bias.tolist() == [0.0, -0.2]
    assert some.flow.tolist() == [[1, 2], [5, 6]]
    assert some.side.tolist() == [0.3, 0.1]
    assert some.saturation.tolist() == [0.7, 0.9]
    assert (some.period, some.first_period, some.motion) == (0.2, 0.05, "exact")


def test_what_a_problem_does_not_state_no_part_of_it_states():
    some = PROBLEM.select_robots(np.array([False, True, False]))
    assert (some.bias, some.flow, some.side, some.saturation) == (None,) * 4
    assert PROBLEM.select_robots(np.ones(3, dtype=bool)) is PROBLEM


def test_the_drift_has_the_turn_by_the_bias_and_the_flow():
    cosine, sine, x, y = replace(PROBLEM, **MOVED).drift
    assert cosine == pytest.approx(np.cos(MOVED["bias"]))
    assert sine == pytest.approx(np.sin(MOVED["bias"]))
    assert x.tolist() == [1, 3, 5]
    assert y.tolist() == [2, 4, 6]
    none = PROBLEM.drift.tolist()
    assert none == [[1, 1, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize(("length", "seconds"), [(1, 0.05), (2, 0.25), (6, 1.05)])
def test_only_the_first_signal_of_a_sequence_has_a_duration_of_its_own(length, seconds):
    assert PROBLEM.seconds(length) == pytest.approx(seconds)


def test_a_search_may_use_as_many_evaluations_as_its_limit_and_no_more():
    limits = Limits(100)
    assert [limits.allow(count) for count in (0, 99, 100, 101)] == [True, True, True, False]
    assert Limits().allow(10**9)


def test_only_a_search_with_a_deadline_is_timed():
    assert not Limits(100).timed
    assert Limits(expired=lambda evaluations: True).timed
    assert not never_expires(10**9)


SEARCHES = tuple(
    Search(1, np.array([float(i)]), 1.0, np.array([1.0]), 10 + i, StopReason.CRITERION)
    for i in range(3)
)


def plan(**fields):
    made = {
        "signals": np.array([0.7, 0.8]),
        "path": np.zeros((3, 2, 3)),
        "cost": 1.0,
        "target_cost": 1.0,
        "obstacle_cost": 0.0,
        "searches": SEARCHES,
        "chosen": 1,
        "generator": 5,
    }
    return Plan(**(made | fields))


def estimate(lag):
    one = np.ones(2)
    return Estimate(one, one, one, one, lag=lag)


def test_a_plan_sends_its_first_direction():
    assert plan().action == Steer(0.7)
    assert plan().direction == 0.7
    assert not plan().pauses


@pytest.mark.parametrize(
    ("instead", "pauses"), [(Stop(), True), (Turn(1.5), True), (FieldOff(), False)]
)
def test_a_plan_sends_another_action_if_it_has_one(instead, pauses):
    other = plan(instead=instead)
    assert other.action == instead
    assert other.direction is None
    assert other.pauses is pauses


def test_a_plan_sends_the_mean_lag_that_its_controller_estimates():
    assert plan(estimate=estimate(np.array([0.1, 0.3]))).action == Steer(0.7, 0.2)
    assert plan(estimate=estimate(None)).action == Steer(0.7, None)


def test_the_searches_of_a_plan_are_added_up_and_the_chosen_one_is_found():
    assert plan().search is SEARCHES[1]
    assert plan().evaluations == 10 + 11 + 12
    assert plan(searches=()).evaluations == 0


def test_lost_robots_stay_where_they_are_in_the_path_of_a_plan():
    path = np.arange(18.0).reshape(3, 2, 3) + 100
    whole = plan(path=path).extend_to_all(np.array([True, False, True]), POSES)
    assert whole.path.shape == (3, 3, 3)
    assert (whole.path[:, [0, 2]] == path).all()
    assert whole.path[:, 1].tolist() == [[3, 4, 5]] * 3
    both = plan(path=path)
    assert both.extend_to_all(np.array([True, True]), POSES) is both


@pytest.mark.parametrize("outcome", Outcome)
def test_only_an_interruption_or_an_abort_leaves_a_trial_incomplete(outcome):
    assert outcome.complete == (outcome.value not in ("interrupted", "aborted"))
