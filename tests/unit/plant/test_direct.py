"""Tests of simulated robots that turn to the direction itself, against the paper's (1)-(3)."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.poses import Poses
from tetractl.core.registries import MOTIONS
from tetractl.plant.direct import DirectDrive, find_aimed_directions
from tetractl.spec.disturbance import DelayedCommand

A = np.array([2.0, 0.7])
SPEED = np.array([100.0, 60.0])
STARTS = Poses(np.array([10.0, 300.0]), np.array([20.0, -40.0]), np.array([0.3, -2.0]))
BOTH = (True, True)


def drive(motion="exact", a=A, speed=SPEED):
    return DirectDrive(MOTIONS.load(motion), a, speed, STARTS)


def give(robots, action, reached=BOTH):
    robots.apply(DelayedCommand(0, 0, action, np.array(reached)))


def moved(robots, seconds, since_s=0.0):
    """Move the robots; return their poses (3, N) at the end."""
    since_ns = round(since_s * SECOND)
    times_ns = np.array([since_ns + round(seconds * SECOND)])
    path = robots.advance(since_ns, times_ns, np.array([True]))
    assert path[-1] == pytest.approx(robots.poses.array().T)
    return path[-1]


def integrated(i, u, seconds, speed=SPEED):
    """The pose of robot `i` after steering to `u`, by numerical integration of (1)-(3)."""

    def rates(_, s):
        return [speed[i] * math.cos(s[2]), speed[i] * math.sin(s[2]), A[i] * math.sin(u - s[2])]

    start = STARTS.array()[i]
    return solve_ivp(rates, (0, seconds), start, "DOP853", rtol=1e-12, atol=1e-9).y[:, -1]


def test_a_robot_follows_a_direction_by_the_papers_equations():
    robots = drive()
    give(robots, Steer(1.4))
    poses = moved(robots, 0.8)
    for i in (0, 1):
        assert poses[:, i] == pytest.approx(integrated(i, 1.4, 0.8))


def test_the_path_does_not_depend_on_when_it_is_computed():
    once, often = drive(), drive()
    for robots in (once, often):
        give(robots, Steer(1.4))
    for k in range(8):
        moved(often, 0.1, 0.1 * k)
    assert moved(once, 0.8) == pytest.approx(often.poses.array().T)
    several = drive()
    give(several, Steer(1.4))
    times_ns = np.arange(1, 9) * SECOND // 10
    path = several.advance(0, times_ns, np.ones(8, dtype=bool))
    assert path.shape == (8, 3, 2)
    assert path[-1] == pytest.approx(often.poses.array().T)


def test_a_turn_changes_the_heading_as_steering_does_but_not_the_place():
    robots = drive()
    give(robots, Turn(1.4))
    x, y, heading = moved(robots, 0.8)
    assert (x.tolist(), y.tolist()) == (STARTS.x.tolist(), STARTS.y.tolist())
    assert heading == pytest.approx([integrated(i, 1.4, 0.8)[2] for i in (0, 1)])


def test_without_a_field_robots_drive_on_along_their_headings():
    robots = drive()
    give(robots, Steer(1.4))
    x, y, heading = moved(robots, 0.5)
    give(robots, FieldOff())
    later = moved(robots, 0.4, 0.5)
    assert later[2] == pytest.approx(heading)
    assert later[0] == pytest.approx(x + 0.4 * SPEED * np.cos(heading))
    assert later[1] == pytest.approx(y + 0.4 * SPEED * np.sin(heading))
    give(robots, Steer(1.4))
    assert not np.allclose(moved(robots, 0.3, 0.9)[2], heading), "and turn again with a field"


def test_robots_stand_before_the_first_command_and_after_a_stop():
    robots = drive()
    assert robots.commanded.tolist() == robots.moving.tolist() == [0, 0]
    assert moved(robots, 1.0).tolist() == STARTS.array().T.tolist()
    give(robots, Steer(0.0))
    assert robots.commanded.tolist() == robots.moving.tolist() == [1, 1]
    before = moved(robots, 0.2, 1.0)
    give(robots, Stop())
    assert robots.commanded.tolist() == robots.moving.tolist() == [0, 0]
    assert moved(robots, 1.0, 1.2) == pytest.approx(before)


@pytest.mark.parametrize("action", [Steer(2.0), Turn(2.0), FieldOff(), Stop()])
def test_a_robot_that_a_command_does_not_reach_follows_its_last_one(action):
    robots = drive()
    give(robots, Steer(1.4))
    moved(robots, 0.3)
    give(robots, action, (True, False))
    assert moved(robots, 0.5, 0.3)[:, 1] == pytest.approx(integrated(1, 1.4, 0.8))


def test_new_rates_and_speeds_apply_from_now_on():
    robots, twice = drive(), drive(a=2 * A, speed=2 * SPEED)
    give(robots, Steer(1.4))
    robots.vary(2 * A, 2 * SPEED)
    give(twice, Steer(1.4))
    assert moved(robots, 0.4) == pytest.approx(moved(twice, 0.4))


def test_a_robot_without_turning_rate_and_speed_is_held_still_though_commanded():
    robots = drive()
    give(robots, Steer(1.4))
    robots.vary(np.array([0.0, 0.7]), np.array([0.0, 60.0]))
    assert robots.moving.tolist() == [0, 1]
    assert robots.commanded.tolist() == [1, 1]
    assert moved(robots, 0.5)[:, 0] == pytest.approx(STARTS.array()[0])
    robots.vary(A, SPEED)
    assert robots.moving.tolist() == [1, 1]


@pytest.mark.parametrize(("a", "speed"), [(0.0, 60.0), (0.7, 0.0)])
def test_a_robot_that_can_only_drive_or_only_turn_still_moves(a, speed):
    robots = drive(a=np.array([a] * 2), speed=np.array([speed] * 2))
    give(robots, Steer(1.4))
    assert robots.moving.tolist() == [1, 1]
    x, y, heading = moved(robots, 0.5)
    if a == 0:
        assert heading == pytest.approx(STARTS.heading)
        assert np.hypot(x - STARTS.x, y - STARTS.y) == pytest.approx([30, 30])
    else:
        assert (x.tolist(), y.tolist()) == (STARTS.x.tolist(), STARTS.y.tolist())
        assert not np.allclose(heading, STARTS.heading)


def test_with_the_motion_euler_robots_drive_straight_from_where_they_headed_at_the_command():
    """Equations (4)-(6): the turn takes effect in the heading only."""
    robots = drive("euler")
    give(robots, Steer(1.4))
    x, y, heading = moved(robots, 0.2)
    assert x == pytest.approx(STARTS.x + 0.2 * SPEED * np.cos(STARTS.heading))
    assert y == pytest.approx(STARTS.y + 0.2 * SPEED * np.sin(STARTS.heading))
    assert heading == pytest.approx(STARTS.heading + 0.2 * A * np.sin(1.4 - STARTS.heading))


def test_each_action_names_the_direction_to_which_robots_turn():
    heading = np.array([0.1, 0.2])
    assert (
        find_aimed_directions(Steer(0.5), heading).tolist()
        == find_aimed_directions(Turn(0.5), heading).tolist()
        == [0.5, 0.5]
    )
    assert find_aimed_directions(FieldOff(), heading) is heading
