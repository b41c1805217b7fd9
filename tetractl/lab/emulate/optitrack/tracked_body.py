"""Robots as rigid bodies in the server's axes, and what is wrong with them while a fault is on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from tetractl.lab.cameras.optitrack.messages import RigidBody
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.emulate.sides import Body


@dataclass(frozen=True, slots=True)
class View:
    """How the cameras' coordinates lie in the spec's, see the camera's section; origin in mm."""

    up: UpAxis = UpAxis.Y
    origin: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0

    def body(self, number: int, x: float, y: float, heading: float, height: float) -> RigidBody:
        """Return a tracked body at x, y, height [mm] of the spec's axes, turned by heading."""
        dx, dy = x - self.origin[0], y - self.origin[1]
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        along, across = (cos * dx + sin * dy) / 1000, (cos * dy - sin * dx) / 1000
        half = (heading - self.rotation) / 2
        if self.up is UpAxis.Z:
            position = (along, across, height / 1000)
            quaternion = (0.0, 0.0, math.sin(half), math.cos(half))
        else:
            position = (along, height / 1000, -across)
            quaternion = (0.0, math.sin(half), 0.0, math.cos(half))
        return RigidBody(number, position, quaternion, 0.0002, True)


@dataclass(slots=True)
class TrackedBody:
    """One robot's rigid body; `offset` is the spec's heading offset [rad].

    The other fields are what faults set: not tracked, displaced by `shift` [mm], which grows by
    `step` [mm] at each exposure, at another `height` [mm], rolled about its own x axis by `roll`
    [rad], position NaN, quaternion of norm `norm`.
    """

    robot: Body
    id: int
    body_name: str
    offset: float = 0.0
    tracked: bool = True
    shift: tuple[float, float] = (0.0, 0.0)
    step: tuple[float, float] = (0.0, 0.0)
    height: float = 60.0
    roll: float = 0.0
    nan: bool = False
    norm: float = 1.0
    seen: RigidBody | None = field(default=None)  # the last one tracked

    def expose(self, view: View) -> RigidBody:
        """Return the body as the cameras give it now; an untracked one keeps its last pose."""
        if not self.tracked and self.seen is not None:
            return replace(self.seen, mean_error=0.0, tracking_valid=False)
        robot = self.robot
        self.shift = self.shift[0] + self.step[0], self.shift[1] + self.step[1]
        x, y = robot.x + self.shift[0], robot.y + self.shift[1]
        body = view.body(self.id, x, y, robot.heading - self.offset, self.height)
        if self.roll:
            body = replace(body, quaternion=_rolled(body.quaternion, self.roll))
        self.seen = body
        if not self.tracked:
            return replace(body, mean_error=0.0, tracking_valid=False)
        if self.nan:
            return replace(body, position=(math.nan, math.nan, math.nan))
        if self.norm != 1.0:
            qx, qy, qz, qw = (self.norm * part for part in body.quaternion)
            return replace(body, quaternion=(qx, qy, qz, qw))
        return body


def _rolled(
    quaternion: tuple[float, float, float, float], angle: float
) -> tuple[float, float, float, float]:
    """Return a quaternion (x, y, z, w) after a turn about its body's own x axis."""
    x, y, z, w = quaternion
    sin, cos = math.sin(angle / 2), math.cos(angle / 2)
    return x * cos + w * sin, y * cos + z * sin, z * cos - y * sin, w * cos - x * sin


def expose(
    tracked: Sequence[TrackedBody], view: View, swapped: set[int], hidden: set[int]
) -> tuple[RigidBody, ...]:
    """Return the bodies as a frame has them.

    The two whose places are in `swapped` have each other's id; those whose ids are in `hidden`
    are left out.
    """
    bodies = [each.expose(view) for each in tracked]
    if len(swapped) == 2:
        i, j = swapped
        bodies[i], bodies[j] = (
            replace(bodies[j], id=bodies[i].id),
            replace(bodies[i], id=bodies[j].id),
        )
    return tuple(body for body in bodies if body.id not in hidden)
