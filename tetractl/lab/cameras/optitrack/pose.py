"""Converts a tracked rigid body to a robot's pose in the spec's coordinates."""

import math
from dataclasses import dataclass
from enum import IntEnum

from tetractl.core.poses import Pose
from tetractl.lab.cameras.optitrack.natnet import RigidBody
from tetractl.lab.cameras.optitrack.section import OptitrackSection

NORM_TOLERANCE = 1e-3  # largest deviation of a quaternion's norm from 1: its numbers are float32


class UpAxis(IntEnum):
    """The server's vertical axis; the value is the server's answer to the request `UpAxis`."""

    Y = 1
    Z = 2


def planar_pose(body: RigidBody, up: UpAxis, heading_offset: float = 0.0) -> Pose | None:
    """Return a body's pose on the floor in the server's axes; lengths in m, angles in rad.

    The heading is the direction of the body's +x axis plus `heading_offset`, in [-pi, pi]; the tilt
    is the angle between the body's vertical axis and the server's. Position, direction and tilt are

    with z up: (x, y), atan2(2 (qw qz + qx qy), 1 - 2 (qy^2 + qz^2)), acos(1 - 2 (qx^2 + qy^2)),
    with y up: (x, -z), atan2(2 (qw qy - qx qz), 1 - 2 (qy^2 + qz^2)), acos(1 - 2 (qx^2 + qz^2)).

    Returns None if the body is not tracked: its valid bit is not set, a value is not finite, or its
    quaternion's norm is not 1.
    """
    x, y, z = body.position
    qx, qy, qz, qw = body.quaternion
    if not body.tracking_valid or not all(map(math.isfinite, body.position)):
        return None
    if not abs(math.hypot(qx, qy, qz, qw) - 1.0) <= NORM_TOLERANCE:  # false for NaN as well
        return None
    if up is UpAxis.Z:
        along = y
        height = z
        sine = qw * qz + qx * qy
        lean = qx * qx + qy * qy
    else:
        along = -z
        height = y
        sine = qw * qy - qx * qz
        lean = qx * qx + qz * qz
    heading = math.atan2(2.0 * sine, 1.0 - 2.0 * (qy * qy + qz * qz))
    tilt = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * lean)))
    return Pose(x, along, math.remainder(heading + heading_offset, math.tau), height, tilt)


@dataclass(frozen=True, slots=True)
class Placement:
    """The cameras' axes in the spec's coordinates: their origin `x`, `y` [length unit] and
    `rotation` [rad]; `scale` is the number of length units per metre.
    """

    x: float
    y: float
    rotation: float
    scale: float

    @classmethod
    def of(cls, section: OptitrackSection, metres: float) -> "Placement":
        """Return the placement given by a section of a spec with the length unit `metres` [m]."""
        return cls(*section.origin, section.rotation, 1.0 / metres)

    def pose(self, body: RigidBody, up: UpAxis, heading_offset: float = 0.0) -> Pose | None:
        """Return a body's pose in the spec's coordinates, None if the body is not tracked."""
        planar = planar_pose(body, up, heading_offset)
        if planar is None:
            return None
        cos = math.cos(self.rotation)
        sin = math.sin(self.rotation)
        return Pose(
            self.x + self.scale * (cos * planar.x - sin * planar.y),
            self.y + self.scale * (sin * planar.x + cos * planar.y),
            math.remainder(planar.heading + self.rotation, math.tau),
            None if planar.height is None else self.scale * planar.height,
            planar.tilt,
        )
