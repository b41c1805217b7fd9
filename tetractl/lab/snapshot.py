"""What the cameras saw of the robots at one instant, in the spec's coordinates."""

import math
from dataclasses import dataclass

from tetractl.lab.natnet.messages import Frame, RigidBody
from tetractl.lab.natnet.pose import UpAxis, planar_pose
from tetractl.spec.lab import Mocap


@dataclass(frozen=True, slots=True)
class Pose:
    """x, y in the spec's length unit, heading in rad anticlockwise from +x, in [-pi, pi]."""

    x: float
    y: float
    heading: float


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One camera frame: `poses` by robot, None where one is not tracked.

    `sampled_ns` is when the cameras were exposed and `received_ns` when the host had the frame,
    both on the host's clock. `strangers` are tracked bodies that are no robot. `fault` says why
    the stream must not be trusted, "" if it may.
    """

    number: int
    sampled_ns: int
    received_ns: int
    poses: tuple[Pose | None, ...]
    strangers: tuple[Pose, ...] = ()
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the cameras' axes lie in the spec's coordinates; `scale` length units to a metre."""

    x: float
    y: float
    rotation: float
    scale: float

    @classmethod
    def of(cls, mocap: Mocap, metres: float) -> "Placement":
        """Take it from a spec; `metres` in its length unit."""
        return cls(*mocap.origin, mocap.rotation, 1.0 / metres)

    def pose(self, body: RigidBody, up: UpAxis, heading_offset: float = 0.0) -> Pose | None:
        """Return a body's pose, None where it cannot be trusted."""
        seen = planar_pose(body, up, heading_offset)
        if seen is None:
            return None
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        return Pose(
            self.x + self.scale * (cos * seen.x - sin * seen.y),
            self.y + self.scale * (sin * seen.x + cos * seen.y),
            math.remainder(seen.heading + self.rotation, math.tau),
        )


def fault_of(frame: Frame) -> str:
    """Return why a frame is none of the robots as they are now, "" if it is."""
    return "Motive is in edit mode: it streams a recording" if frame.edit_mode else ""
