"""The compiled Levenberg-Marquardt against its readable twin, and what it promises."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import levenberg
from support import problems

from tetractl.control.cost import evaluate, predict
from tetractl.control.kernels.levenberg import lay_out_polish
from tetractl.control.kernels.multistart import improve, workspace

MOTIONS = st.sampled_from(["euler", "arc", "exact"])
TOLERANCE, SLACK, PATIENCE = 1e-3, 0.5, 6


def compiled(problem, start, iterations, budget=2**62):
    work, found = (
        lay_out_polish(problem, len(start)),
        workspace.__wrapped__(0, 1, len(start), iterations),
    )
    starts, limits = start[None].copy(), (TOLERANCE, SLACK, PATIENCE)
    done = improve(work, starts, 0, *limits, max(budget, 1) + 1, 0, found)
    assert done == 1
    merits = found.merits[0, : found.steps[0] + 1].copy()
    return levenberg.Polished(found.signals[0], merits[-1], merits, found.evaluations[0] - 1)


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
    budget=st.integers(1, 400),
)
def test_a_polish_never_makes_it_worse_and_keeps_its_limits(
    seed, obstacles, length, motion, budget
):
    problem = problems.problem(problems.world(seed, 2, obstacles, motion))
    start, kept = random_start(seed, length), random_start(seed, length)
    found = compiled(problem, start, 20, budget)
    assert np.array_equal(start, kept)
    assert np.all(np.diff(found.history) <= 0)
    assert found.merit == found.history[-1]
    assert len(found.history) <= 21
    assert found.evaluations <= budget
    assert evaluate(problem, found.signals[None]).target[0] <= found.merit * (1 + 1e-9) + 1e-9
