"""Robots as rigid bodies in the server's axes, with the faults of each body."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from random import Random

from tetractl.emulate.sides import Body
from tetractl.lab.cameras.optitrack.natnet_messages import RigidBody
from tetractl.lab.cameras.optitrack.pose import UpAxis


@dataclass(frozen=True, slots=True)
class View:
    """The cameras' axes in the spec's coordinates, as in the camera's section: vertical axis `up`,
    `origin` [mm] and `rotation` [rad].
    """

    up: UpAxis = UpAxis.Y
    origin: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0

    def body(self, number: int, x: float, y: float, heading: float, height: float) -> RigidBody:
        """Return a tracked body at x, y, height [mm] in the spec's axes, with a heading [rad]."""
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
        return RigidBody(number, position, quaternion, True)


@dataclass(slots=True)
class TrackedBody:
    """One robot's rigid body; `offset` is the spec's heading offset [rad].

    `noise` are the standard deviations of a pose [mm, rad]; the noise is drawn from `random`.
    Faults set the other fields: the body is not tracked; frozen at its last pose (`repeats`);
    displaced by `shift` [mm], which grows by `step` [mm] per exposure, along the robot's own axes
    if `own`; turned by `turned` [rad], which grows by `turn` [rad] per exposure; at another
    `height` [mm]; rolled about its own x axis by `roll` [rad]; at a position of NaN; or has a
    quaternion of norm `norm`.
    """

    robot: Body
    id: int
    body_name: str
    offset: float = 0.0
    noise: tuple[float, float] = (0.0, 0.0)
    random: Random = field(default_factory=lambda: Random(0))
    tracked: bool = True
    repeats: bool = False
    shift: tuple[float, float] = (0.0, 0.0)
    step: tuple[float, float] = (0.0, 0.0)
    own: bool = False
    turned: float = 0.0
    turn: float = 0.0
    height: float = 60.0
    roll: float = 0.0
    nan: bool = False
    norm: float = 1.0
    seen: RigidBody | None = field(default=None)  # the body at its last tracked pose

    def expose(self, view: View) -> RigidBody:
        """Return the body as the cameras report it now; an untracked body keeps its last pose."""
        if not self.tracked and self.seen is not None:
            return replace(self.seen, tracking_valid=False)
        if self.repeats and self.seen is not None:
            return self.seen
        robot, draw = self.robot, self.random.gauss
        step = complex(*self.step) * (cmath.rect(1.0, robot.heading) if self.own else 1.0)
        self.shift = self.shift[0] + step.real, self.shift[1] + step.imag
        self.turned += self.turn
        way, angle = self.noise
        x, y = robot.x + self.shift[0] + draw(0, way), robot.y + self.shift[1] + draw(0, way)
        heading = robot.heading + self.turned - self.offset + draw(0, angle)
        body = view.body(self.id, x, y, heading, self.height)
        if self.roll:
            body = replace(body, quaternion=_rolled(body.quaternion, self.roll))
        self.seen = body
        if not self.tracked:
            return replace(body, tracking_valid=False)
        if self.nan:
            return replace(body, position=(math.nan, math.nan, math.nan))
        if self.norm != 1.0:
            qx, qy, qz, qw = (self.norm * part for part in body.quaternion)
            return replace(body, quaternion=(qx, qy, qz, qw))
        return body


def _rolled(
    quaternion: tuple[float, float, float, float], angle: float
) -> tuple[float, float, float, float]:
    """Return a body's quaternion (x, y, z, w) after a turn about its x axis by `angle` [rad]."""
    x, y, z, w = quaternion
    sin, cos = math.sin(angle / 2), math.cos(angle / 2)
    return x * cos + w * sin, y * cos + z * sin, z * cos - y * sin, w * cos - x * sin


def expose(
    tracked: Sequence[TrackedBody], view: View, swapped: set[int], hidden: set[int]
) -> tuple[RigidBody, ...]:
    """Return the bodies as the cameras report them in a frame.

    If `swapped` holds two indices, these two bodies exchange their ids; bodies whose ids are in
    `hidden` are left out.
    """
    bodies = [each.expose(view) for each in tracked]
    if len(swapped) == 2:
        i, j = swapped
        bodies[i], bodies[j] = (
            replace(bodies[j], id=bodies[i].id),
            replace(bodies[i], id=bodies[j].id),
        )
    return tuple(body for body in bodies if body.id not in hidden)
