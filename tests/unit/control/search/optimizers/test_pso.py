import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from testkit import problems
from testkit.references import paper as oracle

from tetractl.control.search.cost import evaluate
from tetractl.control.search.optimizers.pso import Pso
from tetractl.core.plan import Limits

pytestmark = pytest.mark.slow


def search(problem, length, warm, section, key, evaluations=None):
    return section.search(problem, length, warm, key, Limits(evaluations))


def random_start(seed, length):
    return np.random.default_rng(seed % 1000).uniform(-math.pi, math.pi, length)


NO_STOP = {"type": "budget"}


def swarm(particles=7, iterations=3, stop=NO_STOP, **weights):
    fields = {"particles": particles, "iterations": iterations, "stop": stop, **weights}
    return Pso.model_validate(fields)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    seed=st.integers(0, 2**64 - 1),
    particles=st.integers(1, 9),
    length=st.integers(2, 6),
    iterations=st.integers(1, 4),
    warm=st.booleans(),
    weights=st.fixed_dictionaries(
        {name: st.floats(0.1, 2) for name in ("inertia", "cognitive", "social")}
    ),
)
def test_the_swarm_moves_by_14_to_19(seed, particles, length, iterations, warm, weights):
    world = problems.world(seed % 1000)
    spec = swarm(particles, iterations, **weights)
    start = random_start(seed, length) if warm else None
    assume(problems.is_decided(problems.problem(world), length, start, spec, seed))
    slow = oracle.search(world, length, start, spec, seed, iterations)
    fast = search(problems.problem(world), length, start, spec, seed)
    assert fast.history == pytest.approx(slow.history, rel=1e-9)
    assert fast.signals == pytest.approx(slow.u_gb, abs=1e-9)
    assert fast.cost == fast.history[-1]
    assert (fast.length, fast.stopped) == (length, "iterations")
    assert fast.evaluations == particles * (iterations + 1) + warm
    assert spec.evaluations_max == particles * (iterations + 1) + 1
    if warm:  # the caller's array is left alone
        assert fast.signals is not start
        assert np.array_equal(start, random_start(seed, length))


def test_line_5_takes_a_bad_warm_start_and_19_then_drops_it():
    world = problems.world(1, robots=1, obstacles=0)
    problem = problems.problem(world)
    x, y, _, target_x, target_y, *_ = world.robots[0]
    away = np.full(8, math.atan2(y - target_y, x - target_x))
    result = search(problem, 8, away, swarm(30, 5), 11)
    assert result.history[0] == pytest.approx(evaluate(problem, away[None]).total[0], rel=1e-12)
    scattered = swarm(30, 5).create_swarm(problem, 8, away, 11)
    best = evaluate(problem, scattered.u_lb.T).total.min()
    assert result.history[0] > best  # taken without comparing it with the swarm
    assert result.history[1] <= best * (1 + 1e-12)


def test_the_paper_stop_ends_a_search_at_a_standstill():
    """One particle that knows the best already cannot improve on it, so log 0 stops at z = 11."""
    world = problems.world(2, robots=1, obstacles=0)
    x, y, theta, *_, a, v = world.robots[0]
    world.robots[0] = (x, y, theta, x + 0.2 * v * math.cos(theta) + 1, y, a, v)
    problem = problems.problem(world)
    one_particle = swarm(1, 100, {"type": "paper"})
    result = search(problem, 1, np.zeros(1), one_particle, 1)
    assert (len(result.history) - 1, result.stopped) == (11, "criterion")
