"""Tests of what every optimiser must do, and of its parts."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit import problems

from tetractl.control.search.cost import evaluate
from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.control.search.optimizers.pso import Pso
from tetractl.core.errors import ControlError
from tetractl.core.plan import Limits, StopReason

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32)
EVERY = [
    Multistart(particles=12, polished=2, rounds=2),
    Pso(particles=12, iterations=8),
]
OPTIMIZERS = pytest.mark.parametrize("optimizer", EVERY, ids=["multistart", "pso"])


@OPTIMIZERS
@settings(max_examples=30, deadline=None)
@given(
    seed=SEEDS,
    robots=st.integers(1, 3),
    length=st.integers(2, 40),
    model=st.sampled_from(["euler", "exact"]),
    swept=st.booleans(),
    warm=st.booleans(),
    budget=st.none() | st.integers(14, 200),
)
def test_what_is_found_is_what_it_is_said_to_be(
    optimizer, seed, robots, length, model, swept, warm, budget
):
    problem = problems.problem(problems.world(seed, robots, 3, model, swept))
    start = optimizer.search(problem, length, None, seed + 1, Limits()).signals if warm else None
    result = optimizer.search(problem, length, start, seed, Limits(budget))
    assert result.signals.shape == (length,)
    assert np.all(np.abs(result.signals) <= math.pi)
    again = evaluate(problem, result.signals[None]).total[0]
    assert result.cost == pytest.approx(again, rel=1e-6, abs=1e-6)
    assert result.signals.dtype == result.history.dtype == np.float64
    assert result.history[-1] == result.cost
    assert np.all(np.diff(result.history) <= 0)
    good_enough = getattr(optimizer, "tolerance", 0.0)
    assert (result.cost <= good_enough) == (result.stopped is StopReason.TARGET)
    assert budget is None or result.evaluations <= budget
    if start is not None:
        assert result.cost <= evaluate(problem, start[None]).total[0] * (1 + 1e-6) + 1e-6


@OPTIMIZERS
def test_the_key_alone_decides_and_the_problem_is_left_alone(optimizer):
    problem = problems.problem(problems.world(1))
    before = pickle.dumps(problem)
    first, again, with_other_key = (
        optimizer.search(problem, 9, None, key, Limits()) for key in (1, 1, 2)
    )
    assert first.history.tobytes() == again.history.tobytes()
    assert first.signals.tobytes() == again.signals.tobytes()
    assert first.signals.tobytes() != with_other_key.signals.tobytes()
    assert pickle.dumps(problem) == before


@OPTIMIZERS
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_costs_that_are_not_finite_are_refused(optimizer, bad):
    world = problems.world(9, robots=2)
    world.robots[1] = (bad, *world.robots[1][1:])
    with pytest.raises(ControlError, match="not finite") as caught:
        optimizer.search(problems.problem(world), 4, None, 1, Limits())
    assert caught.value.hint
