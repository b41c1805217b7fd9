"""The charge that emulated robots draw from their batteries."""

import numpy as np
import pytest
from tetractl_emulator.m3pi.robot import EmulatedRobot, EmulatedRobots

from tetractl.core.clock import MILLISECOND
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag
from tetractl.model.wheels import Drivetrains

ONE = np.ones((2, 1))
WHEELS = Drivetrains(gain=8.0 * ONE, dead_zone=0.0 * ONE, limit=127, swap=np.zeros(1, np.bool_))


def charge_left_mv(read_every_ms):
    """Return the voltage without load of a robot that drives ahead and back, whose state is read
    every so many milliseconds."""
    robot = EmulatedRobot("green", 0)
    fleet = EmulatedRobots([robot], WHEELS, np.array([40.0]), np.array([0.04]))
    for ms in range(1, 401):
        if ms % 100 == 1:
            counts = 100 if ms < 200 else -100
            command = BroadcastCommand(ms // 100 + 1, Flag.RUN, ((counts, counts),))
            robot.hear(encode_command(command))
        fleet.advance(ms * MILLISECOND)
        if ms % read_every_ms == 0:
            assert robot.wheels
    fleet.now()
    return robot.battery.open_mv


def test_a_battery_is_drawn_from_alike_however_often_its_robot_is_read():
    """Regression: the load at the end of a time between two reads counted for all of it."""
    assert charge_left_mv(1) == pytest.approx(charge_left_mv(400), abs=1e-9)
    assert charge_left_mv(7) == pytest.approx(charge_left_mv(400), abs=1e-9)
