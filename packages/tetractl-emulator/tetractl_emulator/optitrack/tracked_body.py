"""Robots as rigid bodies in the server's axes, with the faults of each body.

A `TrackedBody` takes the pose of its robot, displaces it by what faults and errors ask for, and
reports it as a `RigidBody` [m, quaternion] in the axes of a `View`. A complex number is a vector on
the floor, x + iy [mm], in the spec's axes unless said otherwise. Faults set fields of the parts;
they find what another has set by the part itself, which is therefore compared by identity.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from random import Random

from tetractl.lab.cameras.optitrack.natnet import RigidBody
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl_emulator.sides import Body

BodyChange = Callable[[RigidBody], RigidBody]
"""Changes a body as it is reported."""


@dataclass(frozen=True, slots=True)
class PictureChange:
    """A change of the picture: it is displaced by `shift` [mm], grown by a factor and turned by an
    angle [rad]. None acts on the shift of another, so changes may be taken back in any order.
    """

    shift: complex = 0j
    factor: float = 1.0
    angle: float = 0.0


@dataclass(eq=False, slots=True, weakref_slot=True)
class View:
    """The cameras' axes in the spec's coordinates, as in the camera's section: vertical axis `up`,
    `origin` [mm] and `rotation` [rad].

    Faults set the other fields: the picture is turned about the origin by `turned` [rad], `grown`
    by a factor and displaced by `shift` [mm]. The camera calls `creep` at each exposure: the
    picture changes by all of `creeping`, and stays where that has brought it, as a camera does
    whose tripod has slipped.
    """

    up: UpAxis = UpAxis.Y
    origin: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    shift: complex = 0j
    grown: float = 1.0
    turned: float = 0.0
    creeping: list[PictureChange] = field(default_factory=list)

    def creep(self) -> None:
        """Let the picture change as it does from one exposure to the next."""
        for change in self.creeping:
            self.apply(change)

    def apply(self, change: PictureChange) -> None:
        """Change the picture."""
        self.shift += change.shift
        self.grown *= change.factor
        self.turned += change.angle

    def take_back(self, change: PictureChange) -> None:
        """Take a change back; others that came since remain."""
        self.shift -= change.shift
        self.grown /= change.factor
        self.turned -= change.angle

    def body(self, number: int, x: float, y: float, heading: float, height: float) -> RigidBody:
        """Return a tracked body at x, y, height [mm] in the spec's axes, with a heading [rad]."""
        from_origin = complex(x, y) - complex(*self.origin)
        in_picture = from_origin * cmath.rect(self.grown, self.turned) + self.shift
        # the system's axes are the spec's turned by `rotation`, so coordinates turn by -rotation;
        # with y up, the system's z is the -y that it would have with z up
        floor_m = in_picture * cmath.rect(1e-3, -self.rotation)
        height_m = height / 1000
        half = cmath.rect(1.0, (heading + self.turned - self.rotation) / 2)
        if self.up is UpAxis.Z:
            position = (floor_m.real, floor_m.imag, height_m)
            quaternion = (0.0, 0.0, half.imag, half.real)
        else:
            position = (floor_m.real, height_m, -floor_m.imag)
            quaternion = (0.0, half.imag, 0.0, half.real)
        return RigidBody(number, position, quaternion, True)


@dataclass(eq=False, slots=True, weakref_slot=True)
class Asset:
    """A body as the motion-capture system lists it: its number and name, the robot's heading less
    the body's (`offset` [rad]), and whether its poses are in the stream.
    """

    number: int
    name: str
    offset: float = 0.0
    streamed: bool = True


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """The standard deviations of a pose, and what its errors, and the frames that miss the body,
    are drawn from: a generator of its own for each body.
    """

    position_mm: float = 0.0
    heading_rad: float = 0.0
    random: Random = field(default_factory=lambda: Random(0))


@dataclass(eq=False, slots=True, weakref_slot=True)
class BodyTracking:
    """Whether the system tracks a body, and in which share of the frames it misses it all the
    same (`missing`); while it `repeats`, its pose stays the one seen last.
    """

    tracked: bool = True
    missing: float = 0.0
    repeats: bool = False


@dataclass(eq=False, slots=True, weakref_slot=True)
class Displacement:
    """Where a body is seen away from its robot, and how that grows at each exposure that gives it
    a new pose.

    - `shift` [mm] is constant; `strayed` [mm] grows by `step` [mm], along the axes of the robot if
      `along_robot`, else along those of the spec.
    - `turned` [rad] grows by `turn` [rad].
    - `height` [mm] is that above the floor.
    """

    shift: complex = 0j
    strayed: complex = 0j
    step: complex = 0j
    along_robot: bool = False
    turned: float = 0.0
    turn: float = 0.0
    height: float = 60.0

    def grow(self, robot_axes: complex) -> None:
        """Let the body stray as it does from one exposure to the next; `robot_axes` is the
        direction of the robot's heading."""
        self.strayed += self.step * (robot_axes if self.along_robot else 1.0)
        self.turned += self.turn


@dataclass(eq=False, slots=True, weakref_slot=True)
class Plate:
    """How a marker plate has slipped on its robot: by `slip` [mm] along the robot's axes, and
    turned by `turned` [rad].
    """

    slip: complex = 0j
    turned: float = 0.0


@dataclass(eq=False, slots=True, weakref_slot=True)
class TrackedBody:
    """One robot's rigid body. Faults set fields of its parts, and add to the `changes`, each of
    which changes its pose.
    """

    robot: Body
    asset: Asset
    noise: PoseNoise = field(default_factory=PoseNoise)
    tracking: BodyTracking = field(default_factory=BodyTracking)
    displacement: Displacement = field(default_factory=Displacement)
    plate: Plate = field(default_factory=Plate)
    changes: list[BodyChange] = field(default_factory=list)
    last_seen: RigidBody | None = None  # as seen last, before `changes`

    def expose(self, view: View) -> RigidBody:
        """Take an exposure: displace the body further and see it again, unless it is untracked or
        repeats; return it as the cameras report it.

        An untracked body has the pose at which it was seen last, without the changes; before it was
        ever seen, its present one.
        """
        tracked = self._tracked_now()
        if self.last_seen is None or (tracked and not self.tracking.repeats):
            robot_axes = cmath.rect(1.0, self.robot.heading)
            self.displacement.grow(robot_axes)
            self.last_seen = self._seen(view, robot_axes)
        body = self.last_seen
        if not tracked:
            return replace(body, tracking_valid=False)
        for change in self.changes:
            body = change(body)
        return body

    def _tracked_now(self) -> bool:
        """Draw whether this frame has the body; nothing is drawn for a body that none misses, so
        that its errors are the same as without this fault."""
        if not self.tracking.tracked:
            return False
        missing = self.tracking.missing
        return not missing or self.noise.random.random() >= missing

    def _seen(self, view: View, robot_axes: complex) -> RigidBody:
        """Return the body at its robot's pose, displaced and with noise; `robot_axes` is the
        direction of the robot's heading."""
        robot = self.robot
        off_mm = self.displacement.shift + self.displacement.strayed + self.plate.slip * robot_axes
        turned_rad = self.displacement.turned + self.plate.turned - self.asset.offset
        draw = self.noise.random.gauss
        x = robot.x + off_mm.real + draw(0, self.noise.position_mm)
        y = robot.y + off_mm.imag + draw(0, self.noise.position_mm)
        heading = robot.heading + turned_rad + draw(0, self.noise.heading_rad)
        return view.body(self.asset.number, x, y, heading, self.displacement.height)


def nowhere(body: RigidBody) -> RigidBody:
    """Return the body at a position that is not a number."""
    return replace(body, position=(math.nan, math.nan, math.nan))


def halved(body: RigidBody) -> RigidBody:
    """Return the body with a quaternion of norm 0.5."""
    x, y, z, w = body.quaternion
    return replace(body, quaternion=(x / 2, y / 2, z / 2, w / 2))


def is_somewhere(body: RigidBody) -> bool:
    """Return whether a body has a position, and a quaternion of norm 1."""
    norm_squared = sum(value * value for value in body.quaternion)
    return math.isfinite(sum(body.position)) and abs(norm_squared - 1.0) < 0.01


def rolled(angle: float) -> BodyChange:
    """Return a function that turns a body about its own x axis by `angle` [rad]."""
    sin = math.sin(angle / 2)
    cos = math.cos(angle / 2)

    def roll(body: RigidBody) -> RigidBody:
        x, y, z, w = body.quaternion  # times (sin, 0, 0, cos) from the right: its own x axis
        turned = x * cos + w * sin, y * cos + z * sin, z * cos - y * sin, w * cos - x * sin
        return replace(body, quaternion=turned)

    return roll
