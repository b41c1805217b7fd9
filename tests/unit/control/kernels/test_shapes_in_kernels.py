"""Polygons, and any set of kinds, in every kernel: against the readable twins."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import levenberg
from support import problems

from tetractl.control.cost import evaluate, predict
from tetractl.control.evaluate import compiled_costs
from tetractl.control.kernels.levenberg import lay_out_polish
from tetractl.control.kernels.levenberg import polish as compiled_polish
from tetractl.model.shapes.polygon import Polygon

HOOK = ((0, 0), (3, 0), (3, 2), (2.4, 2), (2.4, 0.6), (0, 0.6))
TOLERANCE, SLACK = 1e-3, 0.5


def world_with_polygons(seed, polygons, others=0, model="euler", swept=False):
    """The random problems of the other tests, with hooks of some 100 to 300 mm turned anyhow."""
    world = problems.world(seed, 3, others, model, swept)
    rng = np.random.default_rng(seed + 1)
    for _ in range(polygons):
        turn, scale, at = rng.uniform(-4, 4), rng.uniform(30, 100), rng.uniform(100, 700, 2)
        c, s = math.cos(turn), math.sin(turn)
        vertices = scale * np.array(HOOK) @ np.array([[c, s], [-s, c]]) + at
        world.obstacles.append(Polygon(type="polygon", vertices=tuple(map(tuple, vertices))))
    return world


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    polygons=st.integers(1, 3),
    others=st.integers(0, 2),
    motion=st.sampled_from(["euler", "arc", "exact"]),
    swept=st.booleans(),
    margin=st.sampled_from([0.0, 20.0]),
)
def test_costs_agree(seed, polygons, others, motion, swept, margin):
    world = world_with_polygons(seed, polygons, others, motion, swept)
    world.obstacles = [thing.grown(margin) for thing in world.obstacles]
    problem = problems.problem(world)
    signals = np.random.default_rng(seed).uniform(-math.pi, math.pi, (25, 20))
    found = compiled_costs(problem, 25)(np.ascontiguousarray(signals.T))
    assert found == pytest.approx(evaluate(problem, signals).total, rel=1e-9)


@pytest.mark.parametrize("motion", ["euler", "exact"])
@pytest.mark.parametrize("swept", [False, True])
def test_polygons_are_met_at_all(motion, swept):
    """The agreement above would mean little for paths that never come near one."""
    costs = [
        evaluate(
            problems.problem(world_with_polygons(seed, 2, 0, motion, swept)),
            np.random.default_rng(seed).uniform(-1, 1, (25, 20)),
        )
        for seed in range(20)
    ]
    assert sum((cost.obstacle > 0).any() for cost in costs) > 5


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    polygons=st.integers(1, 2),
    others=st.integers(0, 2),
    motion=st.sampled_from(["euler", "exact"]),
    iterations=st.integers(1, 4),
)
def test_the_polish_takes_the_same_steps(seed, polygons, others, motion, iterations):
    problem = problems.problem(world_with_polygons(seed, polygons, others, motion))
    knots = np.random.default_rng(seed).uniform(-math.pi, math.pi, 4)
    start = np.interp(np.linspace(0, 3, 20), np.arange(4), knots)
    slow = levenberg.polish(problem, start, TOLERANCE, SLACK, iterations)
    work, signals = lay_out_polish(problem, 20), start.copy()
    rows, history = len(work.residual), np.empty(iterations + 1)
    _, z, evaluations = compiled_polish(
        work, signals, TOLERANCE, SLACK, iterations, 6, 2**62, np.empty((rows, rows)), history
    )
    assert history[: z + 1] == pytest.approx(slow.history, rel=1e-6, abs=1e-6)
    assert evaluations == slow.evaluations
    assert predict(problem, signals)[..., :2] == pytest.approx(
        predict(problem, slow.signals)[..., :2], abs=1e-3
    )
