"""Margins that follow what is known of the robots and the room there is."""

from dataclasses import replace

import numpy as np
import pytest
from support.trials import experiment

from tetractl.control.margins import Margins, off_course
from tetractl.core.plan import Estimate
from tetractl.core.poses import Observation, Poses
from tetractl.core.setup import Bounds
from tetractl.model.shapes.circle import Circle
from tetractl.model.shapes.rectangle import Rectangle

BOX = Rectangle(type="rectangle", left=1000, bottom=1000, width=100, height=100).shape()
ROUND = Circle(type="circle", center=(3000, 3000), radius=50).shape()
FAR = np.array([[100.0, 100], [200, 2000]])
ARENA = Bounds(0, 0, 4000, 4000)


def at(*points):
    x, y = np.array(points, dtype=float).T
    return Poses(x, y, np.zeros(len(points)))


@pytest.mark.parametrize("shape", [BOX, ROUND])
def test_the_margin_is_kept_where_there_is_room(shape):
    margins = Margins([shape], None, FAR)
    (grown,) = margins.obstacles(at((500, 500), (600, 600)), 40).shapes
    assert grown.radius == shape.radius + 40


@pytest.mark.parametrize("away", [1.0, 15.0, 39.0])
def test_it_shrinks_to_the_room_that_a_robot_leaves(away):
    margins = Margins([BOX, ROUND], None, FAR)
    near, unreduced = margins.obstacles(at((1000 - away, 1050), (600, 600)), 40).shapes
    assert not near.contain(np.array(1000 - away), np.array(1050.0))
    assert near.contain(np.array(1000 - 0.9 * away), np.array(1050.0))
    assert unreduced.radius == 90


def test_a_target_inside_the_margin_can_be_reached():
    margins = Margins([], ARENA, np.array([[20.0, 500], [2000, 2000]]))
    region = margins.obstacles(at((500, 500), (900, 900)), 40)
    assert not region.contain(np.array([20.0]), np.array([500.0])).any()
    assert region.contain(np.array([3980.0]), np.array([500.0])).all()


def test_inside_an_obstacle_nothing_of_the_margin_is_left():
    margins = Margins([BOX], None, FAR)
    (shape,) = margins.obstacles(at((1050, 1050), (600, 600)), 40).shapes
    assert shape.radius == 0


@pytest.mark.parametrize(
    ("away", "margin_kept"), [(30, 0.98 * 30), (15, 14.7), (10.1, 10), (5, 10)]
)
def test_the_margin_is_not_reduced_below_the_radius(away, margin_kept):
    margins = Margins([BOX], None, FAR, 10)
    (shape,) = margins.obstacles(at((1000 - away, 1050), (600, 600)), 40).shapes
    assert shape.radius == pytest.approx(margin_kept)
    (target,) = Margins([BOX], None, np.array([[995.0, 1050]]), 10).obstacles(at((5, 5)), 40).shapes
    assert target.radius == pytest.approx(0.98 * 5)


def test_two_robots_keep_their_radii_apart_unless_they_are_nearer():
    margins = Margins([], None, FAR, 47)
    apart = [margins.separation(at((500, 500), (500 + gap, 500)), 100) for gap in (120, 95, 90)]
    assert apart == pytest.approx([100, 94, 90])


@pytest.mark.parametrize(
    ("x0", "x1", "enters"),
    [(940, 949, False), (940, 951, True), (960, 961, True), (960, 959, False)],
)
def test_a_body_enters_where_it_touches_or_goes_deeper(x0, x1, enters):
    path = np.zeros((4, 1, 3))
    path[:, 0, 0] = np.linspace(x0, x1, 4)
    path[:, 0, 1] = 1050.0
    assert Margins([BOX], None, FAR[:1], 50).enters(path) is enters


@pytest.mark.parametrize(
    ("gaps", "enters"),
    [((200, 110), False), ((200, 90), True), ((90, 95), False), ((90, 85), True)],
)
def test_a_body_enters_another_where_they_come_nearer_than_two_radii(gaps, enters):
    path = np.zeros((2, 2, 3))
    path[:, 1, 0] = gaps
    assert Margins([], None, FAR[:2], 50).enters(path) is enters


def test_robots_keep_the_separation_they_have():
    margins = Margins([], None, FAR)
    assert margins.separation(at((500, 500), (900, 500)), 100) == 100
    assert margins.separation(at((500, 500), (550, 500)), 100) == pytest.approx(49)
    assert margins.separation(at((500, 500), (500, 500)), 0) == 0
    assert Margins([], None, FAR[:1]).separation(at((5, 5)), 100) == 0


def test_the_separation_grows_by_what_both_robots_may_be_off():
    spec = experiment(controller={"type": "mpc", "collision": {"separation": 50}})
    problem = spec.controller.problem(spec.setup)
    section = spec.controller
    with_margins = section.build(spec.setup, 3)._with_margins(problem, None)
    assert with_margins.separation == pytest.approx(
        50 + 2 * off_course(problem.speed, section.period, section.dead_time, None)
    )


def test_what_is_uncertain_takes_more_room():
    speed = np.array([180.0, 200, 150])
    sure = Estimate(np.full(3, 4.0), np.zeros(3), speed, np.zeros(3), dead_time_std=0.0)
    unsure = replace(sure, dead_time_std=0.1)
    least = off_course(speed, 0.2, 0.1, sure)
    assert least == off_course(speed, 0.2, 0.1, None) > 0
    assert off_course(speed, 0.05, 0.1, sure) == pytest.approx(least / 4)
    assert off_course(speed, 0.2, 0.1, unsure) == pytest.approx(least + 2 * 200 * 0.1)
    of_speed = replace(sure, speed_std=np.full(3, 10.0))  # over the dead time and a period
    assert off_course(speed, 0.2, 0.1, of_speed) == pytest.approx(least + 2 * 10 * (0.1 + 0.2))


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


@pytest.mark.parametrize(
    ("direction", "seconds", "clear"),
    [(0.0, 1.0, True), (0.0, 3.0, False), (3.0, 2.5, True), (np.pi / 2, 1.0, True)],
)
def test_a_direction_held_for_too_long_leads_into_a_wall(direction, seconds, clear):
    """Robots at 200 mm/s, the first 400 mm from the wall that it faces."""
    setup = experiment().setup
    section = experiment(controller={"motion": "exact"}).controller
    x = setup.arena.right - 400
    poses = Poses(np.array([x, x, x]), np.array([600.0, 1200, 1800]), np.zeros(3))
    problem = replace(section.problem(setup), poses=poses, speed=np.full(3, 200.0))
    margins = Margins([], setup.arena, setup.targets)
    path = poses.array()[None]
    signals = np.array([direction])
    assert margins.silence(problem, seconds, 20.0, 0.0).keeps_clear(path, signals) is clear


def test_robots_that_meet_under_a_direction_held_are_not_clear():
    """The first catches up by 100 of the 200 mm between it and the second."""
    setup = experiment().setup
    section = experiment(controller={"motion": "exact"}).controller
    poses = Poses(np.array([900.0, 1100, 900]), np.array([900.0, 900, 1600]), np.zeros(3))
    problem = replace(section.problem(setup), poses=poses, speed=np.array([200.0, 100, 150]))
    margins = Margins([], None, setup.targets)
    for apart, clear in ((50.0, True), (150.0, False)):
        close = replace(problem, separation=apart)
        path = poses.array()[None]
        signals = np.zeros(1)
        assert margins.silence(close, 1.0, 0.0, apart).keeps_clear(path, signals) is clear
