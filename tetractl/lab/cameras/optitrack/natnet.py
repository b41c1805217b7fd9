"""The contents of NatNet messages from OptiTrack cameras, and the pose of a rigid body.

Positions are in metres. Quaternions have norm 1.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Self

from tetractl.core.elementary import atan2, cos, sin
from tetractl.core.poses import Pose

Vec3 = tuple[float, float, float]
NORM_TOLERANCE = 1e-3
"""Maximum deviation of a quaternion's norm from 1. Its numbers are float32."""


class Version(NamedTuple):
    """A version of the NatNet protocol. 2.10 is newer than 2.9."""

    major: int
    minor: int

    @property
    def known(self) -> bool:
        """Whether this program knows the layout of the version's messages.

        Messages of newer versions are read as 4.3.
        """
        return OLDEST <= self <= NEWEST

    @classmethod
    def parse(cls, version_text: str) -> Self:
        """Parse a version that is written as `major.minor`."""
        major, minor = version_text.split(".")
        return cls(int(major), int(minor))

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}"


OLDEST = Version(2, 6)
"""Oldest supported version. Frames of older versions do not report which bodies are tracked."""
NEWEST = Version(4, 3)
"""Newest version of the protocol whose layout is known."""


class MessageKind(IntEnum):
    """The ids of the messages in NatNet, the protocol of OptiTrack cameras."""

    CONNECT = 0
    SERVER_INFO = 1
    REQUEST = 2
    RESPONSE = 3
    REQUEST_MODELDEF = 4
    MODELDEF = 5
    REQUEST_FRAME = 6
    FRAME = 7
    TEXT = 8
    DISCONNECT = 9
    KEEPALIVE = 10
    ECHO_REQUEST = 12
    ECHO_RESPONSE = 13
    UNRECOGNIZED = 100


@dataclass(frozen=True, slots=True)
class RigidBody:
    """One tracked body in a camera frame of OptiTrack, in the server's axes.

    Attributes:
        id: Number of the body.
        position: Its position [m].
        quaternion: Its orientation, (qx, qy, qz, qw).
        tracking_valid: Whether it is tracked. An untracked body stays in the frames, with its last
            pose.
    """

    id: int
    position: Vec3
    quaternion: tuple[float, float, float, float]
    tracking_valid: bool


@dataclass(frozen=True, slots=True)
class NatNetFrame:
    """One camera frame of an OptiTrack server.

    Attributes:
        number: Number of the frame.
        bodies: The rigid bodies in the frame.
        params: Bit field: bit 1 is set if bodies have changed, bit 2 in edit mode.
        exposure: Middle of the exposure, on the server's clock [ticks]. None before NatNet 3.0.
            `ServerInfo.clock_hz` is the number of ticks per second.
    """

    number: int
    bodies: tuple[RigidBody, ...]
    params: int = 0
    exposure: int | None = 0

    @property
    def models_changed(self) -> bool:
        """Whether rigid bodies were added or removed, so that MODELDEF must be requested again."""
        return bool(self.params & 2)

    @property
    def is_edit_mode(self) -> bool:
        """Whether Motive is in edit mode, in which it streams a recording, not the robots."""
        return bool(self.params & 4)


@dataclass(frozen=True, slots=True)
class ModelDef:
    """The list of the rigid bodies that an OptiTrack server streams (message MODELDEF).

    Attributes:
        bodies: The name of each body, and its id in frames.
        complete: Whether the whole message was read. Before NatNet 4.1, reading has to end at a
            data set of unknown layout and size. The server may then stream further bodies.
    """

    bodies: tuple[tuple[str, int], ...]
    complete: bool = True

    def ids(self) -> dict[str, int]:
        """Return the ids of the rigid bodies, as {name: id}."""
        return dict(self.bodies)


@dataclass(frozen=True, slots=True)
class Connect:
    """The client's first message to an OptiTrack server, to which the server answers ServerInfo.

    Attributes:
        version: Version of the protocol that the client uses.
        pinned: Whether the server has to stream in this version. Only servers since NatNet 4.0 do,
            and only in unicast.
    """

    version: Version = NEWEST
    pinned: bool = False


@dataclass(frozen=True, slots=True)
class ServerInfo:
    """The answer of the camera's server to CONNECT, the first request of a client.

    Attributes:
        name: Name of the server.
        version: Protocol version of the server's frames, unless CONNECT pinned another.
        clock_hz: Rate of the server's clock. 0 before NatNet 3.0, which did not report it.
        data_port: Port of its frames in unicast. 0 before NatNet 3.0.
    """

    name: str
    version: Version
    clock_hz: int
    data_port: int


@dataclass(frozen=True, slots=True)
class NatNetRequest:
    """A remote command to the camera's server, such as `UpAxis` or `UnitsToMillimeters`."""

    text: str


@dataclass(frozen=True, slots=True)
class Response:
    """The answer to a request: a number of four bytes or text, depending on the request."""

    payload: bytes


@dataclass(frozen=True, slots=True)
class EchoRequest:
    """A request for the time of the camera server, to compare the clocks.

    Attributes:
        client: The host's time [ns], which the answer repeats.
    """

    client: int


@dataclass(frozen=True, slots=True)
class EchoResponse:
    """The answer to an `EchoRequest`, with the times of both clocks.

    Attributes:
        client: The host's time in the request [ns].
        server: The server's time when it answered [ticks].
    """

    client: int
    server: int


@dataclass(frozen=True, slots=True)
class BareMessage:
    """A message without a payload that matters, such as KEEPALIVE, REQUEST_MODELDEF or TEXT."""

    kind: MessageKind


ClientMessage = Connect | NatNetRequest | EchoRequest | BareMessage
ServerMessage = ServerInfo | ModelDef | NatNetFrame | Response | EchoResponse | BareMessage


class UpAxis(IntEnum):
    """The server's vertical axis. The value is the server's answer to the request `UpAxis`."""

    Y = 1
    Z = 2


def planar_pose(body: RigidBody, up: UpAxis, heading_offset: float = 0.0) -> Pose | None:
    """Compute a body's pose on the floor, in the server's axes.

    The heading is the direction of the body's +x axis plus `heading_offset`, in [-pi, pi]. The tilt
    is the angle between the body's vertical axis and the server's. Position, direction and tilt are

        z up: (x, y), atan2(2 (qw qz + qx qy), 1 - 2 (qy^2 + qz^2)), acos(1 - 2 (qx^2 + qy^2)),
        y up: (x, -z), atan2(2 (qw qy - qx qz), 1 - 2 (qy^2 + qz^2)), acos(1 - 2 (qx^2 + qz^2)).

    Args:
        body: The rigid body.
        up: The server's vertical axis.
        heading_offset: Angle added to the heading [rad].

    Returns:
        The pose; lengths in m, angles in rad. None if the body is untracked: its valid bit is not
        set, a value is not finite, or its quaternion's norm is not 1.
    """
    x, y, z = body.position
    qx, qy, qz, qw = body.quaternion
    if not body.tracking_valid or not all(map(math.isfinite, body.position)):
        return None
    if not abs(math.hypot(qx, qy, qz, qw) - 1.0) <= NORM_TOLERANCE:  # false for NaN as well
        return None
    if up is UpAxis.Z:
        floor_y = y
        height = z
        half_sine = qw * qz + qx * qy
        half_tilt_term = qx * qx + qy * qy
    else:
        floor_y = -z
        height = y
        half_sine = qw * qy - qx * qz
        half_tilt_term = qx * qx + qz * qz
    heading = atan2(2.0 * half_sine, 1.0 - 2.0 * (qy * qy + qz * qz))
    tilt = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * half_tilt_term)))
    return Pose(x, floor_y, math.remainder(heading + heading_offset, math.tau), height, tilt)


@dataclass(frozen=True, slots=True)
class Placement:
    """The position of the cameras' axes in the spec's coordinates.

    Attributes:
        x: x of their origin [length unit].
        y: y of their origin [length unit].
        rotation: Their rotation [rad].
        scale: Number of length units per metre.
    """

    x: float
    y: float
    rotation: float
    scale: float

    def pose(self, body: RigidBody, up: UpAxis, heading_offset: float = 0.0) -> Pose | None:
        """Compute the pose of a rigid body in the spec's coordinates.

        Args:
            body: The rigid body.
            up: The server's vertical axis.
            heading_offset: Angle added to the heading [rad].

        Returns:
            The pose. None if the body is untracked.
        """
        planar = planar_pose(body, up, heading_offset)
        if planar is None:
            return None
        cos_rotation = cos(self.rotation)
        sin_rotation = sin(self.rotation)
        return Pose(
            self.x + self.scale * (cos_rotation * planar.x - sin_rotation * planar.y),
            self.y + self.scale * (sin_rotation * planar.x + cos_rotation * planar.y),
            math.remainder(planar.heading + self.rotation, math.tau),
            None if planar.height is None else self.scale * planar.height,
            planar.tilt,
        )
