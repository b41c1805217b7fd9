"""Tests of reading and writing ROS 2 recordings, against independent readers."""

import csv
import math
import sqlite3
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
pytest.importorskip("rosbags", reason="recordings are read by rosbags")
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from testkit.cli import tetractl
from tetractl_ros2 import ros2_messages as m
from tetractl_ros2.bag_tables import (
    BagCommand,
    BagContents,
    BagPose,
    begin_ns_of,
    command_table,
    pose_table,
    read_bag,
)

from tetractl.core.errors import UsageError

PUBLIC = Path(__file__).parents[1] / "data" / "beginner_tutorials.db3"
STORE = get_typestore(Stores.ROS2_HUMBLE)
SECOND = 10**9


def rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_public_recording_is_read_as_another_decoder_reads_it():
    """Its poses, taken from the database and decoded by Cyclone DDS."""
    expected = []
    with sqlite3.connect(PUBLIC) as database:
        query = "select data from messages join topics on topics.id = topic_id where name = '/tf'"
        for (data,) in database.execute(query):
            for stamped in m.TFMessage.deserialize(bytes(data)).transforms:
                stamp = stamped.header.stamp
                at = stamped.transform.translation
                time_ns = stamp.sec * SECOND + stamp.nanosec
                expected.append((stamped.child_frame_id, time_ns, at.x, at.y))
    database.close()
    read = [(o.robot, o.time_ns, o.x, o.y) for o in read_bag(PUBLIC).poses if o.topic == "/tf"]
    assert len(read) == len(expected) > 0
    assert sorted(read) == sorted(expected)


def message(kind, **fields):
    return STORE.types[kind](**fields)


def header(at_ns, frame):
    sec, nanosec = divmod(at_ns, SECOND)
    stamp = message("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(x, y, heading):
    half = heading / 2
    point = message("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
    kind = "geometry_msgs/msg/Quaternion"
    turn = message(kind, x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
    return message("geometry_msgs/msg/Pose", position=point, orientation=turn)


def stamped(at_ns, x, y, heading, frame="map"):
    posed = pose(x, y, heading)
    return message("geometry_msgs/msg/PoseStamped", header=header(at_ns, frame), pose=posed)


def twist(v, w):
    kind = "geometry_msgs/msg/Vector3"
    linear = message(kind, x=v, y=0.0, z=0.0)
    angular = message(kind, x=0.0, y=0.0, z=w)
    return message("geometry_msgs/msg/Twist", linear=linear, angular=angular)


POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/Twist"


def bag(folder, *messages, plugin=StoragePlugin.SQLITE3):
    """A recording of messages: topic, type, time of recording, message."""
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, kind, at_ns, content in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], at_ns, STORE.serialize_cdr(content, kind))
    return folder


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_poses_and_commands_become_the_tables_of_identify(tmp_path, plugin):
    recorded = bag(
        tmp_path / "bag",
        ("/green/pose", POSE, 5 * SECOND, stamped(4 * SECOND, 1.0, 2.0, 0.5)),
        ("/green/cmd_vel", TWIST, 6 * SECOND, twist(0.2, -0.4)),
        plugin=plugin,
    )
    tetractl(tmp_path, "rosbag-tables", recorded, "-o", "tables").ok()
    (posed,) = rows(tmp_path / "tables" / "poses.csv")
    (sent,) = rows(tmp_path / "tables" / "commands.csv")
    assert (posed["robot"], posed["x_m"], posed["y_m"]) == ("green", "1.0", "2.0")
    assert math.isclose(float(posed["heading_rad"]), 0.5) and float(posed["time_s"]) == 0.0
    assert sent == {"time_s": "2.0", "robot": "green", "v_m_s": "0.2", "w_rad_s": "-0.4"}


def test_commands_without_a_robot_in_their_topic_have_no_column_for_it(tmp_path):
    recorded = bag(
        tmp_path / "bag",
        ("/pose", POSE, SECOND, stamped(SECOND, 1.0, 2.0, 0.5)),
        ("/cmd_vel", TWIST, SECOND, twist(0.2, -0.4)),
    )
    tetractl(tmp_path, "rosbag-tables", recorded, "-o", "tables").ok()
    assert "robot" not in rows(tmp_path / "tables" / "commands.csv")[0]


def two_frames(tmp_path):
    return bag(
        tmp_path / "bag",
        ("/green/pose", POSE, SECOND, stamped(SECOND, 1.0, 2.0, 0.5)),
        ("/green/amcl", POSE, SECOND, stamped(SECOND, 3.0, 4.0, 0.5, "odom")),
    )


def test_poses_in_two_frames_are_not_mixed(tmp_path):
    two_frames(tmp_path)
    done = tetractl(tmp_path, "rosbag-tables", "bag", "-o", "tables")
    assert done.returncode == 2
    assert "the recording has poses of a robot in more than one frame: map, odom" in done.stderr
    tetractl(tmp_path, "rosbag-tables", "bag", "-o", "tables", "--frame", "odom").ok()
    (posed,) = rows(tmp_path / "tables" / "poses.csv")
    assert posed["x_m"] == "3.0"


@pytest.mark.parametrize("name", ["nothing.mcap", "text.mcap", "text.db3"])
def test_what_is_no_recording_is_one_line(tmp_path, name):
    for text in ("text.mcap", "text.db3"):
        (tmp_path / text).write_text("no recording\n" * 20)
    done = tetractl(tmp_path, "rosbag-tables", name, "-o", "tables")
    assert done.returncode in (1, 2) and "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) <= 2 and name in done.stderr


def test_a_recording_without_poses_is_refused(tmp_path):
    bag(tmp_path / "bag", ("/cmd_vel", TWIST, SECOND, twist(0.2, -0.4)))
    done = tetractl(tmp_path, "rosbag-tables", "bag", "-o", "tables")
    assert done.returncode == 2 and "has no poses" in done.stderr


def contents(*poses, commands=()):
    return BagContents(tuple(poses), tuple(commands))


def posed(robot="green", topic="/tf", frame="map", at_ns=SECOND, x=1.0):
    return BagPose(topic, robot, frame, at_ns, x, 2.0, 0.5)


def columns(table):
    return {column.name: list(column.values) for column in table.columns}


def test_times_count_from_the_earliest_pose_or_command():
    recorded = contents(
        posed(at_ns=5 * SECOND),
        posed(at_ns=4 * SECOND),
        commands=[
            BagCommand("/green/cmd_vel", "green", 7 * SECOND // 2, 0.1, 0.2),
            BagCommand("/green/cmd_vel", "green", 3 * SECOND, 0.3, 0.4),
        ],
    )
    assert begin_ns_of(recorded) == 3 * SECOND
    assert columns(pose_table(recorded, None, None))["time_s"] == [1.0, 2.0]
    sent = columns(command_table(recorded))
    assert sent == {
        "time_s": [0.0, 0.5],
        "robot": ["green", "green"],
        "v_m_s": [0.3, 0.1],
        "w_rad_s": [0.4, 0.2],
    }


def test_of_several_poses_of_a_robot_at_one_time_the_first_is_kept():
    recorded = contents(posed(x=1.0), posed(x=9.0), posed("blue", x=3.0), posed(at_ns=9, x=4.0))
    table = columns(pose_table(recorded, None, None))
    assert table["x_m"] == [4.0, 1.0, 3.0]
    assert table["robot"] == ["green", "green", "blue"]


def test_a_robot_on_two_topics_needs_a_choice_and_two_robots_on_two_topics_do_not():
    two = contents(posed(topic="/a"), posed(topic="/b", at_ns=9))
    with pytest.raises(UsageError, match="more than one topic: /a, /b") as error:
        pose_table(two, None, None)
    assert error.value.hint == "add --topic"
    assert len(columns(pose_table(two, "/b", None))["x_m"]) == 1
    each = contents(posed(topic="/a"), posed("blue", topic="/b"))
    assert len(columns(pose_table(each, None, None))["x_m"]) == 2


def test_a_topic_or_a_frame_that_the_recording_lacks_is_answered_by_those_that_it_has():
    recorded = contents(posed(topic="/a"), posed(topic="/b", frame="odom"))
    for topic, frame in (("/c", None), (None, "world"), ("/a", "odom")):
        with pytest.raises(UsageError, match="no such poses") as error:
            pose_table(recorded, topic, frame)
        assert error.value.hint == "the recording has /a in map, /b in odom"
    with pytest.raises(UsageError) as nothing:
        pose_table(contents(), None, None)
    assert nothing.value.hint == "the recording has none"


@pytest.mark.parametrize(
    ("topic", "robot"),
    [("/green/cmd_vel", "green"), ("/green/base/cmd_vel", "green"), ("/cmd_vel", "")],
)
def test_a_command_is_of_the_robot_that_its_topic_names(tmp_path, topic, robot):
    recorded = bag(tmp_path / "bag", (topic, TWIST, 6 * SECOND, twist(0.2, -0.4)))
    (command,) = read_bag(recorded).commands
    assert (command.robot, command.time_ns, command.v, command.w) == (robot, 6 * SECOND, 0.2, -0.4)


@pytest.mark.parametrize(("stamp", "at_ns"), [(4 * SECOND, 4 * SECOND), (0, 6 * SECOND)])
def test_a_stamp_in_the_header_is_the_time_unless_it_is_not_set(tmp_path, stamp, at_ns):
    kind = "geometry_msgs/msg/TwistStamped"
    stamped_twist = message(kind, header=header(stamp, "base"), twist=twist(0.2, 0.1))
    recorded = bag(
        tmp_path / "bag",
        ("/green/cmd_vel", kind, 6 * SECOND, stamped_twist),
        ("/green/pose", POSE, 6 * SECOND, stamped(stamp, 1.0, 2.0, 0.5)),
    )
    read = read_bag(recorded)
    assert [command.time_ns for command in read.commands] == [at_ns]
    assert [pose.time_ns for pose in read.poses] == [at_ns]


def transform(at_ns, child, x):
    kind = "geometry_msgs/msg/"
    moved = message(f"{kind}Vector3", x=x, y=0.0, z=0.0)
    turn = message(f"{kind}Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    transformed = message(f"{kind}Transform", translation=moved, rotation=turn)
    stamp = header(at_ns, "/map")
    return message(
        f"{kind}TransformStamped", header=stamp, child_frame_id=child, transform=transformed
    )


def test_frames_that_never_move_and_poses_that_are_not_finite_are_left_out(tmp_path):
    kind = "tf2_msgs/msg/TFMessage"
    moving = [transform(SECOND, "green/base_link", 1.0), transform(SECOND, "/blue", math.nan)]
    still = [transform(SECOND, "camera", 5.0)]
    recorded = bag(
        tmp_path / "bag",
        ("/tf", kind, SECOND, message(kind, transforms=moving)),
        ("/tf_static", kind, SECOND, message(kind, transforms=still)),
    )
    (pose,) = read_bag(recorded).poses
    assert (pose.robot, pose.frame, pose.x) == ("green", "map", 1.0)


def test_a_recording_of_other_things_has_neither_poses_nor_commands(tmp_path):
    kind = "std_msgs/msg/String"
    read = read_bag(bag(tmp_path / "bag", ("/chatter", kind, 1, message(kind, data="hello"))))
    assert read == contents()
    with pytest.raises(UsageError, match="no such file or folder"):
        read_bag(tmp_path / "none")
