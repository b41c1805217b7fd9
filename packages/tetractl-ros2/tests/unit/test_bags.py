"""Tests of reading and writing ROS 2 recordings, against independent readers."""

import csv
import math
import sqlite3
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
pytest.importorskip("rosbags", reason="recordings are read by rosbags")
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from testkit.cli import tetractl
from testkit.paths import ROOT
from tetractl_ros2 import ros2_messages as m
from tetractl_ros2.bag_of_log import topic_part, write_bag
from tetractl_ros2.bag_tables import read_bag

import tetractl as api
from tetractl.log.read.reader import read_trial

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


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """A short trial of robots on wheels, simulated, and its recording."""
    folder = tmp_path_factory.mktemp("log")
    spec = api.load_spec(ROOT / "experiments" / "three_m3pi.yaml", "controller.time_limit=1")
    api.run_trial(spec, folder=folder)
    read = read_trial(folder / "trial-000.mcap")
    write_bag(read, folder / "bag")
    return read, folder / "bag"


@pytest.mark.slow
def test_rosbags_reads_a_recorded_trial_back(trial):
    read, folder = trial
    poses = {}
    with Reader(folder) as reader:
        for connection, at_ns, data in reader.messages():
            if connection.topic == "/tf":
                moved = STORE.deserialize_cdr(data, connection.msgtype).transforms
                for i, one in enumerate(moved):
                    at = one.transform.translation
                    turn = one.transform.rotation
                    poses.setdefault(at_ns, {})[i] = (at.x, at.y, 2 * math.atan2(turn.z, turn.w))
    rows = [[poses[at_ns][i] for i in range(3)] for at_ns in sorted(poses)]
    assert len(rows) == len(read.frames)
    written = np.array(rows)
    metres = read.start.setup.metres
    assert np.allclose(written[..., :2], read.mocap[..., :2] * metres, atol=1e-12)
    turned = written[..., 2] - read.mocap[..., 2]
    assert np.allclose(np.remainder(turned + np.pi, 2 * np.pi) - np.pi, 0, atol=1e-9)


@pytest.mark.slow
def test_another_reader_and_decoder_read_the_commands_of_a_recorded_trial(trial):
    """The plain library of MCAP, and Cyclone DDS."""
    read, folder = trial
    directions = []
    twists = []
    (file,) = folder.glob("*.mcap")
    with file.open("rb") as stream:
        for schema, channel, packed in make_reader(stream).iter_messages():
            if channel.topic == "/direction":
                assert schema.name == "geometry_msgs/msg/Vector3Stamped"
                vector = m.Vector3Stamped.deserialize(packed.data).vector
                directions.append((vector.x, vector.y))
            if channel.topic == f"/{read.start.setup.names[0]}/cmd_vel":
                twists.append(m.TwistStamped.deserialize(packed.data).twist)
    setup = read.start.setup
    assert len(directions) == len(read.commands) == len(twists)
    for command, (x, y), sent in zip(read.commands, directions, twists, strict=True):
        u = command.direction
        expected = (0.0, 0.0) if u is None else (math.cos(u), math.sin(u))
        assert np.allclose((x, y), expected)
        left, right = command.left[0] * setup.metres, command.right[0] * setup.metres
        radius = setup.wheel_radius * setup.metres
        assert math.isclose(sent.linear.x, (left + right) / 2, abs_tol=1e-12)
        assert math.isclose(sent.angular.z, (right - left) / (2 * radius), abs_tol=1e-9)


@pytest.mark.slow
def test_a_recording_is_not_overwritten(trial, tmp_path):
    (tmp_path / "bag").mkdir()
    read, _ = trial
    done = tetractl(tmp_path, "export-rosbag", read.log, "-o", "bag")
    assert done.returncode == 2 and "exists already" in done.stderr


@pytest.mark.parametrize(
    ("name", "part"), [("green", "green"), ("robot 1", "robot_1"), ("3pi", "robot_0_3pi")]
)
def test_robots_have_valid_topics(name, part):
    assert topic_part(name, 0) == part
