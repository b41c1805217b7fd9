"""Tests of the ends and costs of sequences: compiled against readable code."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from testkit import problems

from tetractl.control.search.cost import evaluate, predict, predict_with_costs
from tetractl.control.search.evaluate import (
    compiled_branch_paths,
    compiled_costs,
    compiled_drive,
    compiled_prediction,
)
from tetractl.core.errors import ControlError
from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32)
MOTIONS = st.sampled_from(["euler", "exact"])


@given(
    seed=SEEDS,
    robots=st.integers(1, 5),
    length=st.integers(1, 30),
    motion=MOTIONS,
    swept=st.booleans(),
    separation=st.sampled_from([0.0, 120.0]),
    first=st.floats(0.01, 0.3),
    drifts=st.booleans(),
)
def test_it_leads_where_the_readable_prediction_does(
    seed, robots, length, motion, swept, separation, first, drifts
):
    world = problems.world(seed, robots, 3, motion, swept)
    problem = replace(problems.problem(world, separation, drifts), first_period=first)
    signals = np.random.default_rng(seed).uniform(-math.pi, math.pi, length)
    slow = predict_with_costs(problem, signals)
    fast = compiled_prediction(problem, signals)
    assert fast.path == pytest.approx(slow.path, rel=1e-9, abs=1e-9)
    assert fast.path[0].tolist() == problem.poses.array().tolist()
    assert fast.target == pytest.approx(slow.target, rel=1e-9)
    assert fast.obstacle == slow.obstacle


@pytest.mark.parametrize(
    ("motion", "period"),
    [("euler", 0.2), *(("exact", t) for t in (0.2, 1.0, 4.0, 40.0))],
)
def test_robots_that_turn_fast_against_the_direction_go_where_they_should(motion, period):
    """Swarms clamp signals to pi, against which a robot stands that heads for 0. Where it heads on
    a circle's far side by a rounding error, the error grows by e^(a T) in a step."""
    world = problems.world(4, 3, 0, motion, period=period)
    problem = problems.problem(world)
    poses = replace(problem.poses, heading=np.array([0.0, 0.3, -math.pi]))
    problem = replace(problem, poses=poses, a=np.array([6.0, 4.0, 3.0]))
    signals = np.array([math.pi, 0.7, -math.pi, 2.0, 2.2, -1.0])
    slow = predict_with_costs(problem, signals)
    fast = compiled_prediction(problem, signals)
    assert fast.path == pytest.approx(slow.path, rel=1e-6, abs=1e-4)
    assert fast.target == pytest.approx(slow.target, rel=1e-6)


@pytest.mark.long
@given(seed=SEEDS, swept=st.booleans(), margin=st.sampled_from([0.0, 30.0]))
def test_walls_count_as_in_the_readable_prediction(seed, swept, margin):
    """Some robots start outside, and many leave."""
    world = problems.world(seed, 3, 3, "exact", swept)
    shapes = [thing.shape() for thing in world.obstacles]
    walls = Obstacles.from_shapes(shapes, margin, Bounds(50, 50, 750, 750))
    problem = replace(problems.problem(world), obstacles=walls)
    signals = np.random.default_rng(seed).uniform(-math.pi, math.pi, (20, 12))
    for sequence in signals[:3]:
        assert (
            compiled_prediction(problem, sequence).obstacle
            == predict_with_costs(problem, sequence).obstacle
        )
    costs = compiled_costs(problem, 20)(np.ascontiguousarray(signals.T))
    assert costs == pytest.approx(evaluate(problem, signals).total, rel=1e-9)
    assert evaluate(problem, signals).obstacle.max() > 3


def test_a_pose_that_is_no_number_is_told():
    problem = problems.problem(problems.world(1))
    problem.poses.x[0] = np.nan
    with pytest.raises(ControlError, match="not finite"):
        compiled_prediction(problem, np.zeros(3))


@given(seed=SEEDS, robots=st.integers(1, 4), drifts=st.booleans())
def test_each_robot_drives_towards_its_own_direction_or_stands(seed, robots, drifts):
    rng = np.random.default_rng(seed)
    world = problems.world(seed, robots, 0, "exact")
    problem = problems.problem(world, 0.0, drifts)
    towards = rng.uniform(-3, 3, robots)
    seconds = np.array([0.0, 0.07, 0.9])
    towards[0] = np.nan if seed % 2 else towards[0]
    path = compiled_drive(problem, towards, seconds)
    for m, t in enumerate(seconds.tolist()):
        for i, u in enumerate(towards.tolist()):
            expected = problem.poses.array()[i]
            if u == u and t > 0:
                held = replace(problem, first_period=t, period=t)
                expected = predict(held, np.array([u]))[1, i]
            assert path[m, i] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(seed=SEEDS, robots=st.integers(1, 4), drifts=st.booleans())
def test_branches_are_the_readable_predictions_of_their_directions(seed, robots, drifts):
    rng = np.random.default_rng(seed)
    world = problems.world(seed, robots, 0, "exact")
    problem = problems.problem(world, 0.0, drifts)
    start = rng.uniform(0, 3, (2, robots, 3))
    towards = rng.uniform(-3, 3, 2)
    turns = rng.random(5)
    path = compiled_branch_paths(problem, start, towards, turns, 0.1)
    for b in range(2):
        poses = Poses.from_array(start[b])
        moved = replace(problem, poses=poses, first_period=0.1, period=0.1)
        expected = predict_with_costs(moved, towards[b] + turns).path
        assert path[:, b] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def costs_twice(problem, signals):
    """The compiled costs of signals (P, L), computed again in the same arrays."""
    costs = compiled_costs(problem, len(signals))
    costs(signals.T)
    return costs(signals.T)


@pytest.mark.long
@given(
    seed=SEEDS,
    robots=st.integers(1, 5),
    obstacles=st.integers(0, 4),
    length=st.integers(1, 60),
    particles=st.integers(1, 70),
    model=MOTIONS,
    swept=st.booleans(),
    first=st.floats(0.01, 0.2),
    apart=st.sampled_from([0.0, 50.0, 400.0]),
)
@example(167, 1, 0, 60, 34, "exact", False, 0.2, 0.0)  # headings near -u again and again
@example(0, 1, 1, 47, 15, "euler", False, 0.11354210870059285, 0.0)
def test_costs_agree(seed, robots, obstacles, length, particles, model, swept, first, apart):
    world = problems.world(seed, robots, obstacles, model, swept)
    problem = replace(problems.problem(world, apart), first_period=first)
    signals = np.random.default_rng(seed).uniform(-math.pi, math.pi, (particles, length))
    reference = evaluate(problem, signals).total
    allowed = 1e-9 * reference + spread(problem, signals, reference)
    assert np.all(np.abs(costs_twice(problem, signals) - reference) <= allowed)


def spread(problem, signals, reference):
    """Return how far costs (P,) move when each signal moves by 1e-12 rad.

    A heading near -u doubles what it is off within a few signals, and rounding with it.
    """
    rng = np.random.default_rng(0)
    moved = [signals + rng.choice([-1e-12, 1e-12], signals.shape) for _ in range(4)]
    return np.max([np.abs(evaluate(problem, m).total - reference) for m in moved], axis=0)


@pytest.mark.parametrize("model", ["euler", "exact"])
@pytest.mark.parametrize("turn", [1e-6, 1e-3, 1.25, 3.0, 5.0, 20.0, 50.0])
def test_costs_agree_whatever_a_robot_turns_in_a_period(model, turn):
    """Regression: above a T of about 4 the sine of `euler` left its range."""
    problem = problems.problem(problems.world(1, obstacles=0, model=model))
    problem = replace(problem, a=np.full(3, turn / problem.period))
    signals = np.random.default_rng(1).uniform(-math.pi, math.pi, (33, 3))
    reference = evaluate(problem, signals).total
    assert costs_twice(problem, signals) == pytest.approx(reference, rel=1e-8)
