"""Tests of plans from given signals, bounds of the error, and the best moment to stop."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import problems

from tetractl.control.methods.fixed_sequence import find_best_stop, given_plan, make_plan, min_error
from tetractl.control.search.cost import evaluate, predict, predict_with_costs
from tetractl.core.clock import SECOND
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import StopReason

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32)


@given(SEEDS, st.integers(1, 6))
def test_a_given_plan_costs_what_its_signals_cost(seed, length):
    problem = problems.problem(problems.world(seed, 2, 3, "exact"))
    signals = np.random.default_rng(seed).uniform(-3, 3, length)
    plan = given_plan(problem, signals, 77)
    costs = evaluate(problem, signals[None])
    assert plan.cost == pytest.approx(costs.total[0])
    assert plan.target_cost == pytest.approx(costs.target[0])
    assert plan.obstacle_cost == costs.obstacle[0]
    assert plan.path == pytest.approx(predict(problem, signals))
    assert plan.signals.tolist() == signals.tolist()
    (search,) = plan.searches
    assert (search.evaluations, search.stopped) == (1, StopReason.FIXED)
    assert search.history.tolist() == [search.cost]
    assert search.length == length
    assert plan.generator == 77


def test_the_chosen_search_is_the_plan():
    problem = problems.problem(problems.world(1))
    searches = [
        replace(given_plan(problem, np.array([u]), 0).searches[0], cost=cost)
        for u, cost in ((0.1, 5.0), (0.2, 6.0), (0.3, 7.0))
    ]
    foreseen = predict_with_costs(problem, np.array([0.2]))
    plan = make_plan(searches, 1, 9, foreseen)
    assert (plan.chosen, plan.cost, plan.signals.tolist()) == (1, 6.0, [0.2])
    assert len(plan.searches) == 3


@given(SEEDS, st.floats(0.05, 0.5), st.booleans())
def test_robots_never_come_nearer_than_the_bound(seed, period_s, drifts):
    problem = problems.problem(problems.world(seed, 2, 0, "exact"), drifts=drifts)
    bound = min_error(problem, period_s)
    rng = np.random.default_rng(seed)
    for share in (0.3, 1.0):
        seconds = share * period_s
        held = replace(problem, first_period=seconds)
        for u in rng.uniform(-3, 3, 3):
            end = predict(held, np.array([u]))[-1]
            assert np.hypot(*(end[:, :2] - problem.targets).T).sum() >= bound - 1e-9


def test_the_bound_is_reached_by_robots_that_drive_straight_with_the_flow():
    problem = problems.problem(problems.world(1, 2, 0))
    gaps = problem.poses.distances(problem.targets)
    still = min_error(problem, 0.1)
    assert still == pytest.approx((gaps - 0.1 * problem.speed).sum())
    flow = np.array([[3.0, 4.0], [0.0, -2.0]])
    carried = min_error(replace(problem, flow=flow), 0.1)
    assert carried == pytest.approx(still - 0.1 * (5 + 2))


def passing(offset_s, robots=1):
    """Robots that pass their targets after some time, heading for 0."""
    problem = problems.problem(problems.world(1, robots, 0, "exact"))
    x = np.zeros(robots)
    poses = replace(problem.poses, x=x, y=np.arange(robots) * 50.0, heading=np.zeros(robots))
    speed = np.full(robots, 100.0)
    targets = np.column_stack([speed * offset_s, poses.y + 3.0])
    nothing = Obstacles.from_shapes([])
    return replace(problem, poses=poses, speed=speed, targets=targets, obstacles=nothing)


@pytest.mark.parametrize(
    ("offset_s", "stop_s"),
    [(-1.0, 0.0), (0.0, 0.0), (0.05, 0.05), (0.1, 0.1), (0.199, 0.195), (5.0, 0.195)],
)
def test_robots_stop_where_they_are_nearest(offset_s, stop_s):
    """Of 40 moments of a period of 0.2 s, whose end is not one."""
    delay_ns, error = find_best_stop(passing(offset_s), np.zeros(1), 0.2)
    assert delay_ns == pytest.approx(stop_s * SECOND, abs=2)
    assert error == pytest.approx(np.hypot(100 * (offset_s - stop_s), 3.0))


def test_the_error_is_the_sum_of_all_robots_and_one_may_stand():
    problem = passing(0.05, robots=2)
    delay_ns, error = find_best_stop(problem, np.array([0.0, np.nan]), 0.2)
    assert delay_ns == round(0.05 * SECOND)
    assert error == pytest.approx(3.0 + np.hypot(5.0, 3.0))
    delay_ns, _ = find_best_stop(problem, np.zeros(2), 0.2, n_moments=3)
    assert delay_ns == round(0.2 / 3 * SECOND)
