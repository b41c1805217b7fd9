"""The readable Levenberg-Marquardt and its compiled twin, and what both promise."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from oracles import levenberg
from support import problems

from tetractl.control.cost import evaluate, predict
from tetractl.control.kernels.levenberg import lay_out_polish
from tetractl.control.kernels.levenberg import polish as compiled_polish

MOTIONS = st.sampled_from(["euler", "arc", "exact"])
TOLERANCE, SLACK, PATIENCE = 1e-3, 0.5, 6


def compiled(problem, start, iterations, budget=2**62):
    work = lay_out_polish(problem, len(start))
    rows, signals = len(work.residual), start.copy()
    history = np.empty(iterations + 1)
    merit, z, evaluations = compiled_polish(
        work,
        signals,
        TOLERANCE,
        SLACK,
        iterations,
        PATIENCE,
        budget,
        np.empty((rows, rows)),
        history,
    )
    return levenberg.Polished(signals, merit, history[: z + 1].copy(), evaluations)


def random_start(seed, length):
    """A smooth sequence, as the optimiser polishes."""
    knots = np.random.default_rng(seed).uniform(-math.pi, math.pi, 4)
    return np.interp(np.linspace(0, 3, length), np.arange(4), knots)


@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 4),
    obstacles=st.integers(0, 4),
    length=st.integers(1, 30),
    motion=MOTIONS,
    iterations=st.integers(1, 5),
    budget=st.none() | st.integers(1, 200),
    separation=st.sampled_from([0.0, 90.0, 300.0]),
)
def test_the_compiled_twin_takes_the_same_steps(
    seed, robots, obstacles, length, motion, iterations, budget, separation
):
    problem = problems.problem(problems.world(seed, robots, obstacles, motion), separation)
    start = random_start(seed, length)
    slow = levenberg.polish(problem, start, TOLERANCE, SLACK, iterations, budget, PATIENCE)
    fast = compiled(problem, start, iterations, 2**62 if budget is None else budget)
    assert fast.history == pytest.approx(slow.history, rel=1e-6, abs=1e-6)
    assert fast.evaluations == slow.evaluations
    assert predict(problem, fast.signals)[..., :2] == pytest.approx(
        predict(problem, slow.signals)[..., :2], abs=1e-3
    )


@given(
    seed=st.integers(0, 2**32),
    obstacles=st.integers(0, 3),
    length=st.integers(1, 40),
    motion=MOTIONS,
    twin=st.booleans(),
    budget=st.integers(1, 400),
)
def test_a_polish_never_makes_it_worse_and_keeps_its_limits(
    seed, obstacles, length, motion, twin, budget
):
    problem = problems.problem(problems.world(seed, 2, obstacles, motion))
    start, kept = random_start(seed, length), random_start(seed, length)
    if twin:
        found = compiled(problem, start, 20, budget)
    else:
        found = levenberg.polish(problem, start, TOLERANCE, SLACK, 20, budget, PATIENCE)
    assert np.array_equal(start, kept)
    assert np.all(np.diff(found.history) <= 0)
    assert found.merit == found.history[-1]
    assert len(found.history) <= 21
    assert found.evaluations <= budget
    assert evaluate(problem, found.signals[None]).target[0] <= found.merit * (1 + 1e-9) + 1e-9


@given(seed=st.integers(0, 2**32), length=st.integers(1, 20), motion=MOTIONS)
@example(0, 12, "euler")
def test_the_derivatives_are_those_of_the_prediction(seed, length, motion):
    """Against differences of whole predictions, one signal nudged at a time."""
    problem = problems.problem(problems.world(seed, 3, 0, motion))
    u, h = random_start(seed, length), 1e-5

    def numeric(j, h):
        nudge = h * np.eye(length)[j]
        return (predict(problem, u + nudge) - predict(problem, u - nudge))[1:, :, :2] / (2 * h)

    path, by_signal = levenberg.positions(problem, u)
    assert path == pytest.approx(predict(problem, u)[1:, :, :2], rel=1e-12)
    for j in range(length):
        difference = numeric(j, h)
        bent = np.abs(numeric(j, 2 * h) - difference)  # three times what the curve adds
        allowed = 1e-4 + 1e-5 * np.abs(difference) + bent
        assert np.all(np.abs(by_signal[..., j] - difference) <= allowed)


@pytest.mark.parametrize("twin", [False, True])
def test_one_robot_in_the_open_is_brought_to_its_target(twin):
    problem = problems.problem(problems.world(3, robots=1, obstacles=0, model="exact"))
    gap = problem.targets[0] - problem.poses.xy[0]
    length = math.ceil(1.5 * np.hypot(*gap) / problem.speed[0] / problem.period)
    start = np.linspace(0, 2, length)
    found = (
        compiled(problem, start, 60)
        if twin
        else levenberg.polish(problem, start, TOLERANCE, SLACK, 60, None, PATIENCE)
    )
    assert found.merit <= TOLERANCE
