import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import problems
from testkit.references import paper as oracle
from testkit.trials import experiment

from tetractl.control.search.cost import STRAY_SLOPE, evaluate, predict
from tetractl.core.errors import ControlError
from tetractl.core.poses import Poses
from tetractl.model.shapes import Rectangle


def robot_at(x, y, target=(0.0, 0.0)):
    return (x, y, 0.0, *target, 6.0, 100.0)


@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 5),
    obstacles=st.integers(0, 4),
    length=st.integers(1, 12),
    model=st.sampled_from(["euler", "exact"]),
    swept=st.booleans(),
)
def test_the_cost_is_7_to_13(seed, robots, obstacles, length, model, swept):
    world = problems.world(seed, robots, obstacles, model, swept)
    signals = np.random.default_rng(seed).uniform(-math.pi, math.pi, (3, length))
    costs = evaluate(problems.problem(world), signals)
    assert costs.total == pytest.approx([oracle.cost(world, row) for row in signals], rel=1e-9)
    assert costs.total == pytest.approx(costs.target + world.weight * costs.obstacle, rel=1e-15)


def test_13_sees_samples_only_and_swept_sees_the_corner_cut():
    wall = Rectangle(type="rectangle", left=25, bottom=-50, width=10, height=100)
    world = oracle.World([robot_at(0, 0)], [wall], weight=1000)
    sampled = problems.problem(world)
    swept = replace(sampled, swept=True)
    straight_on = np.zeros((1, 3))
    assert evaluate(sampled, straight_on).obstacle.tolist() == [0]
    assert evaluate(swept, straight_on).obstacle.tolist() == [1]


def test_a_problem_is_taken_from_the_experiment():
    control = {"collision": {"margin": 10, "walls": False}, "obstacle_weight": 5, "period": 0.2}
    spec = experiment(controller={"type": "mpc"} | control)
    poses = Poses.from_array(np.zeros((3, 3)))
    problem = spec.controller.problem(spec.setup, poses)
    assert problem.targets.tolist() == [[1700, 500], [1700, 1500], [1700, 2000]]
    assert problem.a.tolist() == [6, 4, 3]
    assert problem.speed.tolist() == [180, 200, 150]
    assert [shape.box for shape in problem.obstacles.shapes] == [(1190, 1090, 1410, 1310)]
    assert (problem.swept, problem.obstacle_weight, problem.period) == (True, 5, 0.2)


@pytest.mark.parametrize("bad", [math.nan, 1e308])
def test_costs_that_are_not_finite_are_refused(bad):
    world = oracle.World([robot_at(0, 0), robot_at(bad, 0, target=(-bad, 0))], [])
    with (
        np.errstate(over="ignore"),
        pytest.raises(ControlError, match="not finite for 2 of 2 sequences"),
    ):
        evaluate(problems.problem(world), np.zeros((2, 3)))


def test_each_pair_counts_at_each_position_where_it_is_nearer_than_its_separation():
    """Robots that drive side by side, the second 60 from the first, the third 500. Positions are
    those after each of four signals; the start is not counted."""
    robots = [robot_at(0, 0), robot_at(0, 60), robot_at(0, 500)]
    world = oracle.World(robots, [], weight=10.0)

    def costs(separation):
        return evaluate(problems.problem(world, separation), np.zeros((1, 4)))

    assert costs(59.0).obstacle.tolist() == [0]
    assert costs(60.0).obstacle.tolist() == [1 * 4]  # one pair
    assert costs(501.0).obstacle.tolist() == [3 * 4]  # all pairs
    assert costs(60.0).total - costs(59.0).total == pytest.approx(10.0 * 4)


def slow_path(problem, signals):
    """Places (L, N, 2) after each signal, robot by robot: with biases, flow and a first period."""
    robots = []
    for i, (x, y, heading) in enumerate(problem.poses.array()):
        places = []
        for j, u in enumerate(signals):
            t = problem.first_period if j == 0 else problem.period
            bias = 0.0 if problem.bias is None else problem.bias[i]
            flow = (0.0, 0.0) if problem.flow is None else problem.flow[i]
            speed = problem.a[i], problem.speed[i]
            x, y, heading = oracle.step(problem.motion, x, y, heading, u + bias, *speed, t)
            x, y = x + t * flow[0], y + t * flow[1]
            places.append((x, y))
        robots.append(places)
    return np.array(robots).transpose(1, 0, 2)


@given(
    seed=st.integers(0, 2**32),
    length=st.integers(1, 8),
    model=st.sampled_from(["euler", "exact"]),
    drifts=st.booleans(),
    first=st.floats(0.01, 0.4),
)
def test_robots_are_predicted_with_their_biases_flows_and_periods(
    seed, length, model, drifts, first
):
    problem = problems.problem(problems.world(seed, 3, 0, model), drifts=drifts)
    problem = replace(problem, first_period=first)
    signals = np.random.default_rng(seed).uniform(-3, 3, length)
    path = predict(problem, signals)
    assert path[0] == pytest.approx(problem.poses.array())
    assert path[1:, :, :2] == pytest.approx(slow_path(problem, signals), rel=1e-9, abs=1e-6)


@given(seed=st.integers(0, 2**32), length=st.integers(1, 8), within=st.sampled_from([30.0, 300.0]))
def test_robots_that_hold_cost_their_time_outside_and_a_little_by_how_far(seed, length, within):
    problem = replace(problems.problem(problems.world(seed, 2, 0, "exact")), within=within)
    signals = np.random.default_rng(seed).uniform(-3, 3, length)
    expected = 0.0
    for place in slow_path(problem, signals):
        for (x, y), (target_x, target_y) in zip(place, problem.targets, strict=True):
            d = math.hypot(x - target_x, y - target_y) / within
            if d > 1:
                expected += within * (1 + STRAY_SLOPE * (d - 1)) / length
    costs = evaluate(problem, signals[None])
    assert costs.target[0] == pytest.approx(expected, rel=1e-9)


def test_a_robot_at_the_edge_of_its_disc_costs_nothing_yet():
    world = oracle.World([robot_at(0, 0, target=(50.0, 0.0))], [], "exact", 0.2)
    problem = replace(problems.problem(world), speed=np.zeros(1))
    assert evaluate(replace(problem, within=50.0), np.zeros((1, 3))).target.tolist() == [0]
    assert evaluate(replace(problem, within=49.9), np.zeros((1, 3))).target[0] > 49.9
