"""Tests of the costs of many sequences at once against the readable costs of each."""

import math
from dataclasses import replace
from threading import get_ident

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit import problems

from tetractl.control.search.cost import evaluate
from tetractl.control.search.evaluate import compiled_costs
from tetractl.control.search.kernels import rollout
from tetractl.control.search.kernels.motion import flatten
from tetractl.control.search.kernels.rollout import costs, rollouts_of
from tetractl.core.errors import ControlError
from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds
from tetractl.tools.kernels.kernel_cache import compiled

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32)


def random_problem(seed, robots, model, swept, separation, drifts, turns, walled):
    """Robots among three obstacles, some of which start in them or outside the walls."""
    world = problems.world(seed, robots, 3, model, swept)
    problem = problems.problem(world, separation, drifts)
    rng = np.random.default_rng([seed, 7])
    if walled:
        shapes = [thing.shape() for thing in world.obstacles]
        walls = Obstacles.from_shapes(shapes, 10.0, Bounds(60, 110, 640, 720))
        problem = replace(problem, obstacles=walls)
    if turns:
        saturation = np.where(rng.random(robots) < 0.5, 1.0, rng.uniform(0.2, 1, robots))
        side = rng.uniform(-0.3, 0.3, robots)
        problem = replace(problem, side=side, saturation=saturation)
    return replace(problem, first_period=float(rng.uniform(0.01, 0.3)))


@settings(max_examples=40)
@given(
    seed=SEEDS,
    robots=st.integers(1, 4),
    length=st.integers(1, 12),
    particles=st.integers(1, 12),
    model=st.sampled_from(["euler", "exact"]),
    swept=st.booleans(),
    separation=st.sampled_from([0.0, 150.0]),
    drifts=st.booleans(),
    turns=st.booleans(),
    walled=st.booleans(),
)
def test_each_sequence_costs_what_it_costs_alone(seed, length, particles, **world):
    problem = random_problem(seed, **world)
    rng = np.random.default_rng(seed)
    signals = rng.uniform(-math.pi, math.pi, (particles, length))
    together = compiled_costs(problem, particles)
    first = together(signals.T)
    expected = evaluate(problem, signals)
    assert first == pytest.approx(expected.total, rel=1e-9)
    assert together(signals.T).tolist() == first.tolist()  # in the same arrays


def test_random_problems_have_contacts_of_every_kind():
    """Otherwise the comparison above would compare nothing."""
    signals = np.random.default_rng(1).uniform(-math.pi, math.pi, (12, 12))
    for walled, separation in ((True, 0.0), (False, 150.0), (False, 0.0)):
        hits = [
            evaluate(
                random_problem(seed, 4, "exact", False, separation, True, False, walled), signals
            ).obstacle.mean()
            for seed in range(10)
        ]
        assert np.mean(hits) > 1


@compiled()
def count_meetings(x, y, separation, hits):
    rollout.count_meetings(x, y, separation, hits)


def test_each_pair_is_counted_once_and_at_the_separation_itself():
    """Three robots in a row, 30 and 40 apart, in two particles; the others meet in the second."""
    x = np.array([[0.0, 0.0], [30.0, 3.0], [70.0, 0.0]])
    y = np.array([[5.0, 0.0], [5.0, 4.0], [5.0, 1.0]])
    for separation, hits in ((29.9, [0, 3]), (30.0, [1, 3]), (40.0, [2, 3]), (70.0, [3, 3])):
        counted = np.zeros((3, 2))
        count_meetings(x, y, separation, counted)
        assert counted.sum(axis=0).tolist() == hits
        assert not counted[0].any()  # with robots before it alone


def test_a_cost_that_is_no_number_is_told_whichever_sequence_it_is_of():
    problem = problems.problem(problems.world(2, 2, 1, "exact"))
    signals = np.zeros((4, 3))
    total = np.empty(3)
    flat = flatten(problem)
    assert costs(flat, rollouts_of(get_ident(), 2, 3), signals, total)
    for particle in range(3):
        bad = signals.copy()
        bad[2, particle] = math.nan
        assert not costs(flat, rollouts_of(get_ident(), 2, 3), bad, total)
    poses = Poses.from_array(problem.poses.array() * math.inf)
    with pytest.raises(ControlError, match="not finite"):
        compiled_costs(replace(problem, poses=poses), 3)(signals)


def test_the_arrays_of_a_thread_are_shared_and_begin_at_cache_lines():
    rollouts = rollouts_of(1, 3, 5)
    assert rollouts_of(1, 3, 5) is rollouts
    assert rollouts_of(2, 3, 5) is not rollouts
    of_robots = [rollouts.x, rollouts.y, rollouts.cos, rollouts.sin, rollouts.contacts.hits]
    assert {values.shape for values in of_robots} == {(3, 5)}
    of_particles = [*rollouts[4:8], *rollouts.contacts[1:]]
    assert {values.shape for values in of_particles} == {(5,)}
    assert len(of_robots) + len(of_particles) == len(rollouts) - 1 + len(rollouts.contacts)
    assert rollouts.x.ctypes.data % 64 == 0
    assert rollouts.cos_u.ctypes.data % 64 == 0
    arrays = of_robots + of_particles
    for number, values in enumerate(arrays):
        values[...] = number
    assert all((values == number).all() for number, values in enumerate(arrays))  # none overlaps
