"""Reads the bodies in a ROS 2 message with poses: their poses, coordinate frames and times."""

from dataclasses import dataclass
from typing import Any

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack.natnet import RigidBody


@dataclass(frozen=True, slots=True)
class BodySighting:
    """The pose of one body in a ROS 2 message.

    Attributes:
        body: Name of the body in the message. None if the topic says which body it is.
        frame: The coordinate frame.
        stamp_ns: Time of the pose, on the sender's clock [ns]. 0 if the message states none.
        rigid: Position [m] and orientation of the body.
    """

    body: str | None
    frame: str
    stamp_ns: int
    rigid: RigidBody


def read_sightings(kind: str, message: Any) -> list[BodySighting]:
    """Read the bodies in a ROS 2 message with poses, in the order of the message.

    Args:
        kind: The message's type in ROS 2, without its package, such as PoseStamped.
        message: The message. Its class can come from any library that names the fields as ROS 2
            does.

    Raises:
        TypeError: If messages of this kind contain no poses.
    """
    match kind:
        case "PoseStamped":
            return [_read_sighting(None, message.header, message.pose)]
        case "Odometry" | "PoseWithCovarianceStamped":
            return [_read_sighting(None, message.header, message.pose.pose)]
        case "NamedPoseArray":
            return [
                _read_sighting(named.name, message.header, named.pose) for named in message.poses
            ]
        case "TFMessage":
            return [_read_transform(stamped) for stamped in message.transforms]
        case _:
            raise TypeError(f"messages of type {kind} contain no poses")


def stamp_ns(header: Any) -> int:
    """Read the time stamp in the header of a ROS 2 message [ns], which is 0 if it is not set."""
    return header.stamp.sec * SECOND + header.stamp.nanosec


def without_slash(frame: str) -> str:
    """Remove the leading slash that old programs put before the name of a frame, if it has one."""
    return frame.removeprefix("/")


def _read_sighting(body: str | None, header: Any, pose: Any) -> BodySighting:
    position = pose.position
    orientation = pose.orientation
    return BodySighting(
        body,
        without_slash(header.frame_id),
        stamp_ns(header),
        _make_rigid_body(position, orientation),
    )


def _read_transform(stamped: Any) -> BodySighting:
    rigid = _make_rigid_body(stamped.transform.translation, stamped.transform.rotation)
    header = stamped.header
    return BodySighting(
        without_slash(stamped.child_frame_id),
        without_slash(header.frame_id),
        stamp_ns(header),
        rigid,
    )


def _make_rigid_body(position: Any, orientation: Any) -> RigidBody:
    return RigidBody(
        0,
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w),
        True,
    )
