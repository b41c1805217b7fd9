"""Robots as rigid bodies in the camera server's axes, with the faults of each body.

At each exposure a `TrackedBody` takes the pose of its robot, displaces it by what faults and errors
ask for, and reports it as a `RigidBody` [m, quaternion] in the axes of a `View`. A complex number
is a vector on the floor, x + iy [mm], in the axes of the experiment's spec unless said otherwise.

Faults set fields of a body's parts, and restore them when they end. What each has set is kept by
object in a weak dictionary (`tetractl_emulator.faults`). So the classes that faults change are
hashed by identity (`eq=False`) and can be referred to weakly (`weakref_slot=True`).
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
"""Changes a body as it is reported, not where it is."""


@dataclass(frozen=True, slots=True)
class PictureChange:
    """A change of the picture: it is displaced by `shift` [mm], grown by a factor and turned by an
    angle [rad]. The picture is displaced after it has been turned and grown, so that changes may be
    taken back in any order.
    """

    shift: complex = 0j
    factor: float = 1.0
    angle: float = 0.0


@dataclass(eq=False, slots=True, weakref_slot=True)
class View:
    """The cameras' axes in the spec's coordinates, as the spec's section of the camera has them:
    vertical axis `up`, `origin` [mm] and `rotation` [rad].

    Faults change the picture: it is turned about the origin by `turned` [rad], `grown` by a factor
    and then displaced by `shift` [mm]. The camera calls `creep` at each exposure: the picture
    changes by all of `creeping`, and stays where that has brought it, as a camera does whose tripod
    has slipped.
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
    """The standard deviations of a pose, and the body's own random numbers: its errors are drawn
    from `random`, and so are the frames that miss it.
    """

    position_mm: float
    heading_rad: float
    random: Random


@dataclass(eq=False, slots=True, weakref_slot=True)
class BodyTracking:
    """Whether the system tracks a body, and the share of frames that miss a body that it tracks
    (`missing`). While a body `repeats`, its pose stays as it is.
    """

    tracked: bool = True
    missing: float = 0.0
    repeats: bool = False


@dataclass(eq=False, slots=True, weakref_slot=True)
class Displacement:
    """Where a body is seen away from its robot.

    Constant are `shift` [mm], `turned` [rad] and `height` [mm], that of the markers above the
    floor. A body that strays goes on by `step` [mm], along the axes of the robot if `along_robot`,
    and by `turn` [rad] at each exposure that gives it a new pose: by now `strayed` [mm] and
    `strayed_turn` [rad].
    """

    shift: complex = 0j
    turned: float = 0.0
    height: float = 60.0
    step: complex = 0j
    along_robot: bool = False
    turn: float = 0.0
    strayed: complex = 0j
    strayed_turn: float = 0.0

    def stray(self, robot_direction: complex) -> None:
        """Go on straying; `robot_direction` is the unit vector of the robot's heading."""
        self.strayed += self.step * (robot_direction if self.along_robot else 1.0)
        self.strayed_turn += self.turn


@dataclass(eq=False, slots=True, weakref_slot=True)
class Plate:
    """How the plate with the markers has slipped on its robot: by `slip` [mm] along the robot's
    axes, with which it turns, and by an angle `turned` [rad].
    """

    slip: complex = 0j
    turned: float = 0.0


@dataclass(eq=False, slots=True, weakref_slot=True)
class TrackedBody:
    """One robot's rigid body, as its parts say. Each of the `changes` alters its pose as it is
    reported.
    """

    robot: Body
    asset: Asset
    noise: PoseNoise
    tracking: BodyTracking = field(default_factory=BodyTracking)
    displacement: Displacement = field(default_factory=Displacement)
    plate: Plate = field(default_factory=Plate)
    changes: list[BodyChange] = field(default_factory=list)
    last: RigidBody | None = None  # of the last exposure that gave it a new pose, unchanged

    def expose(self, view: View) -> RigidBody:
        """Take an exposure; return the body as the cameras report it.

        A body that they see has a new pose unless it repeats. One that they miss is reported as not
        tracked, with its last pose and without the changes, which are of tracked poses. The first
        exposure always gives it a pose.
        """
        is_seen = self._draw_seen()
        if self.last is None or (is_seen and not self.tracking.repeats):
            self.last = self._new_pose(view)
        body = self.last
        if not is_seen:
            return replace(body, tracking_valid=False)
        for change in self.changes:
            body = change(body)
        return body

    def _draw_seen(self) -> bool:
        """Draw whether this frame has the body. Nothing is drawn for a body that no frame misses,
        so that its errors are the same as without this fault."""
        if not self.tracking.tracked:
            return False
        missing = self.tracking.missing
        return missing == 0 or self.noise.random.random() >= missing

    def _new_pose(self, view: View) -> RigidBody:
        """Let the body stray; return it at its robot's pose, displaced and with noise."""
        robot = self.robot
        displaced = self.displacement
        robot_direction = cmath.rect(1.0, robot.heading)
        displaced.stray(robot_direction)
        off_mm = displaced.shift + displaced.strayed + self.plate.slip * robot_direction
        displaced_rad = displaced.turned + displaced.strayed_turn
        turned_rad = displaced_rad + self.plate.turned - self.asset.offset
        draw = self.noise.random.gauss
        x = robot.x + off_mm.real + draw(0, self.noise.position_mm)
        y = robot.y + off_mm.imag + draw(0, self.noise.position_mm)
        heading = robot.heading + turned_rad + draw(0, self.noise.heading_rad)
        return view.body(self.asset.number, x, y, heading, displaced.height)


def without_position(body: RigidBody) -> RigidBody:
    """Return the body with a position that is not a number."""
    return replace(body, position=(math.nan, math.nan, math.nan))


def with_half_a_quaternion(body: RigidBody) -> RigidBody:
    """Return the body with a quaternion of norm 0.5."""
    x, y, z, w = body.quaternion
    return replace(body, quaternion=(x / 2, y / 2, z / 2, w / 2))


def has_a_pose(body: RigidBody) -> bool:
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
