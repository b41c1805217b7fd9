"""Tests of which bodies each kind of message shows, in which frame and when."""

from types import SimpleNamespace as Record

import pytest
from tetractl_ros2.body_readings import read_sightings


def header(frame="world", sec=12, nanosec=500):
    return Record(frame_id=frame, stamp=Record(sec=sec, nanosec=nanosec))


def pose(x=1.0, y=2.0, z=0.5):
    return Record(position=Record(x=x, y=y, z=z), orientation=Record(x=0.0, y=0.0, z=0.6, w=0.8))


def transform(child, frame="world"):
    placed = pose()
    parts = Record(translation=placed.position, rotation=placed.orientation)
    return Record(child_frame_id=child, header=header(frame), transform=parts)


MESSAGES = {
    "PoseStamped": Record(header=header(), pose=pose()),
    "Odometry": Record(header=header(), pose=Record(pose=pose())),
    "PoseWithCovarianceStamped": Record(header=header(), pose=Record(pose=pose())),
    "NamedPoseArray": Record(header=header(), poses=[Record(name="green", pose=pose())]),
    "TFMessage": Record(transforms=[transform("green")]),
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_every_kind_of_message_shows_the_same_body(kind):
    (seen,) = read_sightings(kind, MESSAGES[kind])
    assert seen.body == ("green" if kind in ("NamedPoseArray", "TFMessage") else None)
    assert seen.frame == "world"
    assert seen.stamp_ns == 12_000_000_500
    assert list(seen.rigid.position) == [1.0, 2.0, 0.5]
    assert list(seen.rigid.quaternion) == [0.0, 0.0, 0.6, 0.8]


@pytest.mark.parametrize("slash", ["", "/"])
def test_a_slash_before_a_frame_or_a_child_frame_is_no_part_of_its_name(slash):
    message = Record(transforms=[transform(f"{slash}green", f"{slash}world")])
    (seen,) = read_sightings("TFMessage", message)
    assert (seen.body, seen.frame) == ("green", "world")


def test_bodies_come_in_the_order_of_the_message():
    names = ["red", "green", "blue"]
    message = Record(transforms=[transform(name) for name in names])
    assert [seen.body for seen in read_sightings("TFMessage", message)] == names


def test_a_message_without_poses_is_refused():
    with pytest.raises(TypeError, match="messages of type Twist contain no poses"):
        read_sightings("Twist", Record())
