"""Emulated robots against the closed form of their motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.wheels import train
from tetractl_emulator.m3pi.robot import EmulatedRobot, EmulatedRobots

from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag

MS = 1_000_000
LAG = 0.04


def robot():
    robot = EmulatedRobot("green", 0)
    EmulatedRobots([robot], train((5.0, 5.0), (4, 4)), np.array([40.0]), np.array([LAG]))
    robot.place(100.0, 200.0, 0.3)
    return robot


def frame(sequence, *wheels, flags=Flag.RUN):
    return encode_command(BroadcastCommand(sequence, flags, wheels))


def covered(speed, seconds):
    """How far a wheel came that was at rest: the integral of speed (1 - exp(-t/lag))."""
    return speed * (seconds - LAG * -math.expm1(-seconds / LAG))


@given(st.integers(-127, 127), st.integers(-127, 127), st.integers(1, 2000))
def test_motion_is_that_of_two_lagging_wheels(left, right, millis):
    one = robot()
    for k in range(-(-millis // 200)):  # the watchdog ends after 250 ms
        one.hear(frame(k + 1, (left, right)))
        one.robots.advance(min(200 * (k + 1), millis) * MS)
    speeds = [math.copysign(5.0 * max(0, abs(count) - 4), count) for count in (left, right)]
    ways = [covered(speed, millis / 1000) for speed in speeds]
    assert one.heading == pytest.approx(0.3 + (ways[1] - ways[0]) / 80.0, abs=2e-3)
    # v and the turning rate keep their ratio while the wheels speed up: an arc of a circle
    half = (ways[1] - ways[0]) / 160.0
    chord = (ways[0] + ways[1]) / 2 * (math.sin(half) / half if half else 1.0)
    assert one.x == pytest.approx(100 + chord * math.cos(0.3 + half), abs=0.2)
    assert one.y == pytest.approx(200 + chord * math.sin(0.3 + half), abs=0.2)


@given(st.lists(st.integers(1, 400 * MS), min_size=1, max_size=6), st.integers(-127, 127))
def test_the_path_does_not_depend_on_how_often_it_is_read(gaps, left):
    watched = robot()
    alone = robot()
    now = 0
    for k, gap in enumerate(gaps):  # 250 ms after a command, the watchdog stops the robots
        for one in (watched, alone):
            one.hear(frame(k + 1, (left, 60)))
            one.stuck = (k == 2, False)
        for step in range(now + MS, now + gap, MS):
            watched.robots.advance(step)
            assert watched.standing == (max(map(abs, watched.wheels)) < 1)
        now += gap
        for one in (watched, alone):
            one.robots.advance(now)
        assert watched.standing == alone.standing
    for ours, theirs in (
        (watched.x, alone.x),
        (watched.y, alone.y),
        (watched.heading, alone.heading),
    ):
        assert ours == pytest.approx(theirs, abs=1e-9)
    assert watched.wheels == pytest.approx(alone.wheels, abs=1e-9)


def test_a_wheel_that_sticks_stands_at_once():
    one = robot()
    one.hear(frame(1, (40, 40)))
    one.robots.advance(200 * MS)
    one.stuck = (True, False)
    one.robots.advance(202 * MS)
    assert one.wheels[0] == 0 < one.wheels[1]


def test_a_robot_stops_by_its_watchdog():
    one = robot()
    one.hear(frame(1, (40, 40)))
    one.robots.advance(200 * MS)
    assert one.wheels[0] == pytest.approx(180 * -math.expm1(-0.2 / LAG), rel=1e-6)
    one.robots.advance(3000 * MS)
    assert one.standing
    assert one.x < 100 + 180 * 0.3
