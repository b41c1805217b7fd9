"""Tests that wrong fields of a ROS 2 lab in a spec are refused."""

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from tetractl.spec.lab_template import lab_template
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.problems import InvalidSpecError

TEMPLATE = lab_template("ros2", "ros2").replace("@NAME@", "name: graph")


def spec(old="", new=""):
    assert old in TEMPLATE
    return parse_spec(TEMPLATE.replace(old, new), "graph.yaml").experiment


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("/green/cmd_vel", "green/cmd_vel", "must be a full topic name, such as /green/cmd_vel"),
        ("/green/cmd_vel", "/blue/cmd_vel", "is also the value of"),
        ("/green/cmd_vel", "'/{body}/cmd_vel'", "must be a full topic name"),
        ("message: TFMessage", "message: PoseStamped", r"must contain \{body\}"),
        ("message: TFMessage", "message: Pose", "Odometry"),
        ("topic: /tf", "topic: /{robot}/pose", "no other braces"),
        ("watchdog: 0.5", "watchdog: 0.6", "set wheels.watchdog to this value"),
        ("stops_after: 0.5", "stops_after: 0.5\n    rate: 10\n    delay: -1", "delay"),
        ("stops_after: 0.5", "stops_after: 0.2\n    rate: 10", "for 3 commands within 0.2 s"),
        (
            "stops_after: 0.5",
            "stops_after: null",
            "is missing, although wheels.watchdog says that the robots stop after 0.5 s",
        ),
        ("speed_max_mm_s: 320", "speed_max_mm_s: 100", "is below the speed of"),
        ("domain: 0 ", "domain: 233 ", "232"),
    ],
)
def test_what_cannot_be_is_refused(old, new, what):
    with pytest.raises(InvalidSpecError, match=what):
        spec(old, new)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("message: TFMessage ", "message: NamedPoseArray "),
        ("topic: /tf ", "topic: /mocap/tf "),
        ("frame: world", "frame: map/floor 1"),
        ("message: Twist ", "message: TwistStamped "),
        ("/green/cmd_vel", "/robot_1/base/cmd_vel_unstamped"),
        (", battery: /green/battery_state", ""),
        ("    emergency_stop: /emergency_stop ", "    # "),
        ("domain: 0 ", "domain: 42 "),
        ("message: TFMessage          # or NamedPoseArray, PoseStamped, Odometry\n    topic: /tf ",
         "message: Odometry\n    topic: /{body}/odometry/filtered "),
        ("stops_after: 0.5 ", "stops_after: 1.0 "),
    ],
)  # fmt: skip
def test_what_other_labs_have_is_accepted(old, new):
    spec(old, new)
