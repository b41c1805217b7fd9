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
from tetractl_ros2.body_readings import read_sightings, stamp_ns

POSE_KINDS = {
    "geometry_msgs/msg/PoseStamped": "PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry": "Odometry",
    "tf2_msgs/msg/TFMessage": "TFMessage",
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": "NamedPoseArray",
}
"""The messages with poses that can be read, each with the name that `read_sightings` uses."""
COMMAND_KINDS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""The messages with commands that can be read."""
MOTION_CAPTURE = "motion_capture_tracking_interfaces/msg"
NAMED_POSE = "string name\ngeometry_msgs/Pose pose\n"
NAMED_POSE_ARRAY = "std_msgs/Header header\nNamedPose[] poses\n"
"""Definitions of motion_capture_tracking's messages."""
STATIC_TRANSFORMS_TOPIC = "/tf_static"
"""The topic of frames that never move, which no robot is."""
NEEDS_ROSBAGS = "reading and writing rosbag2 needs rosbags, which is not installed"
INSTALL_HINT = "pip install './packages/tetractl-ros2[bags]'"


@dataclass(frozen=True, slots=True)
class BagPose:
    """A pose in a recording.

    Attributes:
        topic: The topic with the pose.
        robot: Name of the robot.
        frame: The coordinate frame of the pose.
        time_ns: Time stamp in the pose's header [ns]. Without a stamp, the time of recording.
        x: Position x in the frame [m].
        y: Position y in the frame [m].
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
        robot: Name of the robot. Empty if the topic's name contains no robot.
        time_ns: Time stamp in the twist's header [ns]. Without a stamp, the time of recording.
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
    """The contents of a recording, in the order of recording.

    Attributes:
        poses: The poses of all robots.
        commands: The commands to all robots.
    """

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
        raise UsageError(NEEDS_ROSBAGS, INSTALL_HINT) from None
    if not path.exists():
        raise UsageError(f"{printable(str(path))}: there is no such file or folder")
    poses: list[BagPose] = []
    commands: list[BagCommand] = []
    store = _message_store()
    try:
        with Reader(path) as reader:
            readable = [
                connection
                for connection in reader.connections
                if connection.msgtype in (*POSE_KINDS, *COMMAND_KINDS)
            ]
            moving = [entry for entry in readable if entry.topic != STATIC_TRANSFORMS_TOPIC]
            for connection, time_ns, data in reader.messages(moving) if moving else ():
                message = store.deserialize_cdr(data, connection.msgtype)
                if connection.msgtype in COMMAND_KINDS:
                    commands.append(_command(connection.topic, time_ns, message))
                else:
                    poses.extend(_poses(connection.topic, time_ns, message, connection.msgtype))
    except ReaderError as error:
        raise LogError(f"{printable(str(path))}: {printable(str(error))}") from None
    except Exception as error:  # of a library that reads a damaged file, of which nothing is known
        reason = printable(str(error) or type(error).__name__)
        raise LogError(f"{printable(str(path))}: cannot be read: {reason}") from error
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
    for sighting in read_sightings(POSE_KINDS[kind], message):
        planar = planar_pose(sighting.rigid, UpAxis.Z)
        if planar is not None:
            robot = _first_part(topic if sighting.body is None else sighting.body)
            at_ns = sighting.stamp_ns or time_ns
            yield BagPose(topic, robot, sighting.frame, at_ns, planar.x, planar.y, planar.heading)


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
    poses = [
        pose
        for pose in contents.poses
        if topic in (None, pose.topic) and frame in (None, pose.frame)
    ]
    if not poses:
        listed = (
            ", ".join(sorted({f"{pose.topic} in {pose.frame}" for pose in contents.poses}))
            or "none"
        )
        raise UsageError("no such poses", f"the recording has {printable(listed)}")
    _refuse_several("frame", {pose.frame for pose in poses}, "--frame")
    for robot in sorted({pose.robot for pose in poses}):
        _refuse_several("topic", {pose.topic for pose in poses if pose.robot == robot}, "--topic")
    poses = _sort_poses(poses)
    begin_ns = begin_ns_of(contents)
    return Table(
        "poses",
        (
            Column("time_s", [(pose.time_ns - begin_ns) / SECOND for pose in poses]),
            Column("robot", [pose.robot for pose in poses]),
            Column("x_m", [pose.x for pose in poses]),
            Column("y_m", [pose.y for pose in poses]),
            Column("heading_rad", [pose.heading for pose in poses]),
        ),
    )


def command_table(contents: BagContents) -> Table:
    """Create the table of commands: time, robot, speed and turning rate.

    If no topic names a robot, the column `robot` is left out.
    """
    commands = sorted(contents.commands, key=lambda command: command.time_ns)
    begin_ns = begin_ns_of(contents)
    columns = [
        Column("time_s", [(command.time_ns - begin_ns) / SECOND for command in commands]),
        Column("v_m_s", [command.v for command in commands]),
        Column("w_rad_s", [command.w for command in commands]),
    ]
    if any(command.robot for command in commands):
        columns.insert(1, Column("robot", [command.robot for command in commands]))
    return Table("commands", tuple(columns))


def begin_ns_of(contents: BagContents) -> int:
    """Find the earliest time of any pose or command in a recording [ns].

    The times in the recording's tables count from this time. The recording must not be empty.
    """
    return min(item.time_ns for item in (*contents.poses, *contents.commands))


def _sort_poses(poses: Sequence[BagPose]) -> list[BagPose]:
    """Sort poses by time. If a robot has several poses at one time, only the first is kept."""
    seen = set[tuple[str, int]]()
    ordered: list[BagPose] = []
    for pose in sorted(poses, key=lambda pose: pose.time_ns):
        key = (pose.robot, pose.time_ns)
        if key not in seen:
            seen.add(key)
            ordered.append(pose)
    return ordered


def _refuse_several(quantity: str, names: set[str], name_option: str) -> None:
    if len(names) > 1:
        listed = printable(", ".join(sorted(names)))
        raise UsageError(
            f"the recording has poses of a robot in more than one {quantity}: {listed}",
            f"add {name_option}",
        )
