"""The compiled Levenberg-Marquardt against its readable twin, and what it promises."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import levenberg
from support import problems

from tetractl.control.cost import evaluate, predict
from tetractl.control.kernels import multistart as kernel
from tetractl.control.kernels.levenberg import lay_out_polish
from tetractl.control.kernels.rollout import lay_out

pytestmark = pytest.mark.slow

MOTIONS = st.sampled_from(["euler", "arc", "exact"])
TOLERANCE, SLACK, PATIENCE = 1e-3, 0.5, 6


def compiled(problem, start, iterations, budget=2**62):
    found = kernel.workspace.__wrapped__(0, 1, 1, 1, len(start), iterations, 0)
    found.begin(start[None])
    laid = lay_out_polish(problem, len(start)), lay_out(problem, 1)
    limits = TOLERANCE, SLACK, PATIENCE, max(budget, 1) + 1, 0
    kernel.search(*laid, np.uint64(0), np.empty(0), 0, *limits, found)
    merits = found.merits[: found.at[kernel.STEPS] + 1].copy()
    evaluations = found.at[kernel.EVALUATIONS] - 1
    return levenberg.Polished(found.signals, merits[-1], merits, evaluations)


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
