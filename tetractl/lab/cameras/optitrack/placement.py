"""Where the cameras' axes lie: rigid bodies as poses in the spec's coordinates."""

import math
from dataclasses import dataclass

from tetractl.core.poses import Pose
from tetractl.lab.cameras.optitrack.messages import NatNetFrame, RigidBody
from tetractl.lab.cameras.optitrack.pose import UpAxis, planar_pose
from tetractl.lab.cameras.optitrack.section import OptitrackSection


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the cameras' axes lie in the spec's coordinates; `scale` length units to a metre."""

    x: float
    y: float
    rotation: float
    scale: float

    @classmethod
    def of(cls, section: OptitrackSection, metres: float) -> "Placement":
        """Return the placement that a spec gives; `metres` in its length unit."""
        return cls(*section.origin, section.rotation, 1.0 / metres)

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
            self.scale * seen.height,
            seen.tilt,
        )


def fault_of(frame: NatNetFrame) -> str:
    """Return why a frame does not show the robots as they are now, "" where it does."""
    return "Motive is in edit mode: it streams a recording" if frame.edit_mode else ""
