"""Tests that wrong fields of a ROS 2 lab in a spec are refused."""

import re

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


@pytest.mark.parametrize("names", [("green", "blue", "red"), ("red", "green", "blue")])
def test_each_robot_has_the_topic_of_its_body_in_whatever_order_they_are_listed(names):
    listed = "\n".join(f"      - {{name: {name}, body: {name[0].upper()}}}" for name in names)
    text = TEMPLATE.replace("message: TFMessage ", "message: PoseStamped ")
    text = text.replace("topic: /tf ", "topic: /{body}/pose ")
    text = re.sub(r"(      - \{name: \w+, body: \w+\}\n?)+", listed + "\n", text)
    experiment = parse_spec(text, "graph.yaml").experiment
    expected = tuple(f"/{name[0].upper()}/pose" for name in experiment.setup.names)
    assert experiment.lab.camera.topics(experiment.setup) == expected


def test_all_robots_have_one_topic_if_its_name_contains_no_body():
    experiment = spec()
    assert experiment.lab.camera.topics(experiment.setup) == ("/tf",)
