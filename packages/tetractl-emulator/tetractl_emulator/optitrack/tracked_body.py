"""Robots as rigid bodies in the axes of a motion-capture system, with the faults of each body.

At an exposure, a `TrackedBody` takes the pose of its robot, displaces it according to faults and
noise, and reports it as a `RigidBody` [m, quaternion] in the axes of a `View`. Complex numbers are
vectors on the floor, x + iy [mm], in the axes of the spec unless stated otherwise. Multiplication
by `cmath.rect(1, angle)` rotates a vector by an angle.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from random import Random
from typing import Any

from tetractl.lab.cameras.optitrack.natnet import NORM_TOLERANCE, RigidBody, UpAxis
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.sides import Body

HEIGHT_MM = 60.0
"""Height of a body's markers above the floor [mm]."""


@dataclass(slots=True)
class View:
    """The axes of a motion-capture system, relative to the spec's coordinates.

    Faults transform the measured positions like an image: it is rotated about the origin, scaled,
    and then displaced.

    Attributes:
        up: The vertical axis.
        origin: Origin of the system in the spec's axes [mm].
        rotation: Angle from the spec's x axis to the system's x axis [rad].
        shift: Displacement of the image [mm].
        grown: Scale factor of the image.
        turned: Angle by which the image is rotated about the origin [rad].
    """

    up: UpAxis = UpAxis.Y
    origin: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    shift: complex = 0j
    grown: float = 1.0
    turned: float = 0.0

    def exposed(self, faults: Sequence[Any]) -> "View":
        """Return the view for one exposure, as the faults transform it.

        Faults that creep change the view itself, from one exposure to the next. Their effect
        remains, like that of a tripod that has slipped.

        Args:
            faults: The acting faults of the kind `picture`.
        """
        for fault in faults:
            if fault.creeps:
                self._change(fault)
        picture = replace(self)
        for fault in faults:
            if not fault.creeps:
                picture._change(fault)
        return picture

    def _change(self, fault: Any) -> None:
        """Apply the transformation of a fault on top of the present one."""
        self.shift += complex(*fault.by)
        self.grown *= fault.scale
        self.turned += fault.turn

    def rigid_body_at(
        self, number: int, x: float, y: float, heading: float, height: float
    ) -> RigidBody:
        """Create the tracked rigid body for a pose in the spec's axes.

        Args:
            number: Id of the rigid body.
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
            height: Height above the floor [mm].
        """
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


@dataclass(slots=True)
class Asset:
    """A rigid body as it is defined in the motion-capture system.

    Attributes:
        number: Its id.
        name: Its name.
        offset: The robot's heading minus the rigid body's heading [rad].
        streamed: Whether its poses are in the stream.
    """

    number: int
    name: str
    offset: float = 0.0
    streamed: bool = True


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """The noise of measured poses, shared by all rigid bodies of a camera.

    The random generator also decides which frames miss a rigid body. Because it is shared, a number
    sampled for one body changes the noise of all others.

    Attributes:
        position_mm: Standard deviation of each coordinate [mm].
        heading_rad: Standard deviation of a heading [rad].
        random: The random generator.
    """

    position_mm: float
    heading_rad: float
    random: Random


@dataclass(slots=True)
class TrackedBody:
    """The rigid body on one robot.

    Attributes:
        robot: The robot.
        asset: The rigid body as it is defined in the system.
        noise: The noise of its poses.
        acting: The faults that act now.
        shift: Constant error of its position [mm].
        turned: Constant error of its heading [rad].
        strayed: Error of its position that faults `ghost` have accumulated [mm].
        strayed_turn: Error of its heading that faults `ghost` have accumulated [rad].
        exposures: Number of exposures so far.
        last_pose: Its newest pose. None before the first exposure.
    """

    robot: Body
    asset: Asset
    noise: PoseNoise
    acting: ActingFaults = field(default_factory=ActingFaults)
    shift: complex = 0j
    turned: float = 0.0
    strayed: complex = 0j
    strayed_turn: float = 0.0
    exposures: int = 0
    last_pose: RigidBody | None = None

    def expose(self, view: View) -> RigidBody:
        """Return the rigid body as the cameras report it at an exposure.

        A body that the cameras see has a new pose, unless a fault repeats the last one. A body that
        they miss is reported as untracked, with its last pose and without further changes, because
        a receiver should not use that pose. The first exposure always gives it a pose.
        """
        name = self.robot.name
        self.exposures += 1
        is_seen = self._is_seen_now()
        repeats = any(fault.robot in (None, name) for fault in self.acting.of_kind("repeat"))
        if self.last_pose is None or (is_seen and not repeats):
            self._stray()
            self.last_pose = self._new_pose(view)
        body = replace(self.last_pose, id=self.asset.number)
        if not is_seen:
            return replace(body, tracking_valid=False)
        for fault in self.acting.of_kind("tipped", name):
            body = rolled(body, fault.angle)
        if self.acting.of_kind("nan", name):
            body = replace(body, position=(math.nan, math.nan, math.nan))
        if self.acting.of_kind("bad_quaternion", name):
            x, y, z, w = body.quaternion
            body = replace(body, quaternion=(x / 2, y / 2, z / 2, w / 2))
        return body

    def _is_seen_now(self) -> bool:
        """Decide whether this frame shows the rigid body.

        If frames miss it in part, this is random.
        """
        name = self.robot.name
        if self.acting.robots_are_carried or self.acting.of_kind("untracked", name):
            return False
        if any(self.exposures % fault.every for fault in self.acting.of_kind("half_tracked", name)):
            return False
        missing = self.acting.largest_share("half_tracked", name)
        return missing == 0 or self.noise.random.random() >= missing

    def _stray(self) -> None:
        """Accumulate the errors of the faults `ghost`, or reset them if no such fault acts."""
        ghosts = self.acting.of_kind("ghost", self.robot.name)
        if not ghosts:
            self.strayed = 0j
            self.strayed_turn = 0.0
        for ghost in ghosts:
            axis = cmath.rect(1.0, self.robot.heading) if ghost.axes == "robot" else 1.0
            self.strayed += complex(*ghost.by) * axis
            self.strayed_turn += ghost.turn

    def _new_pose(self, view: View) -> RigidBody:
        """Return the rigid body at its robot's pose, displaced by faults and with noise.

        The pose is converted to the coordinates of `view`.
        """
        robot = self.robot
        acting = self.acting
        away_mm = self.shift + self.strayed
        turned_away = self.turned + self.strayed_turn
        for jump in acting.of_kind("jump", robot.name):
            away_mm += complex(*jump.by)
        for slip in acting.of_kind("slip", robot.name):
            away_mm += complex(*slip.by) * cmath.rect(1.0, robot.heading)
            turned_away += slip.turn
        lifted = acting.newest("lifted", robot.name)
        draw = self.noise.random.gauss
        x = robot.x + away_mm.real + draw(0, self.noise.position_mm)
        y = robot.y + away_mm.imag + draw(0, self.noise.position_mm)
        body_heading = robot.heading + (turned_away - self.asset.offset)
        heading = body_heading + draw(0, self.noise.heading_rad)
        height = HEIGHT_MM if lifted is None else lifted.height
        return view.rigid_body_at(self.asset.number, x, y, heading, height)


def has_a_pose(body: RigidBody) -> bool:
    """Check whether the pose of a rigid body is valid.

    Its position must be finite, and the norm of its quaternion must be 1.
    """
    is_finite = all(math.isfinite(value) for value in body.position)
    return is_finite and abs(math.hypot(*body.quaternion) - 1.0) <= NORM_TOLERANCE


def rolled(body: RigidBody, angle: float) -> RigidBody:
    """Return a rigid body rotated about its own x axis by an angle [rad]."""
    sin = math.sin(angle / 2)
    cos = math.cos(angle / 2)
    x, y, z, w = body.quaternion  # times (sin, 0, 0, cos) from the right: its own x axis
    product = x * cos + w * sin, y * cos + z * sin, z * cos - y * sin, w * cos - x * sin
    return replace(body, quaternion=product)
