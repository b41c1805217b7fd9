"""Tests of robots with a port each that receive wheel speeds: in which unit, and at which limit."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.poses import Pose
from tetractl.lab.actuators.m3pi.actuator import drivetrains
from tetractl.lab.actuators.m3pi.section import M3piRobot
from tetractl.lab.actuators.own_robots import OwnRobots
from tetractl.lab.actuators.own_section import OwnSection

SETUP = experiment(wheels={"radius": 40}).setup
POSES = [Pose(0.0, 0.0, heading) for heading in (0.0, 0.5, -2.0)]


class Robots(OwnRobots):
    def packed(self, row, left, right):
        return b"%d: %d %d" % (row, left, right)


class InTenths(OwnSection):
    """A section of robots that receive tenths of mm/s."""

    type: str = "own"
    unit_mm = 0.1


class Port:
    """Stands for the port of a robot."""

    failure = None

    def __init__(self, name, sent):
        self.name = name
        self.sent = sent

    def write(self, data):
        self.sent.append((self.name, data))
        return len(self.sent)


def robots(sent, setup=SETUP, **fields):
    names = ("red", "green", "blue")  # in another order than the setup's
    rows = [{"name": name, "address": f"port of {name}"} for name in names]
    rows[1] |= {"left_gain": 1.25, "right_gain": 0.8, "radius_mm": 30.0}
    section = InTenths.model_validate({"robots": rows} | fields)
    return Robots(section, setup, VirtualClock(), lambda name, *_: Port(name, sent))


def numbers(sent):
    """The speeds of each message, left and right, in the order of the setup (2, N)."""
    return np.array([[*map(int, data.split(b": ")[1].split())] for _, data in sent]).T


def test_each_robot_gets_its_wheel_speeds_in_its_unit_at_its_own_port():
    sent = []
    made = robots(sent, speed_max_mm_s=4000, delay=0)
    transmission = made.send(Steer(1.0), POSES, (True,) * 3, 0)
    assert [name for name, _ in sent] == ["port of green", "port of blue", "port of red"]
    assert [data[:2] for _, data in sent] == [b"0:", b"1:", b"2:"]
    heading = np.array([pose.heading for pose in POSES])
    radius = np.array([30.0, 40.0, 40.0])
    difference = SETUP.a * radius * np.sin(1.0 - heading)
    gain = np.array([[1.25, 1, 1], [0.8, 1, 1]])
    wheels = np.array([SETUP.speed - difference, SETUP.speed + difference])
    assert numbers(sent) * 0.1 * gain == pytest.approx(wheels, abs=0.07)
    logged = np.array([transmission.left, transmission.right])
    assert logged == pytest.approx(numbers(sent) * 0.1 * gain)


def test_no_wheel_is_sent_more_than_the_maximum_speed():
    sent = []
    made = robots(sent, speed_max_mm_s=100)
    made.send(Steer(1.0), POSES, (True,) * 3, 0)
    assert np.abs(numbers(sent)).max(axis=0).tolist() == [1000, 1000, 1000]


def test_a_robot_that_may_not_move_or_is_not_seen_gets_no_speed():
    sent = []
    made = robots(sent)
    made.send(Steer(1.0), [POSES[0], None, POSES[2]], (False, True, True), 0)
    assert numbers(sent)[:, :2].tolist() == [[0, 0], [0, 0]]
    assert numbers(sent)[:, 2].any()


@pytest.mark.parametrize("emergency", [True, False])
def test_a_stop_is_a_speed_of_zero_by_default(emergency):
    sent = []
    stop = robots(sent).stop(emergency)
    assert numbers(sent).tolist() == [[0, 0, 0], [0, 0, 0]]
    assert (stop.left.tolist(), stop.right.tolist()) == ([0, 0, 0], [0, 0, 0])
    assert stop.sent_ns == 3


def test_lengths_of_the_log_are_in_the_specs_unit_and_those_of_robots_in_mm():
    in_metres = replace(SETUP, metres=1.0, speed=SETUP.speed / 1000, wheel_radius=0.04)
    sent, sent_in_mm = [], []
    transmission = robots(sent, in_metres).send(Steer(1.0), POSES, (True,) * 3, 0)
    same = robots(sent_in_mm).send(Steer(1.0), POSES, (True,) * 3, 0)
    assert sent == sent_in_mm
    assert transmission.left * 1000 == pytest.approx(same.left)
    assert transmission.speed * 1000 == pytest.approx(same.speed)
    assert transmission.turning == pytest.approx(same.turning)


def test_commands_are_due_at_the_rate_of_the_section():
    assert robots([], rate=50).period_ns == SECOND // 50


def test_the_wheels_of_m3pi_robots_are_those_of_their_fields():
    fields = {
        "name": "green",
        "left": {"gain_mm": 2.0, "dead_zone": 3, "invert": True},
        "right": {"gain_mm": 4.0, "dead_zone": 5},
        "swap": True,
        "limit": 90,
    }
    other = {"name": "blue", "right": {"gain_mm": 8.0, "invert": True}}
    wheels = drivetrains([M3piRobot.model_validate(robot) for robot in (fields, other)])
    assert wheels.gain == pytest.approx(np.array([[-2.0, 1000 / 127], [4.0, -8.0]]))
    assert wheels.dead_zone.tolist() == [[3, 0], [5, 0]]
    assert wheels.limit.tolist() == [90, 127]
    assert wheels.swap.tolist() == [True, False]
