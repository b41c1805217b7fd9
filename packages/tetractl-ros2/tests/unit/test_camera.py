"""Tests of the ROS 2 camera: decoding messages, and reporting frames, time stamps and bodies."""

import math

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from testkit.lab_specs import SPEC
from tetractl_emulator.emulated_lab import EmulatedLab
from tetractl_emulator.script import NO_FAULTS
from tetractl_emulator.sides import Options
from tetractl_emulator.virtual_lab import LabClock, start_emulated_lab
from tetractl_ros2.camera import Ros2Camera
from tetractl_ros2.ros2_messages import (
    Bool,
    Header,
    NamedPose,
    NamedPoseArray,
    Point,
    PoseMessage,
    PoseStamped,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
)
from tetractl_ros2.topic_port import UNDECODABLE
from tetractl_ros2.topics import EMULATED_TOPIC

from tetractl.core.clock import MILLISECOND, SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.spec.load import parse_spec

KINDS = ("TFMessage", "NamedPoseArray", "PoseStamped", "Odometry")
CAMERA = """
  camera:
    type: ros2
    message: {message}
    frame: world
    origin: [120, -40]
    rotation: 0.7
    robots:
      - {{name: green, body: G, heading_offset: 0.3}}
      - {{name: blue, body: B}}
"""


def lab_of(message):
    head, rest = SPEC.split("  camera:\n")
    actuator = rest[rest.index("  actuator:") :]
    text = head + CAMERA.format(message=message).lstrip("\n") + actuator
    experiment = parse_spec(text, "graph.yaml").experiment
    return experiment.lab, experiment.setup


@pytest.mark.parametrize("message", KINDS)
def test_poses_are_those_of_the_emulated_robots_whatever_message_holds_them(message):
    lab, setup = lab_of(message)
    clock = LabClock()
    emulation = start_emulated_lab(lab, setup, clock, Options(address=None), NO_FAULTS)
    with Ros2Camera(lab.camera, setup, clock, ports=emulation.wires.ports) as camera:
        clock.sleep_until(clock.now() + SECOND // 10)
        frame = camera.frames()[-1]
        assert camera.check().emulated and not camera.check().problems
        starts = zip(setup.starts.x, setup.starts.y, setup.starts.heading, strict=True)
        for pose, (x, y, heading) in zip(frame.poses, starts, strict=True):
            assert math.isclose(pose.x, x, abs_tol=1e-6)
            assert math.isclose(pose.y, y, abs_tol=1e-6)
            assert math.isclose(math.remainder(pose.heading - heading, math.tau), 0, abs_tol=1e-9)
            assert math.isclose(pose.tilt, 0, abs_tol=1e-6)
        assert 9 * MILLISECOND < frame.received_ns - frame.sampled_ns < 12 * MILLISECOND


@pytest.mark.parametrize("topic", ["null", "/seen/{body}"])
@pytest.mark.parametrize("message", KINDS)
def test_a_lab_of_any_kind_of_poses_can_be_emulated_on_real_topics(message, topic):
    """Regression: kinds with a topic for each robot ended in a KeyError."""
    lab, setup = lab_of(f"{message}\n    topic: {topic}")
    emulation = EmulatedLab(lab, setup, NO_FAULTS, Options())
    assert {port.name for port in emulation.camera._ports} == {
        f"ros2://0{name}" for name in lab.camera.topics(setup)
    }


class Graph:
    """Topics whose publishers a test plays."""

    def __init__(self, first):
        self.heard = {}
        self.first = first

    def make(self, name, baud, device, clock, heard, hint):
        self.heard[name.removeprefix("ros2://0")] = heard
        graph = self

        class Port:
            failure = None

            def open(self):
                graph.first(name.removeprefix("ros2://0"))

            def close(self):
                pass

        return Port()

    def send(self, topic, message, at_ns):
        self.heard[topic](message.serialize(), at_ns)


def header(stamp_ns, frame="world"):
    return Header(Time(*divmod(stamp_ns, SECOND)), frame)


def pose(x, quaternion=None):
    return PoseMessage(Point(x, 0.0, 0.0), quaternion or Quaternion())


def stamped(stamp_ns, x=0.0, frame="world", quaternion=None):
    return PoseStamped(header(stamp_ns, frame), pose(x, quaternion))


def camera_of(message, sent, **options):
    """An opened camera that has received these: (topic, message, time of arrival)."""
    lab, setup = lab_of(message)
    graph = Graph(lambda topic: None)
    camera = Ros2Camera(lab.camera, setup, VirtualClock(), ports=graph.make, **options)
    for topic, sample, at_ns in sent:
        graph.send(topic, sample, at_ns)
    camera.__enter__()
    return camera, graph


def both(at_ns, stamp_ns, **more):
    return [(topic, stamped(stamp_ns, **more), at_ns) for topic in ("/G/pose", "/B/pose")]


def test_a_pose_in_another_frame_is_not_used_and_named():
    sent = [
        ("/G/pose", stamped(SECOND), SECOND),
        ("/B/pose", stamped(SECOND, frame="odom"), SECOND),
    ]
    camera, _ = camera_of("PoseStamped", sent)
    assert camera.check().problems == ("blue's poses are in the frame odom, not world",)
    assert camera.frames()[-1].poses[1] is None


def test_if_all_poses_are_in_another_frame_the_error_names_all_robots_and_the_field():
    with pytest.raises(AbortError) as error:
        camera_of("PoseStamped", both(SECOND, SECOND, frame="odom"))
    assert "green's poses are in the frame odom, not world" in str(error.value)
    assert "blue's poses are in the frame odom, not world" in str(error.value)
    assert error.value.hint == "is `frame` of the camera right?"


def test_a_slash_before_a_frame_is_the_same_frame():
    camera, _ = camera_of("PoseStamped", both(SECOND, SECOND, frame="/world"))
    assert not camera.check().problems


def test_without_any_pose_the_topic_is_named():
    with pytest.raises(AbortError, match="green has no pose, because no message came on /G/pose"):
        camera_of("PoseStamped", [])


def test_bodies_that_are_streamed_are_listed_if_one_is_missing():
    array = NamedPoseArray(header(SECOND), [NamedPose("G", pose(1.0)), NamedPose("X", pose(2.0))])
    camera, _ = camera_of("NamedPoseArray", [("/poses", array, SECOND)])
    assert camera.check().problems == ("there is no body B for blue on /poses; bodies there: G, X",)


def test_long_names_of_bodies_are_cut_and_many_are_counted():
    names = ["G", *(f"{number}\x1b" * 300 for number in range(500))]
    array = NamedPoseArray(header(SECOND), [NamedPose(name, pose(1.0)) for name in names])
    camera, _ = camera_of("NamedPoseArray", [("/poses", array, SECOND)])
    (problem,) = camera.check().problems
    assert problem.isprintable() and len(problem) < 2000 and problem.endswith("and 481 more")


def test_a_late_message_is_as_old_as_its_stamp_says():
    """The sender's clock is years off; the quickest message took `latency`, 10 ms."""
    sent = [*both(2 * SECOND, 50 * SECOND), *both(2 * SECOND + 60 * MILLISECOND, 50 * SECOND + 1)]
    camera, _ = camera_of("PoseStamped", sent)
    first, *_, late = camera.frames()
    assert first.received_ns - first.sampled_ns == 10 * MILLISECOND
    assert late.received_ns - late.sampled_ns == 70 * MILLISECOND - 1


def array(stamp_ns):
    return NamedPoseArray(header(stamp_ns), [NamedPose(name, pose(1.0)) for name in "GB"])


def tree(stamp_ns):
    return TFMessage([TransformStamped(header(stamp_ns), name, Transform()) for name in "GB"])


@pytest.mark.parametrize(
    ("kind", "topic", "make"), [("NamedPoseArray", "/poses", array), ("TFMessage", "/tf", tree)]
)
def test_late_messages_stay_old_however_many_bodies_each_shows(kind, topic, make):
    """Of 600 messages that are compared, the first came quickly and the others 60 ms late."""
    late_ns = 60 * MILLISECOND
    sent = [(topic, make(50 * SECOND), 2 * SECOND)]
    sent += [
        (topic, make(50 * SECOND + step), 2 * SECOND + step + late_ns)
        for step in range(10 * MILLISECOND, 4010 * MILLISECOND, 10 * MILLISECOND)
    ]
    camera, _ = camera_of(kind, sent)
    frames = camera.frames()
    assert len(sent) == 401 and len(frames) == 401
    assert all(o.received_ns - o.sampled_ns == 70 * MILLISECOND for o in frames[1:])


def warnings(age_ns):
    """What is said of a stamp of this age, by this computer's clock."""
    unix_ns = 1_000 * SECOND
    sent = both(SECOND, unix_ns - age_ns)
    camera, _ = camera_of("PoseStamped", sent, unix_ns=lambda: unix_ns + 4 * SECOND)
    camera._clock.sleep_until(5 * SECOND)
    return camera.check().warnings


def test_the_age_of_stamps_is_compared_with_latency_if_clocks_agree():
    assert warnings(12 * MILLISECOND) == ()
    (wrong,) = warnings(80 * MILLISECOND)
    assert wrong.startswith("time stamps are 0.080 s old on arrival, but `latency` says 0.01 s")


@pytest.mark.parametrize("age_ns", [3 * SECOND, -2 * SECOND])
def test_clocks_that_differ_are_reported(age_ns):
    (text,) = warnings(age_ns)
    assert "the sender's clock differs from this computer's" in text
    assert text.startswith(f"time stamps are {age_ns / SECOND:.3f} s old")


def test_poses_without_stamps_are_reported():
    camera, _ = camera_of("PoseStamped", both(SECOND, 0))
    (text,) = camera.check().warnings
    assert text.startswith(
        "the poses have no time stamp: each is taken as 0.01 s old when it arrives"
    )


def test_a_tilted_body_has_its_tilt_and_a_quaternion_that_is_none_is_no_pose():
    half = math.sqrt(0.5)
    tilted = Quaternion(half, 0.0, 0.0, half)  # a quarter turn about x
    sent = [
        ("/G/pose", stamped(SECOND, quaternion=tilted), SECOND),
        ("/B/pose", stamped(SECOND, quaternion=Quaternion(0.0, 0.0, 0.0, 0.0)), SECOND),
    ]
    camera, _ = camera_of("PoseStamped", sent)
    first, second = camera._frame_group.last
    assert math.isclose(first.pose.tilt, math.pi / 2, abs_tol=1e-6)
    assert second.pose is None


def test_a_body_that_a_message_of_all_bodies_lacks_is_untracked_at_once():
    sent = [
        ("/poses", NamedPoseArray(header(stamp), [NamedPose(n, pose(1.0)) for n in names]), stamp)
        for stamp, names in ((SECOND, "GB"), (2 * SECOND, "G"))
    ]
    camera, _ = camera_of("NamedPoseArray", sent)
    whole, half = camera.frames()
    assert None not in whole.poses
    assert half.poses[0] is not None and half.poses[1] is None


def test_a_message_that_cannot_be_read_is_counted():
    camera, graph = camera_of("PoseStamped", both(SECOND, SECOND))
    graph.heard["/G/pose"](b"\x00\x01\x00\x00abc", 2 * SECOND)
    graph.heard["/B/pose"](UNDECODABLE, 2 * SECOND)
    assert camera.damaged == 2


def test_only_a_message_that_says_so_makes_a_tracker_an_emulated_one():
    camera, graph = camera_of("PoseStamped", both(SECOND, SECOND))
    for data in (UNDECODABLE, b"", Bool(data=False).serialize()):
        graph.heard[EMULATED_TOPIC](data, 2 * SECOND)
    assert not camera.check().emulated
    graph.heard[EMULATED_TOPIC](Bool(data=True).serialize(), 2 * SECOND)
    assert camera.check().emulated


def test_a_topic_that_fails_stops_the_robots():
    camera, graph = camera_of("PoseStamped", both(SECOND, SECOND))
    graph.heard["/G/pose"](b"", 2 * SECOND)
    fault = camera.frames()[-1]
    assert fault.fault and fault.poses == (None, None)
