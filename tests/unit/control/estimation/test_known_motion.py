"""Tests of predicting robots with known motion to the time at which the next direction acts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tetractl.control.estimation.known_motion import KnownMotion
from tetractl.control.estimation.prior import certain_prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Steer, Stop
from tetractl.core.plan import Problem
from tetractl.core.poses import Observation, Poses
from tetractl.model.motion.exact import step

A = np.array([4.0, 6.0])
SPEED = np.array([100.0, 150.0])
STARTS = Poses(np.array([10.0, 500.0]), np.array([20.0, 400.0]), np.array([0.0, 2.0]))


def motion(dead_time):
    problem = Problem(
        poses=STARTS,
        targets=np.zeros((2, 2)),
        a=A,
        speed=SPEED,
        motion="exact",
        period=0.2,
        first_period=0.2,
        obstacles=None,
        obstacle_weight=0.0,
        swept=False,
    )
    return KnownMotion(certain_prior(problem, dead_time))


def frame(at_s, exposed_s=()):
    when = round(at_s * SECOND)
    valid = np.ones(2, dtype=np.bool_)
    exposed_ns = tuple(round(s * SECOND) for s in exposed_s)
    return Observation(0, when, when, STARTS, valid, exposed_ns)


def sent(at_s, action):
    return Command(action, round(at_s * SECOND), (True, True))


def moved(poses, u, seconds):
    """The poses after a direction was followed for some time, by the closed form."""
    u = np.full(2, u)
    return Poses(*step(poses.x, poses.y, poses.heading, u, A, SPEED, np.full(2, seconds)))


def assert_equal(poses, expected):
    assert poses.x == pytest.approx(expected.x, abs=1e-9)
    assert poses.y == pytest.approx(expected.y, abs=1e-9)
    assert poses.heading == pytest.approx(expected.heading, abs=1e-12)


def test_without_a_dead_time_the_poses_are_those_of_the_frame():
    robots = motion(0.0)
    robots.add_command(sent(0.5, Steer(1.0)))
    robots.add_frames(frame(1.0))
    forecast = robots.forecast(SECOND)
    for name in ("x", "y", "heading"):
        assert np.array_equal(getattr(forecast.poses, name), getattr(STARTS, name))
    assert forecast.directions.tolist() == [1.0, 1.0]


def test_each_direction_is_followed_from_one_dead_time_after_it_was_sent():
    """Sent at 0.5, 0.8 and 0.9 s with a dead time of 0.3 s, and asked at 1.0 s: the first acts at
    0.8 s, the second from 1.1 to 1.2 s, the third from 1.2 to 1.3 s."""
    robots = motion(0.3)
    for at_s, u in ((0.5, 1.0), (0.8, -1.0), (0.9, 2.0)):
        robots.add_command(sent(at_s, Steer(u)))
    robots.add_frames(frame(1.0))
    forecast = robots.forecast(SECOND)
    expected = moved(moved(moved(STARTS, 1.0, 0.1), -1.0, 0.1), 2.0, 0.1)
    assert_equal(forecast.poses, expected)
    assert forecast.directions.tolist() == [2.0, 2.0]
    assert forecast.dead_time_s == 0.3


def test_robots_stand_before_the_first_direction_and_after_a_stop():
    robots = motion(0.2)
    robots.add_frames(frame(1.0))
    before = robots.forecast(SECOND)
    assert_equal(before.poses, STARTS)
    assert np.isnan(before.directions).all()
    robots.add_command(sent(0.9, Steer(0.5)))  # acts at 1.1 s
    robots.add_command(sent(0.95, Stop()))  # acts at 1.15 s
    robots.add_command(sent(0.99, FieldOff()))  # turns no robot
    after = robots.forecast(SECOND)
    assert_equal(after.poses, moved(STARTS, 0.5, 0.05))
    assert np.isnan(after.directions).all()


def test_each_robot_is_predicted_from_the_time_of_its_own_pose():
    """The second robot's pose is 0.1 s older."""
    robots = motion(0.0)
    robots.add_command(sent(0.0, Steer(1.0)))
    robots.add_frames(frame(1.0, exposed_s=(1.0, 0.9)))
    poses = robots.forecast(SECOND).poses
    later = moved(STARTS, 1.0, 0.1)
    assert (poses.x[0], poses.y[0]) == (STARTS.x[0], STARTS.y[0])
    assert (poses.x[1], poses.y[1]) == pytest.approx((later.x[1], later.y[1]), abs=1e-9)


def test_a_forecast_changes_nothing():
    robots = motion(0.3)
    robots.add_command(sent(0.9, Steer(math.pi / 2)))
    robots.add_frames(frame(1.0))
    assert_equal(robots.forecast(SECOND).poses, robots.forecast(SECOND).poses)
    assert_equal(replace(STARTS), STARTS)
