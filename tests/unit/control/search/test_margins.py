"""Tests of safety margins that depend on the robots' uncertainty and the free space."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit import problems
from testkit.trials import experiment

from tetractl.control.methods.mpc_section import Collision
from tetractl.control.search.margins import N_SIGMAS, Margins, max_deviation
from tetractl.control.search.near_targets import LOST_FRACTION
from tetractl.core.motion_estimate import Estimate
from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Observation, Poses
from tetractl.core.setup import Bounds
from tetractl.model.shapes import Circle, Rectangle

BOX = Rectangle(type="rectangle", left=1000, bottom=1000, width=100, height=100).shape()
ROUND = Circle(type="circle", center=(3000, 3000), radius=50).shape()
FAR = np.array([[100.0, 100], [200, 2000]])


def margins_of(shapes, targets=FAR, radius=0.0):
    return Margins(Collision(radius=radius), shapes, None, targets)


def at(*points):
    x, y = np.array(points, dtype=float).T
    return Poses(x, y, np.zeros(len(points)))


@pytest.mark.parametrize("shape", [BOX, ROUND])
def test_the_margin_is_kept_where_there_is_room(shape):
    margins = margins_of([shape])
    (grown,) = margins.grow_obstacles(at((500, 500), (600, 600)), 40).shapes
    assert grown.radius == shape.radius + 40


@pytest.mark.parametrize("away", [1.0, 15.0, 39.0])
def test_it_shrinks_to_the_room_that_a_robot_leaves(away):
    margins = margins_of([BOX, ROUND])
    near, unreduced = margins.grow_obstacles(at((1000 - away, 1050), (600, 600)), 40).shapes
    assert not near.contains(np.array(1000 - away), np.array(1050.0))
    assert near.contains(np.array(1000 - 0.9 * away), np.array(1050.0))
    assert unreduced.radius == 90


@pytest.mark.parametrize(
    ("away", "margin_kept"), [(30, 0.98 * 30), (15, 14.7), (10.1, 10), (5, 10)]
)
def test_the_margin_is_not_reduced_below_the_radius(away, margin_kept):
    margins = margins_of([BOX], radius=10)
    (shape,) = margins.grow_obstacles(at((1000 - away, 1050), (600, 600)), 40).shapes
    assert shape.radius == pytest.approx(margin_kept)
    beside = margins_of([BOX], targets=np.array([[995.0, 1050]]), radius=10)
    (target,) = beside.grow_obstacles(at((5, 5)), 40).shapes
    assert target.radius == pytest.approx(0.98 * 5)


def test_two_robots_keep_their_radii_apart_unless_they_are_nearer():
    """Bodies of 47 mm touch at 94 mm; robots that are nearer keep the distance they have."""
    margins = margins_of([], radius=47)

    def separation_at(distance):
        return margins.separation(at((500, 500), (500 + distance, 500)), 100)

    assert separation_at(120) == 100
    assert separation_at(95) == pytest.approx(94)
    assert separation_at(90) == pytest.approx(90)


def test_what_is_uncertain_takes_more_room():
    """By two standard deviations: of the way of the fastest robot in an uncertain dead time, and
    of an uncertain speed over the dead time and a period."""
    period = 0.2
    dead_time = 0.1
    speed = np.array([180.0, 200, 150])
    known_well = Estimate(
        a=np.full(3, 4.0),
        a_std=np.zeros(3),
        speed=speed,
        speed_std=np.zeros(3),
        dead_time_std=0.0,
    )
    of_dead_time = replace(known_well, dead_time_std=0.1)
    of_speed = replace(known_well, speed_std=np.full(3, 10.0))

    least = max_deviation(speed, period, dead_time, known_well)
    assert least == max_deviation(speed, period, dead_time, None) > 0
    assert max_deviation(speed, period / 4, dead_time, known_well) == pytest.approx(least / 4)
    more = max_deviation(speed, period, dead_time, of_dead_time)
    assert more == pytest.approx(least + 2 * 200 * 0.1)
    more = max_deviation(speed, period, dead_time, of_speed)
    assert more == pytest.approx(least + 2 * 10 * (dead_time + period))


def test_a_lag_of_the_wheels_takes_more_room_and_an_uncertain_one_still_more():
    """A lost command leaves the heading wrong by a times the period, and the wheels roll on."""
    speed = np.full(2, 200.0)
    zero = np.zeros(2)
    without_lag = Estimate(a=np.full(2, 4.0), a_std=zero, speed=speed, speed_std=zero)
    no_lag = replace(without_lag, lag=zero, lag_std=zero)
    lag = replace(no_lag, lag=np.full(2, 0.1))
    uncertain = replace(lag, lag_std=np.full(2, 0.02))
    least, with_no_lag, with_lag, with_uncertain = (
        max_deviation(speed, 0.05, 0.1, estimate)
        for estimate in (without_lag, no_lag, lag, uncertain)
    )
    assert with_no_lag == least
    assert with_lag == pytest.approx(least + 4 * 0.05 * 200 * 0.1)
    assert with_uncertain == pytest.approx(least + 4 * 0.05 * 200 * 0.14)
    longest = max_deviation(speed, 10.0, 0.1, lag) - max_deviation(speed, 10.0, 0.1, no_lag)
    assert longest == pytest.approx(200 * 0.1)  # the whole way that the wheels roll on


def test_a_robot_inside_the_margin_does_not_freeze_the_plan():
    """The first predicted position is inside whatever the signal is: every plan costs the same."""
    box = {"type": "rectangle", "left": 1200, "bottom": 1100, "width": 200, "height": 200}
    control = {
        "type": "mpc",
        "period": 0.2,
        "estimate": False,
        "horizon_max": 30,
        "obstacle_weight": 1e6,
        "collision": {"margin": 60, "walls": False, "stop_before_collision": False},
        "optimizer": {"type": "multistart"},
    }
    robot = {"name": "one", "start": [1180, 1150], "heading": 2, "target": [1100, 1500]}
    robots = [robot | {"a": 4, "speed": 150}]

    def cost(adaptive):
        control["collision"]["adaptive"] = adaptive
        spec = experiment(robots=robots, obstacles=[box], controller=control)
        controller = spec.controller.build(spec.setup, 3)
        observation = Observation(0, 0, 0, spec.setup.starts, np.ones(1, np.bool_))
        return controller.plan(observation).cost

    assert cost(False) > 1e5
    assert cost(True) < 1


def test_margins_that_are_not_adaptive_are_the_papers_wherever_robots_are():
    fields = {"margin": 30, "radius": 10, "separation": 55, "adaptive": False}
    spec = experiment(controller={"type": "mpc", "collision": fields})
    problem = replace(
        spec.controller.problem(spec.setup), poses=at((995, 1050), (996, 1050), (997, 1050))
    )
    margins = Margins(spec.controller.collision, [BOX], None, spec.setup.targets)
    applied = margins.apply(problem, 0.2, 0.1, None)
    assert applied.obstacles.shapes[0].radius == 40
    assert applied.separation == 55


@given(
    seed=st.integers(0, 2**32),
    heard_s=st.floats(0.01, 1),
    dead_time_s=st.floats(0, 0.5),
    robots=st.integers(1, 4),
    lags=st.sampled_from(["none", "known", "uncertain"]),
)
def test_robots_leave_their_courses_by_the_formula(seed, heard_s, dead_time_s, robots, lags):
    rng = np.random.default_rng(seed)
    a, speed, a_std, speed_std, lag, lag_std = rng.uniform(0.1, 3, (6, robots))
    estimate = Estimate(
        a=a, a_std=a_std, speed=speed, speed_std=speed_std, dead_time_std=0.07, lag=None
    )
    if lags != "none":
        estimate = replace(estimate, lag=lag, lag_std=lag_std if lags == "uncertain" else None)
    off = []
    for i in range(robots):
        lag_s = 0.0 if lags == "none" else lag[i]
        lag_s += N_SIGMAS * lag_std[i] if lags == "uncertain" else 0.0
        of_rates = speed[i] * a_std[i] / a[i] + speed_std[i]
        off.append(
            LOST_FRACTION * speed[i] * heard_s
            + min(a[i] * heard_s, 1) * speed[i] * lag_s
            + N_SIGMAS * (speed[i] * 0.07 + of_rates * (heard_s + dead_time_s))
        )
    assert max_deviation(speed, heard_s, dead_time_s, estimate) == pytest.approx(max(off))
    lost = LOST_FRACTION * speed.max() * heard_s
    assert max_deviation(speed, heard_s, dead_time_s, None) == pytest.approx(lost)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32),
    radius=st.sampled_from([0.0, 40.0]),
    separation=st.sampled_from([0.0, 150.0]),
    robots=st.integers(1, 3),
)
def test_margins_and_separation_are_those_of_the_formulas(seed, radius, separation, robots):
    rng = np.random.default_rng(seed)
    shapes = [BOX, ROUND]
    walls = Bounds(700, 600, 3500, 3600)
    near = [[950, 1050], [1050, 950], [2930, 3000], [740, 2000], [2000, 3570]]
    starts = np.array(near)[rng.permutation(5)[:robots]] + rng.uniform(-30, 30, (robots, 2))
    targets = np.array(near)[rng.permutation(5)[:robots]] + rng.uniform(-30, 30, (robots, 2))
    collision = Collision(margin=25, radius=radius, separation=separation)
    world = problems.problem(problems.world(seed, robots, 0))
    problem = replace(world, poses=at(*starts))
    applied = Margins(collision, shapes, walls, targets).apply(problem, 0.3, 0.1, None)

    off = LOST_FRACTION * problem.speed.max() * 0.3
    full = 25 + radius + off
    bare = Obstacles.from_shapes(shapes, 0.0, walls)

    def fitting(margin, gap):
        return margin if margin < gap else 0.98 * max(gap, 0.0)

    to_targets = bare.distances(*targets.T).min(axis=1)
    to_robots = bare.distances(*starts.T).min(axis=1)
    expected = [
        max(fitting(full, min(of_target, of_robot)), fitting(radius, of_target))
        for of_target, of_robot in zip(to_targets, to_robots, strict=True)
    ]
    shown = [
        *(applied.obstacles.radii - bare.radii),
        *((applied.obstacles.walls - bare.walls) * [1, 1, -1, -1]),
    ]
    assert shown == pytest.approx(expected)
    apart = np.inf
    for places in (starts, targets):
        for i in range(robots):
            for k in range(i):
                apart = min(apart, np.hypot(*(places[i] - places[k])))
    wanted = separation + 2 * off if separation else 0.0
    kept = min(wanted, max(0.98 * apart, min(2 * radius, apart)))
    assert applied.separation == pytest.approx(kept if robots > 1 else 0.0)
