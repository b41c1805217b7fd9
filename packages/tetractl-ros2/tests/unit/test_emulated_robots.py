"""Tests of emulated robots of a ROS 2 graph: what messages and faults make them do."""

import math

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from testkit.emulator.virtual_lab import virtual_lab
from tetractl_ros2.emulated.side import (
    EMPTY_BATTERY_MV,
    FULL_BATTERY_MV,
    TwistProgram,
    _battery_state,
)
from tetractl_ros2.ros2_messages import Bool, Twist, Vector3

from tetractl.core.clock import SECOND
from tetractl.lab.actuators.wheel_commands import Status
from tetractl.spec.lab_template import lab_template

TEMPLATE = lab_template("ros2", "ros2").replace("@NAME@", "name: graph")


def program():
    return TwistProgram(lambda message: (10, 20), 0.25, 5000)


def test_a_robot_follows_messages_until_its_watchdog_or_an_emergency_stop():
    robot = program()
    robot.push(b"", 1000)
    assert (robot.wheels(1249), robot.status(1249)) == ((10, 20), Status.RUNNING)
    assert (robot.wheels(1250), robot.status(1250)) == ((0, 0), Status.SILENT)
    robot.push(b"", 2000)
    robot.is_emergency_stopped = True
    assert (robot.wheels(2000), robot.status(2000)) == ((0, 0), Status.EMERGENCY_STOPPED)
    robot.push(b"", 2010)
    assert robot.wheels(2010) == (0, 0)


@pytest.mark.parametrize(
    ("millivolts", "share"),
    [
        (FULL_BATTERY_MV, 1.0),
        (FULL_BATTERY_MV + 300, 1.0),
        (EMPTY_BATTERY_MV, 0.0),
        (EMPTY_BATTERY_MV - 300, 0.0),
        (4750, 0.5),
    ],
)
def test_a_battery_is_published_in_volts_and_as_a_share(millivolts, share):
    state = _battery_state(millivolts)
    assert state.voltage == pytest.approx(millivolts / 1000)
    assert state.percentage == pytest.approx(share)


def robots(lab):
    return lab.emulation.actuator


def twist(v, w):
    zero = Vector3(0.0, 0.0, 0.0)
    return Twist(Vector3(v, zero.y, zero.z), Vector3(0.0, 0.0, w)).serialize()


@pytest.mark.slow
def test_a_twist_is_a_speed_and_a_turning_rate_of_the_wheels():
    with virtual_lab(None, spec=TEMPLATE) as lab:
        side = robots(lab)
        unit_mm = lab.spec.experiment.plant.actuator.unit_mm
        left, right = (count * unit_mm for count in side.read(twist(0.1, 0.5), 1))
        assert (left + right) / 2 == pytest.approx(100.0, abs=unit_mm)
        assert (right - left) / 2 == pytest.approx(0.5 * side.radii[1], abs=unit_mm)
        left, right = side.read(twist(-0.1, 0.0), 1)
        assert left == right == round(-100 / unit_mm)


@pytest.mark.slow
def test_a_direction_steers_a_robot_by_equation_three_and_its_height_stops_it():
    text = TEMPLATE.replace("message: Twist ", "message: Vector3Stamped ")
    with virtual_lab(None, spec=text) as lab:
        side = robots(lab)
        setup = lab.spec.experiment.setup
        heading = side.robots[1].heading
        for aside in (0.0, 0.7, -2.0):
            direction = heading + aside
            vector = Vector3(math.cos(direction), math.sin(direction), 0.0)
            speed, turning = side._steer(vector, 1)
            assert speed == pytest.approx(setup.speed[1] * setup.metres * 1000)
            assert turning == pytest.approx(setup.a[1] * math.sin(aside), abs=1e-9)
        assert side._steer(Vector3(1.0, 0.0, 1.0), 1)[0] == 0.0
        assert side._steer(Vector3(0.0, 0.0, 0.0), 1) == (0.0, 0.0)


@pytest.mark.slow
def test_an_emergency_stop_reaches_all_robots_that_are_on_and_false_reaches_none():
    with virtual_lab(None, spec=TEMPLATE) as lab:
        side = robots(lab)
        stop = side.radios[-1]
        side.robots[2].switch(False)
        for data in (Bool(data=False).serialize(), b"\xff"):
            stop.receive(data)
            assert not any(robot.core.is_emergency_stopped for robot in side.robots)
        stop.receive(Bool(data=True).serialize())
        stop.receive(Bool(data=False).serialize())
        stopped = [robot.core.is_emergency_stopped for robot in side.robots]
        assert stopped == [True, True, False]


@pytest.mark.slow
def test_each_robot_that_is_on_publishes_its_battery_twice_a_second():
    with virtual_lab(None, spec=TEMPLATE) as lab:
        side = robots(lab)
        counts = [0] * 3
        for row, port in enumerate(side._battery_ports):

            def write(data, row=row):
                counts[row] += 1

            port.write = write
        side.robots[0].switch(False)
        lab.clock.sleep_until(lab.clock.now() + 2 * SECOND)
    assert counts == [0, 4, 4]
