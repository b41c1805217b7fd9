"""Converts a rosbag2 recording to the two tables that `tetractl identify` reads.

ROS 2 fixes the units and axes (m, rad, s, z up), so only the names of robots must be found. The
name of a robot is the part of the topic or frame before the first slash. For example,
`/green/cmd_vel` and the child frame `green/base_link` both belong to `green`. Commands on a topic
without such a part, such as `/cmd_vel`, belong to no named robot.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tetractl.core.clock import SECOND
from tetractl.core.errors import LogError, UsageError, printable
from tetractl.lab.cameras.optitrack.natnet import UpAxis, planar_pose
from tetractl.tools.table.table import Column, Table
from tetractl_ros2.body_readings import sightings, stamp_ns

POSES = {
    "geometry_msgs/msg/PoseStamped": "PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry": "Odometry",
    "tf2_msgs/msg/TFMessage": "TFMessage",
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": "NamedPoseArray",
}
"""The kinds of messages with poses."""
COMMANDS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""The kinds of messages with commands."""
MOTION_CAPTURE = "motion_capture_tracking_interfaces/msg"
NAMED_POSE = "string name\ngeometry_msgs/Pose pose\n"
NAMED_POSE_ARRAY = "std_msgs/Header header\nNamedPose[] poses\n"
"""Definitions of motion_capture_tracking's messages."""
STATIC = "/tf_static"
"""The topic of frames that never move, which no robot is."""
NEEDS_ROSBAGS = "reading and writing rosbag2 needs rosbags, which is not installed"
INSTALL = "pip install './packages/tetractl-ros2[bags]'"


@dataclass(frozen=True, slots=True)
class BagPose:
    """A pose in a recording.

    Attributes:
        topic: The topic with the pose.
        robot: The robot.
        frame: The coordinate frame of the pose.
        time_ns: The stamp in its header [ns]. Without a stamp, the time of recording.
        x: Position [m].
        y: Position [m].
        heading: Angle, anticlockwise from the frame's x axis [rad].
    """

    topic: str
    robot: str
    frame: str
    time_ns: int
    x: float
    y: float
    heading: float


@dataclass(frozen=True, slots=True)
class BagCommand:
    """A twist in a recording.

    Attributes:
        topic: The topic with the twist.
        robot: The robot. Empty if the topic's name has no such part.
        time_ns: The stamp in its header [ns]. Without a stamp, the time of recording.
        v: Speed [m/s].
        w: Turning rate [rad/s].
    """

    topic: str
    robot: str
    time_ns: int
    v: float
    w: float


@dataclass(frozen=True, slots=True)
class BagContents:
    """The poses and commands of a recording, in the order of recording."""

    poses: tuple[BagPose, ...]
    commands: tuple[BagCommand, ...]


def read_bag(path: Path) -> BagContents:
    """Read the poses and commands of a recording.

    Args:
        path: A folder with metadata.yaml, or a single .mcap or .db3 file.

    Raises:
        UsageError: If rosbags is not installed, or there is no such recording.
        LogError: If the recording cannot be read.
    """
    try:
        from rosbags.rosbag2 import Reader, ReaderError
    except ImportError:
        raise UsageError(NEEDS_ROSBAGS, INSTALL) from None
    if not path.exists():
        raise UsageError(f"{printable(str(path))}: there is no such file or folder")
    poses: list[BagPose] = []
    commands: list[BagCommand] = []
    store = _message_store()
    try:
        with Reader(path) as reader:
            wanted = [o for o in reader.connections if o.msgtype in (*POSES, *COMMANDS)]
            moving = [o for o in wanted if o.topic != STATIC]
            for connection, time_ns, data in reader.messages(moving) if moving else ():
                message = store.deserialize_cdr(data, connection.msgtype)
                if connection.msgtype in COMMANDS:
                    commands.append(_command(connection.topic, time_ns, message))
                else:
                    poses.extend(_poses(connection.topic, time_ns, message, connection.msgtype))
    except ReaderError as error:
        raise LogError(f"{printable(str(path))}: {printable(str(error))}") from None
    except Exception as error:  # of a library that reads a damaged file, of which nothing is known
        why = printable(str(error) or type(error).__name__)
        raise LogError(f"{printable(str(path))}: cannot be read: {why}") from error
    return BagContents(tuple(poses), tuple(commands))


def _message_store() -> Any:
    """Return the definitions of all messages that can be read.

    The definitions inside a recording are not used. They are the same, and MCAP files also contain
    definitions that rosbags does not understand, for example of services.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(NAMED_POSE, f"{MOTION_CAPTURE}/NamedPose"))
    store.register(get_types_from_msg(NAMED_POSE_ARRAY, f"{MOTION_CAPTURE}/NamedPoseArray"))
    return store


def _command(topic: str, time_ns: int, message: Any) -> BagCommand:
    header = getattr(message, "header", None)
    twist = message if header is None else message.twist
    at_ns = time_ns if header is None else stamp_ns(header) or time_ns
    robot = _first_part(topic) if topic.count("/") > 1 else ""
    return BagCommand(topic, robot, at_ns, twist.linear.x, twist.angular.z)


def _poses(topic: str, time_ns: int, message: Any, kind: str) -> Iterator[BagPose]:
    """Yield the poses in a message that are finite and have a valid rotation.

    A pose without a time stamp gets the time at which the message was recorded, `time_ns`.
    """
    for seen in sightings(POSES[kind], message):
        planar = planar_pose(seen.rigid, UpAxis.Z)
        if planar is not None:
            robot = _first_part(topic if seen.body is None else seen.body)
            at_ns = seen.stamp_ns or time_ns
            yield BagPose(topic, robot, seen.frame, at_ns, planar.x, planar.y, planar.heading)


def _first_part(name: str) -> str:
    return name.strip("/").partition("/")[0]


def pose_table(contents: BagContents, topic: str | None, frame: str | None) -> Table:
    """Create the table of poses: time, robot, x, y, heading.

    Args:
        contents: The contents of the recording.
        topic: The topic to read poses from. None if each robot has poses on only one topic.
        frame: The coordinate frame of the poses. None if all poses have the same frame.

    Raises:
        UsageError: If `topic` or `frame` is needed to choose the poses.
    """
    poses = [o for o in contents.poses if topic in (None, o.topic) and frame in (None, o.frame)]
    if not poses:
        listed = ", ".join(sorted({f"{o.topic} in {o.frame}" for o in contents.poses})) or "none"
        raise UsageError("no such poses", f"the recording has {printable(listed)}")
    _refuse_several("frame", {o.frame for o in poses}, "--frame")
    for robot in sorted({o.robot for o in poses}):
        _refuse_several("topic", {o.topic for o in poses if o.robot == robot}, "--topic")
    poses = _in_order(poses)
    begin_ns = begin(contents)
    return Table(
        "poses",
        (
            Column("time_s", [(o.time_ns - begin_ns) / SECOND for o in poses]),
            Column("robot", [o.robot for o in poses]),
            Column("x_m", [o.x for o in poses]),
            Column("y_m", [o.y for o in poses]),
            Column("heading_rad", [o.heading for o in poses]),
        ),
    )


def command_table(contents: BagContents) -> Table:
    """Create the table of commands: time, robot, speed and turning rate.

    If no topic names a robot, the column `robot` is left out.
    """
    commands = sorted(contents.commands, key=lambda command: command.time_ns)
    begin_ns = begin(contents)
    columns = [
        Column("time_s", [(o.time_ns - begin_ns) / SECOND for o in commands]),
        Column("v_m_s", [o.v for o in commands]),
        Column("w_rad_s", [o.w for o in commands]),
    ]
    if any(o.robot for o in commands):
        columns.insert(1, Column("robot", [o.robot for o in commands]))
    return Table("commands", tuple(columns))


def begin(contents: BagContents) -> int:
    """Return the earliest time of any pose or command of a recording [ns].

    The times in its tables count from it. The recording must not be empty.
    """
    return min(o.time_ns for o in (*contents.poses, *contents.commands))


def _in_order(poses: Sequence[BagPose]) -> list[BagPose]:
    """Sort poses by time. If a robot has several poses at one time, only the first is kept."""
    seen = set[tuple[str, int]]()
    ordered: list[BagPose] = []
    for pose in sorted(poses, key=lambda o: o.time_ns):
        key = (pose.robot, pose.time_ns)
        if key not in seen:
            seen.add(key)
            ordered.append(pose)
    return ordered


def _refuse_several(what: str, names: set[str], name_option: str) -> None:
    if len(names) > 1:
        listed = printable(", ".join(sorted(names)))
        raise UsageError(
            f"the recording has poses of a robot in more than one {what}: {listed}",
            f"add {name_option}",
        )
