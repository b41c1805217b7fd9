"""Emulated robots against the closed form of their motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.wheels import train

from tetractl.emulate.m3pi.robot import (
    EmulatedRobot,
    EmulatedRobots,
    FirmwareProgram,
    SlaveProgram,
)
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, Flag, encode_command
from tetractl.lab.actuators.m3pi.slave import encode_wheels

MS = 1_000_000
LAG = 0.04


def robot(boot):
    one = EmulatedRobot("green", boot)
    EmulatedRobots([one], train((5.0, 5.0), (4, 4)), np.array([40.0]), np.array([LAG]))
    one.place(100.0, 200.0, 0.3)
    return one


def frame(sequence, *wheels, flags=Flag.RUN):
    return encode_command(BroadcastCommand(sequence, flags, wheels))


def covered(speed, seconds):
    """How far a wheel came that was at rest: the integral of speed (1 - exp(-t/lag))."""
    return speed * (seconds - LAG * -math.expm1(-seconds / LAG))


@given(st.integers(-127, 127), st.integers(-127, 127), st.integers(1, 2000))
def test_motion_is_that_of_two_lagging_wheels(left, right, millis):
    one = robot(SlaveProgram)
    one.hear(encode_wheels(left, right))
    one.robots.advance(millis * MS)
    speeds = [math.copysign(5.0 * max(0, abs(count) - 4), count) for count in (left, right)]
    ways = [covered(speed, millis / 1000) for speed in speeds]
    assert one.heading == pytest.approx(0.3 + (ways[1] - ways[0]) / 80.0, abs=2e-3)
    # v and the turning rate keep their ratio while the wheels speed up: an arc of a circle
    half = (ways[1] - ways[0]) / 160.0
    chord = (ways[0] + ways[1]) / 2 * (math.sin(half) / half if half else 1.0)
    assert one.x == pytest.approx(100 + chord * math.cos(0.3 + half), abs=0.2)
    assert one.y == pytest.approx(200 + chord * math.sin(0.3 + half), abs=0.2)


def test_a_slave_drives_on_in_silence_and_firmware_stops():
    slave, firmware = robot(SlaveProgram), robot(lambda: FirmwareProgram(0))
    slave.hear(encode_wheels(40, 40))
    firmware.hear(frame(1, (40, 40)))
    for one in (slave, firmware):
        one.robots.advance(200 * MS)
        assert one.wheels[0] == pytest.approx(180 * -math.expm1(-0.2 / LAG), rel=1e-6)
        one.robots.advance(3000 * MS)
    assert slave.wheels[0] == pytest.approx(180.0)
    assert firmware.standing
    assert firmware.x < 100 + 180 * 0.3
