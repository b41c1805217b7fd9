"""Converts a trial's log to a rosbag2 recording, for `ros2 bag play`, RViz and other viewers.

    /tf              tf2_msgs/TFMessage            the measured pose of each tracked robot, as a
                                                   child frame of `world`
    /ROBOT/cmd_vel   geometry_msgs/TwistStamped    the command to each robot on wheels
    /direction       geometry_msgs/Vector3Stamped  the common direction as a vector of length 1,
                                                   or of length 0 for a stop
    /ROBOT/plan      nav_msgs/Path                 where the controller expects the robot to drive
    /targets         geometry_msgs/PoseArray       the targets, once at the start

Positions are in m. The stamp in a header is the time of exposure or sending. The time of recording
is the time at which a message reached or left the computer.
"""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.errors import LogError, UsageError, printable
from tetractl.log.read.trial_log import TrialLog
from tetractl_ros2.bag_tables import INSTALL_HINT, NEEDS_ROSBAGS

WORLD_FRAME = "world"
BAG_VERSION = 9
"""The version of the recording's metadata, which ROS 2 Iron and later write."""

BagEntry = tuple[int, str, str, Any]
"""A recorded message: time of recording [ns since 1970], topic, name of the type, and message."""


def write_bag(trial: TrialLog, folder: Path) -> int:
    """Write the recording of a trial.

    Args:
        trial: The trial.
        folder: The folder to create, with metadata.yaml and one MCAP file.

    Returns:
        The number of messages.

    Raises:
        UsageError: If rosbags is not installed, or the folder exists.
        LogError: If the folder cannot be written.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise UsageError(NEEDS_ROSBAGS, INSTALL_HINT) from None
    if folder.exists():
        raise UsageError(
            f"{printable(str(folder))}: exists already", "choose another name with --out"
        )
    if not folder.parent.is_dir():
        raise UsageError(
            f"{printable(str(folder))}: the parent folder {folder.parent} does not exist"
        )
    store = get_typestore(Stores.ROS2_HUMBLE)
    entries = sorted(BagMessages(trial, store).entries(), key=lambda entry: entry[0])
    try:
        with Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            connections: dict[str, Any] = {}
            for recorded_ns, topic, kind, message in entries:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                data = store.serialize_cdr(message, kind)
                writer.write(connections[topic], recorded_ns, data)
    except OSError as error:
        reason = error.strerror or str(error)
        raise LogError(f"{printable(str(folder))}: cannot be written: {reason}") from error
    return len(entries)


def topic_part(name: str, index: int) -> str:
    """Convert a robot's name to a part of a topic's name.

    Characters other than ASCII letters, digits and underscores become underscores. If the
    first one is not a letter, "robot_" and the robot's index are put before the name.
    """
    part = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return part if re.match(r"[A-Za-z]", part) else f"robot_{index}_{part}"


class BagMessages:
    """Creates the ROS 2 messages of a trial.

    Args:
        trial: The trial.
        store: The type store of rosbags that contains the message types.
    """

    def __init__(self, trial: TrialLog, store: Any) -> None:
        self._trial = trial
        self._types = store.types
        setup = trial.start.setup
        self._metres = setup.metres
        self._radius_m = None if setup.wheel_radius is None else setup.wheel_radius * setup.metres
        parts = [topic_part(name, i) for i, name in enumerate(setup.names)]
        are_distinct = len(set(parts)) == len(parts)
        self._topic_parts = (
            parts if are_distinct else [f"{part}_{i}" for i, part in enumerate(parts)]
        )

    def entries(self) -> Iterator[BagEntry]:
        """Yield all messages: targets, transforms, commands, then plans.

        They are not sorted by time.
        """
        yield self._targets_entry()
        yield from self._transform_entries()
        for command in self._trial.commands:
            yield from self._command_entries(command)
        yield from self._plan_entries()

    def _unix_ns(self, trial_ns: int) -> int:
        return self._trial.start.start_unix_ns + int(trial_ns)

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._types[kind](**fields)

    def _make_header(self, trial_ns: int, frame: str = WORLD_FRAME) -> Any:
        sec, nanosec = divmod(self._unix_ns(trial_ns), SECOND)
        stamp = self._make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _make_vector(self, x: float, y: float, z: float) -> Any:
        return self._make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def _make_quaternion(self, heading: float) -> Any:
        half_turn = float(heading) / 2
        kind = "geometry_msgs/msg/Quaternion"
        return self._make(kind, x=0.0, y=0.0, z=math.sin(half_turn), w=math.cos(half_turn))

    def _make_pose(self, x: float, y: float, heading: float) -> Any:
        coordinates_m = {"x": float(x) * self._metres, "y": float(y) * self._metres, "z": 0.0}
        point = self._make("geometry_msgs/msg/Point", **coordinates_m)
        orientation = self._make_quaternion(heading)
        return self._make("geometry_msgs/msg/Pose", position=point, orientation=orientation)

    def _targets_entry(self) -> BagEntry:
        targets = self._trial.start.setup.targets
        poses = [self._make_pose(x, y, 0.0) for x, y in targets]
        header = self._make_header(0)
        array = self._make("geometry_msgs/msg/PoseArray", header=header, poses=poses)
        return self._unix_ns(0), "/targets", "geometry_msgs/msg/PoseArray", array

    def _transform_entries(self) -> Iterator[BagEntry]:
        trial = self._trial
        kind = "tf2_msgs/msg/TFMessage"
        for row, received_ns in enumerate(trial.received_ns):
            transforms = [
                self._make_transform(part, trial.exposed_ns[row, i], trial.mocap[row, i])
                for i, part in enumerate(self._topic_parts)
                if trial.valid[row, i]
            ]
            if transforms:
                message = self._make(kind, transforms=transforms)
                yield self._unix_ns(received_ns), "/tf", kind, message

    def _make_transform(self, child: str, exposed_ns: int, pose: Any) -> Any:
        x, y, heading = pose
        translation = self._make_vector(x * self._metres, y * self._metres, 0.0)
        rotation = self._make_quaternion(heading)
        kind = "geometry_msgs/msg/Transform"
        transform = self._make(kind, translation=translation, rotation=rotation)
        return self._make(
            "geometry_msgs/msg/TransformStamped",
            header=self._make_header(exposed_ns),
            child_frame_id=child,
            transform=transform,
        )

    def _command_entries(self, command: Command) -> Iterator[BagEntry]:
        at_ns = self._unix_ns(command.sent_ns)
        header = self._make_header(command.sent_ns)
        direction = command.direction
        direction_xy = (
            (0.0, 0.0) if direction is None else (math.cos(direction), math.sin(direction))
        )
        kind = "geometry_msgs/msg/Vector3Stamped"
        vector = self._make_vector(*direction_xy, 0.0)
        yield at_ns, "/direction", kind, self._make(kind, header=header, vector=vector)
        if command.left is None or command.right is None or self._radius_m is None:
            return
        kind = "geometry_msgs/msg/TwistStamped"
        for part, left, right in zip(self._topic_parts, command.left, command.right, strict=True):
            speed_m_s = (left + right) / 2 * self._metres
            turning_rad_s = (right - left) * self._metres / (2 * self._radius_m)
            linear = self._make_vector(speed_m_s, 0.0, 0.0)
            angular = self._make_vector(0.0, 0.0, turning_rad_s)
            twist = self._make("geometry_msgs/msg/Twist", linear=linear, angular=angular)
            robot_header = self._make_header(command.sent_ns, part)
            yield (
                at_ns,
                f"/{part}/cmd_vel",
                kind,
                self._make(kind, header=robot_header, twist=twist),
            )

    def _plan_entries(self) -> Iterator[BagEntry]:
        kind = "nav_msgs/msg/Path"
        stamped = "geometry_msgs/msg/PoseStamped"
        for step in self._trial.steps:
            at_ns = step.command.sent_ns
            header = self._make_header(at_ns)
            for i, part in enumerate(self._topic_parts):
                poses = [
                    self._make(stamped, header=header, pose=self._make_pose(x, y, heading))
                    for x, y, heading in step.plan.path[:, i]
                    if math.isfinite(x) and math.isfinite(y)
                ]
                path = self._make(kind, header=header, poses=poses)
                yield self._unix_ns(at_ns), f"/{part}/plan", kind, path
