"""From a rigid body to a robot's planar pose, or to nothing where it cannot be trusted."""

import math
from dataclasses import dataclass
from enum import IntEnum

from tetractl.lab.cameras.optitrack.messages import RigidBody

NORM_TOLERANCE = 1e-3


class UpAxis(IntEnum):
    """The server's vertical axis, as `UpAxis` answers it."""

    Y = 1
    Z = 2


@dataclass(frozen=True, slots=True)
class PlanarPose:
    """x, y and height in m; heading in rad anticlockwise from +x, in [-pi, pi].

    `tilt` is the angle between the body's own vertical axis and the server's [rad, 0 to pi].
    """

    x: float
    y: float
    heading: float
    height: float
    tilt: float


def planar_pose(body: RigidBody, up: UpAxis, heading_offset: float = 0.0) -> PlanarPose | None:
    """Project a body onto the floor, its own +x axis as heading, plus the robot's offset [rad].

    With z up: (x, y), atan2(2 (qw qz + qx qy), 1 - 2 (qy^2 + qz^2)), acos(1 - 2 (qx^2 + qy^2)).
    With y up: (x, -z), atan2(2 (qw qy - qx qz), 1 - 2 (qy^2 + qz^2)), acos(1 - 2 (qx^2 + qz^2)).

    None where the body is not tracked: valid bit not set, a value not finite, or a quaternion
    whose norm is not 1.
    """
    x, y, z = body.position
    qx, qy, qz, qw = body.quaternion
    if not body.tracking_valid or not all(map(math.isfinite, body.position)):
        return None
    if not abs(math.hypot(qx, qy, qz, qw) - 1.0) <= NORM_TOLERANCE:  # false for NaN as well
        return None
    if up is UpAxis.Z:
        along, height, sine, lean = y, z, qw * qz + qx * qy, qx * qx + qy * qy
    else:
        along, height, sine, lean = -z, y, qw * qy - qx * qz, qx * qx + qz * qz
    heading = math.atan2(2.0 * sine, 1.0 - 2.0 * (qy * qy + qz * qz))
    tilt = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * lean)))
    return PlanarPose(x, along, math.remainder(heading + heading_offset, math.tau), height, tilt)
