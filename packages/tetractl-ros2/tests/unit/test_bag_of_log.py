"""Tests of recordings that are written from the logs of trials, against independent readers."""

import math

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
pytest.importorskip("rosbags", reason="recordings are read by rosbags")
from types import SimpleNamespace

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from testkit.cli import tetractl
from testkit.paths import ROOT
from tetractl_ros2 import ros2_messages as m
from tetractl_ros2.bag_of_log import BagMessages, topic_part, write_bag

import tetractl as api
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.errors import UsageError
from tetractl.log.read.reader import read_trial

STORE = get_typestore(Stores.ROS2_HUMBLE)
SECOND = 10**9


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


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("Robot", "Robot"),
        ("_a", "robot_2__a"),
        ("a-b.c", "a_b_c"),
        ("grün", "gr_n"),
        ("", "robot_2_"),
    ],
)
def test_other_characters_become_underscores_and_a_part_begins_with_a_letter(name, part):
    assert topic_part(name, 2) == part


BEGAN_NS = 1_700_000_000 * SECOND + 123
SETUP = api.load_spec(ROOT / "experiments" / "three_m3pi.yaml").experiment.setup
NAMES = SETUP.names


def made_log(setup=SETUP, commands=(), steps=(), valid=((True, False, True),)):
    """A log of a trial with a frame that was exposed at 1 s and received at 1.5 s."""
    rows = len(valid)
    mocap = np.arange(rows * 9, dtype=float).reshape(rows, 3, 3) / 10 + 100
    return SimpleNamespace(
        start=SimpleNamespace(setup=setup, start_unix_ns=BEGAN_NS),
        commands=commands,
        steps=steps,
        received_ns=[SECOND + SECOND // 2 + row for row in range(rows)],
        exposed_ns=np.full((rows, 3), SECOND),
        mocap=mocap,
        valid=np.array(valid),
    )


def entries(log, topic):
    """The messages on a topic, with when they were recorded [ns after the trial began]."""
    found = BagMessages(log, STORE).entries()
    return [(at_ns - BEGAN_NS, message) for at_ns, name, _, message in found if name == topic]


def stamp_ns(header):
    return header.stamp.sec * SECOND + header.stamp.nanosec - BEGAN_NS


def test_each_tracked_robot_of_a_frame_is_transformed_at_its_exposure():
    log = made_log()
    ((at_ns, message),) = entries(log, "/tf")
    assert at_ns == SECOND + SECOND // 2
    children = [moved.child_frame_id for moved in message.transforms]
    assert children == [NAMES[0], NAMES[2]]
    for moved, i in zip(message.transforms, (0, 2), strict=True):
        x, y, heading = log.mocap[0, i]
        at, turn = moved.transform.translation, moved.transform.rotation
        assert (at.x, at.y, at.z) == pytest.approx((x * SETUP.metres, y * SETUP.metres, 0))
        assert (turn.z, turn.w) == pytest.approx((math.sin(heading / 2), math.cos(heading / 2)))
        assert stamp_ns(moved.header) == SECOND
        assert moved.header.frame_id == "world"


def test_a_frame_without_a_robot_has_no_message():
    log = made_log(valid=((False,) * 3, (True,) * 3))
    assert [at_ns for at_ns, _ in entries(log, "/tf")] == [SECOND + SECOND // 2 + 1]


def wheels(left, right, action=None, at_ns=2 * SECOND):
    return Command(action or Steer(0.5), at_ns, (True,) * 3, left=left, right=right)


def test_wheel_speeds_become_a_speed_and_a_turning_rate():
    """v is the mean of both wheels, w their difference over the distance between them."""
    left, right = np.array([90.0, 100.0, -40.0]), np.array([150.0, 100.0, 40.0])
    log = made_log(commands=[wheels(left, right)])
    assert SETUP.wheel_radius * SETUP.metres == pytest.approx(0.04)
    expected = ((0.120, 0.060 / 0.08), (0.100, 0.0), (0.0, 0.080 / 0.08))
    for name, (v, w) in zip(NAMES, expected, strict=True):
        ((at_ns, message),) = entries(log, f"/{name}/cmd_vel")
        assert at_ns == stamp_ns(message.header) == 2 * SECOND
        assert message.header.frame_id == name
        assert message.twist.linear.x == pytest.approx(v)
        assert message.twist.angular.z == pytest.approx(w)


def test_a_direction_has_length_one_and_a_stop_length_zero():
    log = made_log(commands=[wheels(None, None), wheels(None, None, Stop(), 3 * SECOND)])
    (_, ahead), (stopped_ns, stop) = entries(log, "/direction")
    assert (ahead.vector.x, ahead.vector.y) == pytest.approx((math.cos(0.5), math.sin(0.5)))
    assert (stop.vector.x, stop.vector.y, stopped_ns) == (0.0, 0.0, 3 * SECOND)
    assert entries(log, f"/{NAMES[0]}/cmd_vel") == []


@pytest.mark.parametrize("lacking", ["left", "right", "radius"])
def test_without_both_wheels_and_their_distance_there_is_no_twist(lacking):
    speeds = {"left": np.ones(3), "right": np.ones(3)}
    setup = SETUP
    if lacking == "radius":
        setup = SimpleNamespace(metres=1.0, wheel_radius=None, names=NAMES, targets=SETUP.targets)
    else:
        speeds[lacking] = None
    log = made_log(setup, commands=[wheels(**speeds)])
    assert len(entries(log, "/direction")) == 1
    assert entries(log, f"/{NAMES[0]}/cmd_vel") == []


def test_a_plan_is_the_finite_part_of_each_robots_path():
    path = np.zeros((3, 3, 3))
    path[:, 1] = (100.0, 200.0, 0.4)
    path[1, 1, 0] = np.nan
    path[2, 1, 1] = np.inf
    step = SimpleNamespace(
        command=SimpleNamespace(sent_ns=4 * SECOND), plan=SimpleNamespace(path=path)
    )
    log = made_log(steps=[step])
    ((at_ns, message),) = entries(log, f"/{NAMES[1]}/plan")
    assert at_ns == stamp_ns(message.header) == 4 * SECOND
    (only,) = message.poses
    place = only.pose.position
    assert (place.x, place.y) == pytest.approx((100 * SETUP.metres, 200 * SETUP.metres))
    assert only.pose.orientation.w == pytest.approx(math.cos(0.2))
    assert len(entries(log, f"/{NAMES[0]}/plan")[0][1].poses) == 3


def test_the_targets_come_once_at_the_start():
    ((at_ns, message),) = entries(made_log(), "/targets")
    assert at_ns == stamp_ns(message.header) == 0
    places = [(pose.position.x, pose.position.y) for pose in message.poses]
    assert np.allclose(places, SETUP.targets * SETUP.metres)


def test_robots_whose_names_differ_only_in_other_characters_have_topics_of_their_own():
    names = ("a b", "a-b", "c")
    setup = SimpleNamespace(metres=1.0, wheel_radius=1.0, names=names, targets=SETUP.targets)
    log = made_log(setup, commands=[wheels(np.ones(3), np.ones(3))])
    for topic in ("/a_b_0/cmd_vel", "/a_b_1/cmd_vel", "/c_2/cmd_vel"):
        assert len(entries(log, topic)) == 1


def test_a_recording_is_written_only_to_a_new_folder_below_an_existing_one(tmp_path):
    with pytest.raises(UsageError, match="exists already"):
        write_bag(made_log(), tmp_path)
    with pytest.raises(UsageError, match="does not exist"):
        write_bag(made_log(), tmp_path / "none" / "bag")
    count = write_bag(made_log(commands=[wheels(np.ones(3), np.ones(3))]), tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        times_ns = [at_ns for _, at_ns, _ in reader.messages()]
    assert count == len(times_ns) == 6  # targets, a frame, a direction, a twist each
    assert times_ns == sorted(times_ns)
