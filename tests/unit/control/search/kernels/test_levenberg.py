"""Tests of the compiled Levenberg-Marquardt method: its merit, slopes, steps and limits."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit import problems
from testkit.references.polish import Polished, polish

from tetractl.control.search.cost import evaluate, predict
from tetractl.control.search.kernels import levenberg
from tetractl.control.search.kernels import multistart as kernel
from tetractl.control.search.kernels.gradient import trace
from tetractl.control.search.kernels.levenberg import (
    DEPTH_WEIGHT,
    PROGRESS,
    PolishSettings,
    workspace_for,
)
from tetractl.control.search.kernels.motion import flatten
from tetractl.control.search.kernels.rollout import rollouts_of
from tetractl.core.poses import wrap
from tetractl.tools.kernels import kernel_cache as kernels

pytestmark = pytest.mark.slow

MOTIONS = st.sampled_from(["euler", "exact"])
TOLERANCE = 1e-3
SLACK = 0.5
PATIENCE = 6


def compiled(problem, start, iterations, budget=2**62, patience=PATIENCE):
    rounds = kernel.rounds_for.__wrapped__(0, 1, 1, 1, len(start), iterations, 0)
    rounds.begin(kernel.POLISH, start[None])
    task = kernel.SearchTask(
        problem=flatten(problem),
        rollouts=rollouts_of(0, len(problem.a), 1),
        workspace=workspace_for(problem, len(start)),
        settings=PolishSettings(TOLERANCE, SLACK, patience, iterations),
        key=np.uint64(0),
        warm=np.empty(0),
        rounds=0,
        budget=max(budget, 1) + 1,
    )
    kernel.search(task, rounds, kernel.UNLIMITED)
    merits = rounds.merits[: rounds.polish.iterations + 1].copy()
    return Polished(rounds.signals, merits, rounds.state.evaluations - 1)


def merit(problem, signals, weight=DEPTH_WEIGHT, slack=0.0):
    """Bound of f, (8), and how deep the path is in obstacles and within the separation."""
    path = predict(problem, signals)[1:, :, :2]
    x, y = path.transpose(2, 0, 1)
    depths = slack - problem.obstacles.distances(x, y)
    deep = depths.max(axis=1).clip(0).sum()
    for i, k in itertools.combinations(range(len(problem.a)) if problem.separation else [], 2):
        nearest = np.hypot(*(path[:, i] - path[:, k]).T).min()
        deep += max(0.0, problem.separation - nearest + slack)
    return math.sqrt(len(problem.a) * ((path[-1] - problem.targets) ** 2).sum()) + weight * deep


@kernels.compiled()
def slopes(problem, room, signals):
    trace(signals, problem, room.path)
    levenberg.compute_merit(problem, room, SLACK)
    residuals = levenberg.linearise(problem, room, 1e-9, SLACK)
    return room.jacobian[:residuals].T @ room.residual[:residuals]


def random_start(seed, length):
    """A smooth sequence, as the optimiser polishes."""
    knots = np.random.default_rng(seed).uniform(-math.pi, math.pi, 4)
    return np.interp(np.linspace(0, 3, length), np.arange(4), knots)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("separation", [0.0, 300.0])
def test_the_jacobian_and_the_residuals_slope_as_what_they_are_made_of(seed, separation):
    """J'r is the gradient of the bound of f and W^2 times all depths, each grown by the slack."""
    problem = problems.problem(problems.world(seed, 3, 3, "exact"), separation)
    signals = random_start(seed, 12)
    step = 1e-5
    toward = np.random.default_rng(seed).normal(size=12)
    slope = slopes(flatten(problem), workspace_for(problem, 12), signals) @ toward
    ahead = merit(problem, signals + step * toward, DEPTH_WEIGHT**2, SLACK)
    behind = merit(problem, signals - step * toward, DEPTH_WEIGHT**2, SLACK)
    assert slope == pytest.approx((ahead - behind) / (2 * step), rel=1e-4, abs=1e-2)


@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 4),
    obstacles=st.integers(0, 4),
    length=st.integers(1, 30),
    motion=MOTIONS,
    separation=st.sampled_from([0.0, 90.0, 300.0]),
)
def test_the_history_is_that_of_the_merit(seed, robots, obstacles, length, motion, separation):
    problem = problems.problem(problems.world(seed, robots, obstacles, motion), separation)
    start = random_start(seed, length)
    polished = compiled(problem, start, 5)
    expected = [merit(problem, start), merit(problem, polished.signals)]
    assert polished.history[[0, -1]] == pytest.approx(expected, rel=1e-6, abs=1e-6)


@settings(max_examples=12)
@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 3),
    obstacles=st.integers(0, 3),
    length=st.integers(2, 10),
    separation=st.sampled_from([0.0, 300.0]),
    budget=st.sampled_from([40, 90, 10_000]),
    patience=st.sampled_from([2, PATIENCE]),
)
def test_each_iteration_is_that_of_the_slow_method(
    seed, robots, obstacles, length, separation, budget, patience
):
    problem = problems.problem(problems.world(seed, robots, obstacles, "exact"), separation)
    start = random_start(seed, length)
    polished = compiled(problem, start, 7, budget, patience)
    slow = polish(problem, start, PolishSettings(TOLERANCE, SLACK, patience, 7), budget)
    assert polished.history == pytest.approx(slow.history, rel=1e-3, abs=1e-3)
    assert polished.evaluations == slow.evaluations
    assert np.abs(wrap(polished.signals - slow.signals)).max() < 1e-3


@given(
    seed=st.integers(0, 2**32),
    obstacles=st.integers(0, 3),
    length=st.integers(1, 40),
    motion=MOTIONS,
    budget=st.integers(1, 400),
)
def test_a_polish_never_makes_it_worse_and_keeps_its_limits(
    seed, obstacles, length, motion, budget
):
    problem = problems.problem(problems.world(seed, 2, obstacles, motion))
    start = random_start(seed, length)
    start_before = random_start(seed, length)
    polished = compiled(problem, start, 20, budget)
    assert np.array_equal(start, start_before)
    assert np.all(np.diff(polished.history) <= 0)
    then = polished.history
    before = polished.history[PATIENCE - 1 :]
    now = polished.history[PATIENCE:]
    for z in range(len(now) - 1):  # all but the last
        assert now[z] == before[z] or now[z] <= PROGRESS * then[z]
    assert len(polished.history) <= 21
    assert polished.evaluations <= budget
    assert (
        evaluate(problem, polished.signals[None]).target[0]
        <= polished.history[-1] * (1 + 1e-9) + 1e-9
    )
