"""A round of the multistart optimiser: what is scattered, and what is polished of it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import levenberg
from support import problems

from tetractl.control.cost import evaluate
from tetractl.control.curves import interpolate
from tetractl.control.kernels.levenberg import lay_out_polish
from tetractl.control.kernels.multistart import WARM, improve, scatter, workspace
from tetractl.control.kernels.rollout import lay_out
from tetractl.control.rng import uniform
from tetractl.core.poses import wrap

TOLERANCE, SLACK, PATIENCE, STEPS, MUCH = 1e-3, 0.5, 6, 8, 2**62


def polished(problem, starts, tolerance=TOLERANCE, budget=MUCH, look=0):
    """Return how many of the starts were polished, and what became of them."""
    count, length = starts.shape
    work, found = lay_out_polish(problem, length), workspace.__wrapped__(0, count, length, STEPS)
    done, calls = 0, 0
    while calls == 0 or (look and done < count and calls < 1000):
        spent = int(found.evaluations[: done + 1].sum())
        limits = tolerance, SLACK, PATIENCE, budget - spent
        done, calls = improve(work, starts, done, *limits, look, found), calls + 1
    return done, found


def starts_of(seed, count, length):
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, length))


@pytest.mark.parametrize("model", ["euler", "arc", "exact"])
@pytest.mark.parametrize("look", [0, 1, 3])
def test_each_start_is_polished_as_it_is_alone_and_costs_j(model, look):
    problem, starts = problems.problem(problems.world(4, 3, 2, model)), starts_of(1, 3, 20)
    done, found = polished(problem, starts, look=look)
    assert done == 3
    for n, start in enumerate(starts):
        alone = levenberg.polish(problem, start, TOLERANCE, SLACK, STEPS, None, PATIENCE)
        assert found.signals[n] == pytest.approx(wrap(alone.signals), abs=1e-6)
        assert found.evaluations[n] == alone.evaluations + 1
        merits = found.merits[n, : found.steps[n] + 1]
        assert merits == pytest.approx(alone.history, rel=1e-6)
    assert found.costs == pytest.approx(evaluate(problem, found.signals).total, rel=1e-9)


def test_a_start_is_ended_as_it_is():
    problem, starts = problems.problem(problems.world(4, 3, 2, "exact")), starts_of(1, 3, 20)
    done, found = polished(problem, starts, look=-1)
    assert done == 3
    assert found.signals == pytest.approx(starts)
    assert found.costs == pytest.approx(evaluate(problem, starts).total, rel=1e-9)


@given(
    seed=st.integers(0, 2**32),
    length=st.integers(1, 30),
    knots=st.integers(1, 12),
    warmed=st.booleans(),
)
def test_a_round_is_scattered_as_the_readable_curves_are(seed, length, knots, warmed):
    problem, particles = problems.problem(problems.world(seed, 2, 1, "exact")), 9
    knots = min(knots, length)
    warm = starts_of(seed, 1, length)[0] if warmed else np.empty(0)
    signals, total = np.empty((length, particles)), np.empty(particles)
    scratch = np.empty((knots, particles))
    assert scatter(lay_out(problem, particles), np.uint64(seed), 0.7, warm, scratch, signals, total)
    draws = 2 * uniform(seed, 0, knots * particles).reshape(knots, particles) - 1
    curve = interpolate(draws, length)
    expected = 0.7 + math.pi * curve
    if warmed:
        expected[:, ::2] = warm[:, None] + WARM * curve[:, ::2]
    assert np.abs(wrap(signals - expected)).max() < 1e-9
    assert np.abs(signals).max() <= math.pi + 1e-9
    assert total == pytest.approx(evaluate(problem, signals.T).total, rel=1e-9)


def test_the_first_that_is_good_enough_is_the_last():
    problem, starts = problems.problem(problems.world(4, 3, 0, "exact")), starts_of(2, 4, 20)
    _, all_of_them = polished(problem, starts)
    least = int(np.argmin(all_of_them.costs))
    done, found = polished(problem, starts, float(all_of_them.costs[least]))
    assert done == least + 1
    assert found.costs[least] == pytest.approx(all_of_them.costs[least], rel=1e-6)


@given(st.integers(0, 400))
def test_a_round_keeps_its_budget(budget):
    problem, starts = problems.problem(problems.world(4, 2, 1, "exact")), starts_of(3, 4, 12)
    done, found = polished(problem, starts, budget=budget)
    spent = int(found.evaluations[:done].sum())
    assert spent <= budget
    assert done == 4 or budget - spent < 2
