"""Tests of messages on the wire: bytes equal those of an independent encoder of ROS 2's
definitions.
"""

import math

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
pytest.importorskip("rosbags", reason="rosbags is the independent reader and writer")
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tetractl_ros2 import ros2_messages as m

NAMED = "motion_capture_tracking_interfaces/msg/"
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(
    get_types_from_msg("string name\ngeometry_msgs/Pose pose\n", f"{NAMED}NamedPose")
    | get_types_from_msg("std_msgs/Header header\nNamedPose[] poses\n", f"{NAMED}NamedPoseArray")
)
HEADER = m.Header(m.Time(1_700_000_000, 123_456_789), "world")
POSE = m.PoseMessage(m.Point(1.5, -2.25, 0.1), m.Quaternion(0.0, 0.0, 0.6, 0.8))
TWIST = m.Twist(m.Vector3(0.2), m.Vector3(z=-0.5))
COVARIANCE = [float(i) for i in range(36)]
EXAMPLES = {
    "std_msgs/msg/Bool": m.Bool(True),
    "geometry_msgs/msg/Twist": TWIST,
    "geometry_msgs/msg/TwistStamped": m.TwistStamped(HEADER, TWIST),
    "geometry_msgs/msg/Vector3Stamped": m.Vector3Stamped(HEADER, m.Vector3(0.6, 0.8)),
    "geometry_msgs/msg/PoseStamped": m.PoseStamped(HEADER, POSE),
    "nav_msgs/msg/Odometry": m.Odometry(
        HEADER,
        "base_link",
        m.PoseWithCovariance(POSE, COVARIANCE),
        m.TwistWithCovariance(TWIST, COVARIANCE),
    ),
    "tf2_msgs/msg/TFMessage": m.TFMessage(
        [
            m.TransformStamped(HEADER, "green", m.Transform(m.Vector3(1, 2, 3), m.Quaternion())),
            m.TransformStamped(HEADER, "b", m.Transform(m.Vector3(4, 5, 6), m.Quaternion())),
        ]
    ),
    f"{NAMED}NamedPoseArray": m.NamedPoseArray(HEADER, [m.NamedPose("green", POSE)]),
    "sensor_msgs/msg/BatteryState": m.BatteryState(
        HEADER, voltage=11.5, percentage=0.75, cell_voltage=[3.5, 3.75], serial_number="4711"
    ),
}


def fields(message):
    """A message as nested tuples, whatever program has made it."""
    if isinstance(message, str | bool | int | float | np.number):
        return message.item() if isinstance(message, np.number) else message
    if isinstance(message, list | tuple | np.ndarray):
        return [fields(value) for value in message]
    names = [
        name
        for name in vars(type(message)).get("__dataclass_fields__")
        if name[0] != "_" and not name.isupper()
    ]
    return {name: fields(getattr(message, name)) for name in names}


def same(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other or (math.isnan(one) and math.isnan(other))


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_independent_reader_reads_what_is_sent(name):
    message = EXAMPLES[name]
    read = fields(STORE.deserialize_cdr(message.serialize(), name))
    read.pop("__msgtype__", None)
    assert same(fields(message), read)


@pytest.mark.parametrize("name", EXAMPLES)
def test_what_an_independent_writer_sends_is_read(name):
    message = EXAMPLES[name]
    foreign = STORE.deserialize_cdr(message.serialize(), name)
    written = bytes(STORE.serialize_cdr(foreign, name))
    assert same(fields(type(message).deserialize(written)), fields(message))


def test_the_name_of_a_type_is_that_of_ros_2():
    for name, message in EXAMPLES.items():
        package, _, short = name.split("/")
        assert message.__idl__.idl_transformed_typename == f"{package}::msg::dds_::{short}_"
