"""Tests of twists, emergency stops and batteries, with emulated robots and a fake graph."""

import math

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from tetractl_emulator.contract import check_lab
from tetractl_ros2.actuator import Ros2Robots
from tetractl_ros2.ros2_messages import BatteryState, Bool, Twist, TwistStamped, Vector3Stamped
from tetractl_ros2.topic_port import UNDECODABLE, TopicEnd

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer, Turn
from tetractl.core.errors import AbortError, UsageError
from tetractl.core.poses import Pose
from tetractl.spec.lab_template import lab_template
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.problems import InvalidSpecError

TEMPLATE = lab_template("ros2", "ros2").replace("@NAME@", "name: graph")
NAMES = ("green", "blue", "red")
NO_WATCHDOG = ("stops_after: 0.5", "stops_after: null"), (", watchdog: 0.5", "")


def spec(*changes):
    text = TEMPLATE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return parse_spec(text, "graph.yaml").experiment


class Ports:
    """Topics to which a test subscribes."""

    def __init__(self):
        self.sent = {}
        self.failing = set()
        self.heard = {}

    def make(self, name, baud, device, clock, heard, hint):
        topic = name.removeprefix("ros2://0")
        ports = self
        self.sent[topic] = []
        self.heard[topic] = heard

        class Port:
            failure = None
            refusal = None

            def open(self):
                pass

            def settle(self):
                pass

            def close(self):
                pass

            def write(self, data):
                if topic in ports.failing:
                    raise AbortError("gone")
                ports.sent[topic].append(data)
                return clock.now()

        return Port()


def robots_of(experiment, **options):
    ports = Ports()
    actuator = experiment.lab.actuator
    return Ros2Robots(actuator, experiment.setup, VirtualClock(), ports.make, **options), ports


@pytest.mark.parametrize("message", ["Twist", "TwistStamped", "Vector3Stamped"])
def test_the_lab_relies_on_nothing_that_is_missing(message):
    experiment = spec(("message: Twist ", f"message: {message} "))
    check_lab(experiment.lab, experiment.setup)


def test_a_twist_asks_for_the_speed_and_turning_rate_of_the_wheel_speeds_that_are_logged():
    robots, ports = robots_of(spec())
    with robots:
        sent = robots.send(Steer(math.pi / 2), [Pose(0.0, 0.0, 0.0)] * 3, (True,) * 3, 0)
    for row, name in enumerate(NAMES):
        twist = Twist.deserialize(ports.sent[f"/{name}/cmd_vel"][-1])
        left, right = sent.left[row], sent.right[row]  # mm/s
        assert twist.angular.z > 0
        assert math.isclose(twist.linear.x, (left + right) / 2000, abs_tol=1e-4)
        assert math.isclose(twist.angular.z, (right - left) / 160, abs_tol=1e-3)


def test_a_stamped_twist_has_the_time_since_1970():
    experiment = spec(("message: Twist ", "message: TwistStamped "))
    robots, ports = robots_of(experiment, unix_ns=lambda: 1_700_000_000 * SECOND + 5)
    with robots:
        robots.stop()
    message = TwistStamped.deserialize(ports.sent["/green/cmd_vel"][-1])
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 5)
    assert message.twist == Twist()


def vectors(ports, name):
    sent = [Vector3Stamped.deserialize(data).vector for data in ports.sent[f"/{name}/cmd_vel"]]
    return [(o.x, o.y, o.z) for o in sent]


def test_robots_that_steer_themselves_are_sent_the_direction_and_stand_alone():
    robots, ports = robots_of(spec(("message: Twist ", "message: Vector3Stamped ")))
    poses = [Pose(0.0, 0.0, 0.0)] * 3
    with robots:
        robots.send(Steer(0.5), poses, (True, False, True), 0)
        robots.send(Turn(0.5), poses, (True, True, True), 0)
        robots.stop()
    driving = (math.cos(0.5), math.sin(0.5), 0.0)
    turning = (math.cos(0.5), math.sin(0.5), 1.0)
    assert vectors(ports, "green") == [driving, turning, (0.0, 0.0, 0.0)]
    assert vectors(ports, "blue") == [(0.0, 0.0, 0.0), turning, (0.0, 0.0, 0.0)]


def test_robots_that_steer_themselves_need_the_axes_of_the_spec():
    steered = ("message: Twist ", "message: Vector3Stamped ")
    with pytest.raises(InvalidSpecError, match=r"so camera\.rotation must be 0"):
        spec(steered, ("frame: world ", "frame: world\n    rotation: 0.1 "))
    section = spec(steered).lab.actuator
    with pytest.raises(UsageError, match="cannot be calibrated"):
        section.calibrate(None, None, None, [], 1, print)


def test_only_an_emergency_stop_is_sent_to_the_common_topic():
    robots, ports = robots_of(spec())
    with robots:
        robots.stop()
        assert ports.sent["/emergency_stop"] == []
        robots.stop(emergency=True)
    assert [Bool.deserialize(data).data for data in ports.sent["/emergency_stop"]] == [True]


def test_a_robot_whose_topic_fails_keeps_no_other_from_its_stop():
    robots, ports = robots_of(spec())
    ports.failing.add("/green/cmd_vel")
    with robots, pytest.raises(AbortError, match="gone"):
        robots.stop(emergency=True)
    for topic in ("/blue/cmd_vel", "/red/cmd_vel", "/emergency_stop"):
        assert len(ports.sent[topic]) == 1


def test_without_a_watchdog_the_operator_is_asked():
    assert robots_of(spec())[0].check().questions == ()
    (question,) = robots_of(spec(*NO_WATCHDOG))[0].check().questions
    assert "if this computer or its network fails, the robots drive on" in question


@pytest.mark.parametrize(("partners", "count"), [(0, 1), (1, 0)])
def test_an_emergency_stop_that_no_robot_receives_is_a_problem(monkeypatch, partners, count):
    monkeypatch.setattr(TopicEnd, "n_partners", partners)
    monkeypatch.setattr(TopicEnd, "count_other_publishers", lambda end: 0)
    experiment = spec()
    robots = Ros2Robots(experiment.lab.actuator, experiment.setup, VirtualClock())
    problems = robots.check().problems
    said = (
        "the emergency stop does not reach any robot: no node subscribes to /emergency_stop: "
        "is the robot's driver running, and in the same ROS domain?"
    )
    assert problems == (said,) * count


def test_a_battery_state_that_cannot_be_read_changes_nothing():
    robots, ports = robots_of(spec())
    good = BatteryState(voltage=11.0, percentage=0.5).serialize()
    for data in (good, UNDECODABLE, b""):
        ports.heard["/green/battery_state"](data, 0)
    assert robots.poll(0.1)[0].charge == 50


def test_low_batteries_are_reported():
    robots, ports = robots_of(spec())
    for name, share in (("green", 0.15), ("blue", 0.05)):
        data = BatteryState(voltage=11.0, percentage=share).serialize()
        ports.heard[f"/{name}/battery_state"](data, 0)
    low, empty, silent = robots.poll(0.1)
    assert low.warnings == ("green's battery is at 15 %",) and low.charge == 15
    assert empty.problems == ("blue's battery is at 5 %: charge it",)
    assert silent.warnings == ("red sends no battery state on the topic /red/battery_state",)


def predicted_heading(delay_s):
    """The heading for which green's wheel speeds were meant, half a second into a turn."""
    experiment = parse_spec(TEMPLATE, "graph.yaml", [f"lab.actuator.delay={delay_s}"]).experiment
    robots, ports = robots_of(experiment)
    clock = robots._clock
    with robots:
        for time_ns in range(0, SECOND // 2 + 1, SECOND // 10):
            clock.sleep_until(time_ns)
            robots.send(Steer(math.pi / 2), [Pose(500.0, 600.0, 0.2)] * 3, (True,) * 3, time_ns)
    twist = Twist.deserialize(ports.sent["/green/cmd_vel"][-1])
    a = experiment.setup.a[0]
    return math.pi / 2 - math.asin(twist.angular.z / a), twist.angular.z


def test_wheel_speeds_are_those_for_the_heading_when_they_will_act():
    """A robot that turns on while commands travel is that much further when they arrive."""
    now, turning = predicted_heading(0.0)
    later, _ = predicted_heading(0.1)
    assert now == pytest.approx(0.2, abs=0.02)
    assert later - now == pytest.approx(0.1 * turning, rel=0.15)
