"""Tests of one round of the multistart optimiser: its random starts, and those it polishes."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import problems
from testkit.curves import bearing, interpolate

from tetractl.control.search.cost import evaluate
from tetractl.control.search.kernels import multistart as kernel
from tetractl.control.search.kernels.levenberg import PolishSettings, workspace_for
from tetractl.control.search.kernels.motion import flatten
from tetractl.control.search.kernels.multistart import (
    NEAR_WARM,
    POLISH,
    SCATTER,
    UNLIMITED,
    SearchTask,
)
from tetractl.control.search.kernels.rollout import rollouts_of
from tetractl.control.search.rng import mix, uniform
from tetractl.core.poses import wrap

pytestmark = pytest.mark.slow

TOLERANCE = 1e-3
SLACK = 0.5
PATIENCE = 6
STEPS = 8
NONE = np.empty(0)


def searched(
    problem,
    starts,
    tolerance=TOLERANCE,
    budget=UNLIMITED,
    look=UNLIMITED,
    *,
    warm=NONE,
    rounds=0,
    best=4,
    particles=9,
    knots=3,
    key=1,
):
    """Return how a search ended, and what became of its starts (S, L) and rounds."""
    count, length = starts.shape
    found = kernel.rounds_for.__wrapped__(
        0, max(count, best), particles, knots, length, STEPS, rounds
    )
    found.begin(POLISH if count else SCATTER, starts)
    task = SearchTask(
        problem=flatten(problem),
        rollouts=rollouts_of(0, len(problem.a), particles),
        workspace=workspace_for(problem, length),
        settings=PolishSettings(tolerance, SLACK, PATIENCE, STEPS),
        key=np.uint64(key),
        warm=warm,
        rounds=rounds,
        budget=budget,
    )
    how = kernel.UNDER_WAY
    while how == kernel.UNDER_WAY:
        how = kernel.search(task, found, look)
    return how, found


def starts_of(seed, count, length):
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, length))


@pytest.mark.parametrize("model", ["euler", "exact"])
@pytest.mark.parametrize("look", [1, 3])
def test_each_start_is_polished_alike_whatever_the_looks_and_costs_j(model, look):
    problem = problems.problem(problems.world(4, 3, 2, model))
    for start in starts_of(1, 3, 20):
        how, result = searched(problem, start[None], look=look)
        _, alone = searched(problem, start[None])
        assert how == kernel.OVER
        assert (result.signals == alone.signals).all()
        assert result.state.evaluations == alone.state.evaluations
        merits = result.merits[: result.polish.iterations + 1]
        assert merits[-1] < merits[0]
        cost = evaluate(problem, result.signals[None]).total[0]
        assert result.state.best_cost == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize("look", [UNLIMITED, 1, 3])
def test_the_best_of_all_starts_is_kept_and_the_history_ends_with_its_cost(look):
    problem = problems.problem(problems.world(4, 3, 2, "exact"))
    starts = starts_of(1, 3, 20)
    alone = [searched(problem, start[None])[1] for start in starts]
    costs = [float(result.state.best_cost) for result in alone]
    how, together = searched(problem, starts, look=look)
    assert how == kernel.OVER
    assert together.state.best_cost == pytest.approx(min(costs), rel=1e-6)
    assert together.best == pytest.approx(alone[int(np.argmin(costs))].signals, abs=1e-6)
    history = together.history[: together.state.history_entries]
    assert history[-1] == together.state.best_cost
    assert (np.diff(history[-2:]) <= 0).all()
    assert together.state.evaluations == sum(result.state.evaluations for result in alone)


@given(
    seed=st.integers(0, 2**32),
    length=st.integers(1, 30),
    knots=st.integers(1, 12),
    warmed=st.booleans(),
    best=st.integers(1, 9),
)
def test_a_round_is_scattered_as_the_readable_curves_are(seed, length, knots, warmed, best):
    problem = problems.problem(problems.world(seed, 2, 1, "exact"))
    particles = 9
    knots = min(knots, length)
    warm = starts_of(seed, 1, length)[0] if warmed else NONE
    none = np.empty((0, length))
    sizes = {"rounds": 1, "best": best, "particles": particles, "knots": knots, "key": seed}
    _, result = searched(problem, none, budget=1, warm=warm, **sizes)
    draws = 2 * uniform(mix(seed, 0), 0, knots * particles).reshape(knots, particles) - 1
    curve = interpolate(draws, length)
    expected = bearing(problem) + math.pi * curve
    if warmed:
        expected[:, ::2] = warm[:, None] + NEAR_WARM * curve[:, ::2]
    assert np.abs(wrap(result.scattered - expected)).max() < 1e-9
    assert np.abs(result.scattered).max() <= math.pi + 1e-9
    assert result.scattered_costs == pytest.approx(
        evaluate(problem, result.scattered.T).total, rel=1e-9
    )
    order = np.argsort(result.scattered_costs, kind="stable")[:best]
    assert (result.starts == result.scattered[:, order].T).all()
    assert result.history[0] == result.scattered_costs.min()


def test_the_first_that_is_good_enough_is_the_last():
    problem = problems.problem(problems.world(4, 3, 0, "exact"))
    starts = starts_of(2, 4, 20)
    costs = [float(searched(problem, start[None])[1].state.best_cost) for start in starts]
    least = int(np.argmin(costs))
    how, result = searched(problem, starts, costs[least] * (1 + 1e-9))
    assert (how, result.state.starts_done) == (kernel.GOOD, least + 1)
    assert result.state.best_cost == pytest.approx(costs[least], rel=1e-6)


@given(st.integers(0, 600))
def test_a_search_keeps_its_budget(budget):
    problem = problems.problem(problems.world(4, 2, 1, "exact"))
    starts = starts_of(3, 4, 12)
    how, result = searched(problem, starts, budget=budget, rounds=1, particles=40)
    spent = int(result.state.evaluations)
    assert spent <= budget
    assert how == kernel.OVER or budget - spent < (40 if result.state.starts_done == 4 else 2)
