"""A round of the multistart optimiser: what is scattered, and what is polished of it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import problems

from tetractl.control.cost import evaluate
from tetractl.control.kernels.levenberg import lay_out_polish, polish
from tetractl.control.kernels.multistart import polish_each, workspace
from tetractl.control.kernels.rollout import lay_out
from tetractl.core.poses import wrap

TOLERANCE, SLACK, PATIENCE, STEPS, MUCH = 1e-3, 0.5, 6, 8, 2**62


def polished(problem, starts, tolerance=TOLERANCE, budget=MUCH):
    """Return how many of the starts were polished, and what became of them."""
    count, length = starts.shape
    work, found = lay_out_polish(problem, length), workspace(count, length, STEPS)
    rows = len(work.residual)
    done = polish_each(
        work,
        lay_out(problem, 1),
        starts,
        tolerance,
        SLACK,
        PATIENCE,
        budget,
        np.empty((rows, rows)),
        found,
    )
    return done, found


def starts_of(seed, count, length):
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, length))


@pytest.mark.parametrize("model", ["euler", "arc", "exact"])
def test_each_start_is_polished_as_it_is_alone_and_costs_j(model):
    problem, starts = problems.problem(problems.world(4, 3, 2, model)), starts_of(1, 3, 20)
    done, found = polished(problem, starts)
    assert done == 3
    for n, start in enumerate(starts):
        work, alone, merits = lay_out_polish(problem, 20), start.copy(), np.empty(STEPS + 1)
        rows = len(work.residual)
        factor = np.empty((rows, rows))
        _, z, spent = polish(work, alone, TOLERANCE, SLACK, STEPS, PATIENCE, MUCH, factor, merits)
        assert found.signals[n] == pytest.approx(wrap(alone), abs=1e-12)
        assert (found.steps[n], found.evaluations[n]) == (z, spent)
        assert found.merits[n, : z + 1] == pytest.approx(merits[: z + 1], rel=1e-12)
    assert found.costs == pytest.approx(evaluate(problem, found.signals).total, rel=1e-9)


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
    spent = int(found.evaluations[:done].sum()) + done
    assert spent <= budget
    assert done == 4 or budget - spent < 2
