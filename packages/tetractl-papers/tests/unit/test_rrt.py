"""Tests of RRT with feedback: the path keeps clear of obstacles, and the robot follows it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.plants import sim
from testkit.trials import THREE_M3PI, experiment
from tetractl_papers.rrt import RrtSection, grow_tree

from tetractl.control.search.rng import uniform
from tetractl.core.clock import SECOND
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import Observation
from tetractl.core.setup import Bounds
from tetractl.model.shapes import Circle
from tetractl.run.checked_controller import build_controller
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.problems import InvalidSpecError

ONE = [{"name": "r", "start": [900, 1200], "target": [1700, 1200], "a": 6, "speed": 180}]
START = np.array([900.0, 1200])
TARGET = np.array([1700.0, 1200])


def path(key, margin=30.0, draws=3000):
    setup = experiment().setup
    region = Obstacles.from_shapes(setup.obstacles, margin, setup.arena)
    rows = uniform(key, 0, 3 * draws).reshape(-1, 3)
    return region, grow_tree(region, setup.arena, START, TARGET, 120.0, rows)


@given(st.integers(0, 2**64 - 1))
def test_a_path_ends_at_the_target_and_touches_nothing(key):
    region, corners = path(key)
    assert corners[-1].tolist() == TARGET.tolist()
    ends = np.vstack([START, corners])
    assert not region.meets_segments(*ends[:-1].T, *ends[1:].T).any()
    assert np.hypot(*np.diff(ends, axis=0).T).max() <= 120 * (1 + 1e-9)


def test_there_may_be_no_path():
    setup = experiment().setup
    wall = Circle(type="circle", center=(1700, 1200), radius=150).shape()
    region = Obstacles.from_shapes([wall])
    rows = uniform(1, 0, 3 * 500).reshape(-1, 3)
    assert grow_tree(region, setup.arena, START, TARGET, 120.0, rows) is None


def drive(key, fields=None, **plant):
    spec = experiment(
        robots=ONE,
        controller={"type": "rrt", "margin": 40, "time_limit": 60.2} | (fields or {}),
        plant={"type": "sim"} | plant,
    )
    world = sim(spec, key)
    controller = build_controller(spec, key)
    world.open()
    command = None
    for k in range(400):
        decision = controller.plan(world.observe(), command)
        if isinstance(decision, Outcome | End):
            delay = decision.delay_ns if isinstance(decision, End) else 0
            world.clock.sleep_until(world.clock.now() + delay)
            world.stop()
            return world.settle(), decision
        command = world.send(decision.action)
        world.clock.sleep_until((k + 1) * SECOND // 5)
    raise AssertionError


@pytest.mark.parametrize("key", range(8))
def test_the_robot_goes_round_the_obstacle_to_its_target(key):
    verdict, decision = drive(key)
    assert isinstance(decision, End) or decision is Outcome.NO_BETTER_PLAN
    assert verdict.entered == (False,)
    assert np.hypot(*(verdict.final.xy[0] - TARGET)) < 30  # v/a: it turns no tighter


def test_several_robots_and_one_that_stands_are_refused():
    text = experiment().model_dump_json()
    with pytest.raises(InvalidSpecError, match="can steer only one robot, but the spec has 3"):
        parse_spec(text, "s.yaml", ["controller={type: rrt}"])
    still = dict(THREE_M3PI["robots"][0], speed=0)
    text = experiment(robots=[still]).model_dump_json()
    with pytest.raises(InvalidSpecError, match="speed in the spec is 0"):
        parse_spec(text, "s.yaml", ["controller={type: rrt}"])


# ---- the tree itself ----

EMPTY = Obstacles.from_shapes([])
ARENA = Bounds(-100, 50, 900, 550)
HERE = np.array([0.0, 100.0])
THERE = np.array([800.0, 500.0])


def grown(draws, target=THERE, edge=100.0, region=EMPTY):
    return grow_tree(region, ARENA, HERE, target, edge, np.array(draws, dtype=float))


def test_a_target_within_an_edge_is_reached_by_the_first_node():
    near = HERE + np.array([90.0, 0.0])
    path = grown([[0.5, 0.15, 0.1]], near)  # the point (50, 100)
    assert path.tolist() == [[50, 100], near.tolist()]


def test_draws_below_the_bias_lead_straight_to_the_target():
    """In edges of the full length, of which the last ends at the target."""
    target = HERE + np.array([250.0, 0.0])
    below = RrtSection.goal_bias - 1e-9
    path = grown([[below, 0.9, 0.9]] * 2, target)
    assert path == pytest.approx(np.array([[100, 100], [200, 100], [250, 100]]))
    upwards = grown([[RrtSection.goal_bias, 0.1, 1.0]] * 2, target)
    assert upwards is None  # a random point instead: straight up from the start


def test_other_draws_are_points_of_the_arena_by_their_fractions():
    target = np.array([400.0, 300.0])
    path = grown([[0.5, 0.4, 0.5]], target, edge=1000.0)
    assert path[0] == pytest.approx([-100 + 0.4 * 1000, 50 + 0.5 * 500])


def test_an_edge_begins_at_the_nearest_node():
    draws = [[0.5, 0.2, 0.1], [0.5, 0.2, 0.2], [0.5, 0.3, 0.2]]  # (100, 100), (100, 150), ...
    path = grown(draws, np.array([300.0, 150.0]), edge=100.0)
    assert path == pytest.approx(np.array([[100, 100], [100, 150], [200, 150], [300, 150]]))


def test_a_point_that_is_a_node_already_adds_none():
    same = [[0.5, 0.1, 0.1]] * 3  # the start itself
    assert grown(same) is None
    path = grown([*same, [0.5, 0.15, 0.1]], HERE + np.array([90.0, 0.0]))
    assert len(path) == 2


def test_the_end_of_a_path_must_be_clear_too():
    target = HERE + np.array([90.0, 0.0])
    post = Obstacles.from_shapes([Circle(type="circle", center=(70, 100), radius=5).shape()])
    assert grown([[0.5, 0.15, 0.1]], target, region=post) is None
    # round it: (60, 130), then (90, 130), from which the target is free
    path = grown([[0.5, 0.16, 0.16], [0.5, 0.19, 0.16]], target, region=post)
    assert path[-1].tolist() == target.tolist()


@pytest.mark.parametrize("heading", np.linspace(-3, 3, 9))
def test_a_target_that_is_near_behind_a_wall_is_not_passed_yet(heading):
    """The robot drives away from it at first, round the wall, and must not stop for that."""
    wall = {"type": "rectangle", "left": 1320, "bottom": 1000, "width": 20, "height": 400}
    robot = {"name": "r", "start": [1300, 1200], "target": [1360, 1200], "a": 6, "speed": 180}
    robot["heading"] = float(heading)
    fields = {"type": "rrt", "reach": 5, "time_limit": 60}
    spec = experiment(robots=[robot], obstacles=[wall], controller=fields)
    controller = spec.controller.build(spec.setup, 5)
    seen = Observation(0, 0, 0, spec.setup.starts, np.ones(1, np.bool_))
    assert isinstance(controller.plan(seen), Plan)
