"""Robots as rigid bodies in the camera server's axes, with the faults of each body.

At an exposure a `TrackedBody` takes the pose of its robot, displaces it by what faults and errors
ask for, and reports it as a `RigidBody` [m, quaternion] in the axes of a `View`. Complex fields are
vectors on the floor, x + iy [mm], in the axes of the experiment's spec unless said otherwise;
`cmath.rect(1, angle)` turns one by an angle.

Faults set fields of a body's parts, and restore them when they end. `tetractl_emulator.faults`
keeps the values from before in a dictionary with weak keys, the parts. So the parts that it sets
are hashed by identity (`eq=False`) and can be referred to weakly (`weakref_slot=True`). A `View`
and the `changes` of a body need neither: faults add to them, and take that back.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from random import Random

from tetractl.lab.cameras.optitrack.natnet import NORM_TOLERANCE, RigidBody, UpAxis
from tetractl_emulator.sides import Body

BodyChange = Callable[[RigidBody], RigidBody]
"""Changes a body as it is reported, not where it is."""


@dataclass(frozen=True, slots=True)
class PictureChange:
    """A change of the picture: it is turned about the cameras' origin by `angle` [rad], grown by
    `factor`, then displaced by `shift` [mm]. As the shift comes last, and is neither turned nor
    grown, changes may be taken back in any order.
    """

    shift: complex = 0j
    factor: float = 1.0
    angle: float = 0.0


@dataclass(slots=True)
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

    def rigid_body_at(
        self, number: int, x: float, y: float, heading: float, height: float
    ) -> RigidBody:
        """Return a tracked body at x, y, height [mm] in the spec's axes, with a heading [rad]."""
        from_origin = complex(x, y) - complex(*self.origin)
        in_picture = from_origin * cmath.rect(self.grown, self.turned) + self.shift
        # the system's axes are the spec's turned by `rotation`, so coordinates turn by -rotation;
        # with y up, the system's z is the -y that it would have with z up
        floor_m = in_picture * cmath.rect(1e-3, -self.rotation)
        height_m = height / 1000
        half_turn = cmath.rect(1.0, (heading + self.turned - self.rotation) / 2)
        if self.up is UpAxis.Z:
            position = (floor_m.real, floor_m.imag, height_m)
            quaternion = (0.0, 0.0, half_turn.imag, half_turn.real)
        else:
            position = (floor_m.real, height_m, -floor_m.imag)
            quaternion = (0.0, half_turn.imag, 0.0, half_turn.real)
        return RigidBody(number, position, quaternion, tracking_valid=True)


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
    """The standard deviations of a pose. Its errors are drawn from `random`, and so are the frames
    that miss the body. The bodies of a camera share it: what is drawn for one changes the errors of
    all.
    """

    position_mm: float
    heading_rad: float
    random: Random


@dataclass(eq=False, slots=True, weakref_slot=True)
class BodyTracking:
    """Whether the system tracks a body, and the share of frames that miss a body that it tracks
    (`missing`). A body is not tracked while its robot is `carried`. While it `repeats`, exposures
    after its first give it no new pose.
    """

    tracked: bool = True
    carried: bool = False
    missing: float = 0.0
    repeats: bool = False


@dataclass(eq=False, slots=True, weakref_slot=True)
class Displacement:
    """Where a body is seen relative to its robot: off by a constant shift and turn, and by what it
    has strayed, which grows with each new pose."""

    shift: complex = 0j
    """By how far it is off [mm]."""
    turned: float = 0.0
    """By how much it is turned [rad]; no fault sets it, tests do."""
    height: float = 60.0
    """Height of its markers above the floor [mm]."""
    step: complex = 0j
    """How far it strays with each new pose [mm]."""
    along_robot: bool = False
    """Whether `step` is along and left of the robot's heading, instead of in the spec's axes."""
    turn_step: float = 0.0
    """How far it turns away with each new pose [rad]."""
    strayed: complex = 0j
    """How far it has strayed until now [mm]."""
    strayed_turn: float = 0.0
    """How far it has turned away until now [rad]."""


@dataclass(eq=False, slots=True, weakref_slot=True)
class Plate:
    """How the plate with the markers has slipped on its robot: by `slip` [mm] along the robot's
    axes, with which it turns, and by an angle `turned` [rad].
    """

    slip: complex = 0j
    turned: float = 0.0


@dataclass(slots=True)
class TrackedBody:
    """The rigid body on one robot, and what faults have done to it. `last_pose` is its newest pose,
    before the `changes`: these are applied in order each time that it is reported as tracked.
    """

    robot: Body
    asset: Asset
    noise: PoseNoise
    tracking: BodyTracking = field(default_factory=BodyTracking)
    displacement: Displacement = field(default_factory=Displacement)
    plate: Plate = field(default_factory=Plate)
    changes: list[BodyChange] = field(default_factory=list)
    last_pose: RigidBody | None = None

    def expose(self, view: View) -> RigidBody:
        """Take an exposure; return the body as the cameras report it.

        A body that they see has a new pose unless it repeats. One that they miss is reported as not
        tracked, with its last pose and without the changes, as a receiver should not use that pose.
        The first exposure always gives it a pose.
        """
        is_seen = self._is_seen_now()
        if self.last_pose is None or (is_seen and not self.tracking.repeats):
            seen_at = self.displacement
            axis = cmath.rect(1.0, self.robot.heading) if seen_at.along_robot else 1.0
            seen_at.strayed += seen_at.step * axis
            seen_at.strayed_turn += seen_at.turn_step
            self.last_pose = self._new_pose(view)
        body = replace(self.last_pose, id=self.asset.number)
        if not is_seen:
            return replace(body, tracking_valid=False)
        for change in self.changes:
            body = change(body)
        return body

    def _is_seen_now(self) -> bool:
        """Return whether this frame shows the body; drawn at random if it is tracked and some
        frames miss it."""
        if self.tracking.carried or not self.tracking.tracked:
            return False
        missing = self.tracking.missing
        return missing == 0 or self.noise.random.random() >= missing

    def _new_pose(self, view: View) -> RigidBody:
        """Return the body at its robot's pose, displaced and with noise."""
        robot = self.robot
        seen_at = self.displacement
        slipped = self.plate.slip * cmath.rect(1.0, robot.heading)
        away_mm = seen_at.shift + seen_at.strayed + slipped
        turned_away = seen_at.turned + seen_at.strayed_turn
        body_heading = robot.heading + (turned_away + self.plate.turned - self.asset.offset)
        draw = self.noise.random.gauss
        x = robot.x + away_mm.real + draw(0, self.noise.position_mm)
        y = robot.y + away_mm.imag + draw(0, self.noise.position_mm)
        heading = body_heading + draw(0, self.noise.heading_rad)
        return view.rigid_body_at(self.asset.number, x, y, heading, seen_at.height)


def without_position(body: RigidBody) -> RigidBody:
    """Return the body with a position that is not a number."""
    return replace(body, position=(math.nan, math.nan, math.nan))


def with_halved_quaternion(body: RigidBody) -> RigidBody:
    """Return the body with a quaternion of norm 0.5."""
    x, y, z, w = body.quaternion
    return replace(body, quaternion=(x / 2, y / 2, z / 2, w / 2))


def has_a_pose(body: RigidBody) -> bool:
    """Return whether a client can take a pose from a body: its position is finite, and its
    quaternion's norm is 1."""
    is_finite = all(math.isfinite(value) for value in body.position)
    return is_finite and abs(math.hypot(*body.quaternion) - 1.0) <= NORM_TOLERANCE


def rolled(angle: float) -> BodyChange:
    """Return a function that turns a body about its own x axis by `angle` [rad]."""
    sin = math.sin(angle / 2)
    cos = math.cos(angle / 2)

    def roll(body: RigidBody) -> RigidBody:
        x, y, z, w = body.quaternion  # times (sin, 0, 0, cos) from the right: its own x axis
        product = x * cos + w * sin, y * cos + z * sin, z * cos - y * sin, w * cos - x * sin
        return replace(body, quaternion=product)

    return roll
