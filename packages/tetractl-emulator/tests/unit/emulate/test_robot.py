"""Tests of emulated robots against the closed form of their motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.emulator.acting import act
from testkit.wheels import train
from tetractl_emulator.m3pi.robot import EmulatedRobot, EmulatedRobots

from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag

MS = 1_000_000
LAG_S = 0.04
GAIN_MM_S = 5.0  # of a wheel for each count above the dead zone
DEAD_ZONE = 4  # counts
AXLE_MM = 80.0  # between the wheels, which are 40 mm from the centre
START_X_MM = 100.0
START_Y_MM = 200.0
START_HEADING = 0.3

counts = st.integers(-127, 127)
gaps_ns = st.integers(1, 400 * MS)


def robot_at_start():
    robot = EmulatedRobot("green", 0)
    wheels = train((GAIN_MM_S, GAIN_MM_S), (DEAD_ZONE, DEAD_ZONE))
    EmulatedRobots([robot], wheels, np.array([AXLE_MM / 2]), np.array([LAG_S]))
    robot.place(START_X_MM, START_Y_MM, START_HEADING)
    return robot


def frame(sequence, *wheels, flags=Flag.RUN):
    return encode_command(BroadcastCommand(sequence, flags, wheels))


def wheel_speed(count):
    """The speed of a wheel that is commanded a count for long [mm/s]."""
    return math.copysign(GAIN_MM_S * max(0, abs(count) - DEAD_ZONE), count)


def wheel_way(count, seconds):
    """How far a wheel came that was at rest [mm]: the integral of speed (1 - exp(-t/lag))."""
    return wheel_speed(count) * (seconds - LAG_S * -math.expm1(-seconds / LAG_S))


@given(counts, counts, st.integers(1, 2000))
def test_motion_is_that_of_two_lagging_wheels(count_left, count_right, millis):
    """Speed and turning rate keep their ratio while the wheels speed up: an arc of a circle."""
    robot = robot_at_start()
    for k in range(math.ceil(millis / 200)):  # the watchdog ends after 250 ms
        robot.receive(frame(k + 1, (count_left, count_right)))
        robot.robots.advance(min(200 * (k + 1), millis) * MS)
    way_left = wheel_way(count_left, millis / 1000)
    way_right = wheel_way(count_right, millis / 1000)
    half_turn = (way_right - way_left) / AXLE_MM / 2
    arc = (way_left + way_right) / 2
    chord = arc * (math.sin(half_turn) / half_turn if half_turn else 1.0)
    course = START_HEADING + half_turn
    assert robot.heading == pytest.approx(START_HEADING + 2 * half_turn, abs=2e-3)
    assert robot.x == pytest.approx(START_X_MM + chord * math.cos(course), abs=0.2)
    assert robot.y == pytest.approx(START_Y_MM + chord * math.sin(course), abs=0.2)


def stands(robot):
    return max(abs(speed) for speed in robot.wheels) < 1


@given(st.lists(gaps_ns, min_size=1, max_size=6), counts)
def test_the_path_does_not_depend_on_how_often_it_is_read(gaps, count_left):
    """One robot is read each millisecond, the other only when it hears a command; 250 ms after
    one, the watchdog stops both. During the third gap a wheel of both sticks."""
    watched = robot_at_start()
    alone = robot_at_start()
    now = 0
    for k, gap in enumerate(gaps):
        for robot in (watched, alone):
            robot.receive(frame(k + 1, (count_left, 60)))
            if k == 2:
                stuck = act(robot.acting, "wheel_stuck", robot=robot.name, wheel="left")
            elif k == 3:
                robot.acting.remove(stuck)
        for step in range(now + MS, now + gap, MS):
            watched.robots.advance(step)
            assert watched.standing == stands(watched)
        now += gap
        watched.robots.advance(now)
        alone.robots.advance(now)
        assert watched.standing == alone.standing
    assert watched.x == pytest.approx(alone.x, abs=1e-9)
    assert watched.y == pytest.approx(alone.y, abs=1e-9)
    assert watched.heading == pytest.approx(alone.heading, abs=1e-9)
    assert watched.wheels == pytest.approx(alone.wheels, abs=1e-9)


def test_a_robot_stops_by_its_watchdog():
    robot = robot_at_start()
    robot.receive(frame(1, (40, 40)))
    robot.robots.advance(200 * MS)
    speed = wheel_speed(40)
    assert robot.wheels[0] == pytest.approx(speed * -math.expm1(-0.2 / LAG_S), rel=1e-6)
    robot.robots.advance(3000 * MS)
    assert robot.standing
    assert robot.x < START_X_MM + speed * 0.3


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_weak_wheel_turns_at_its_share_of_the_commanded_speed_from_then_on(share):
    robot = robot_at_start()
    speed = wheel_speed(40)
    settled = pytest.approx(speed * -math.expm1(-0.2 / LAG_S), rel=1e-6)
    robot.receive(frame(1, (40, 40)))
    robot.robots.advance(200 * MS)
    assert robot.wheels == (settled, settled)
    act(robot.acting, "weak_wheel", robot="green", wheel="left", share=share)
    act(robot.acting, "weak_wheel", robot="red", wheel="both", share=0.1)  # of another robot
    for sequence in range(2, 8):
        robot.receive(frame(sequence, (40, 40)))
        robot.robots.advance(200 * sequence * MS)
    assert robot.wheels == pytest.approx((share * speed, speed), rel=1e-6)
