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
        shift_mm: Displacement of the image [mm].
        scale: Scale factor of the image.
        turned_rad: Angle by which the image is rotated about the origin [rad].
    """

    up: UpAxis = UpAxis.Y
    origin: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    shift_mm: complex = 0j
    scale: float = 1.0
    turned_rad: float = 0.0

    def at_exposure(self, faults: Sequence[Any]) -> "View":
        """Compute the view at one exposure, as the acting faults transform it.

        Faults that creep change this view permanently with each exposure, like a slipping tripod.

        Args:
            faults: The acting faults of the kind `picture`.
        """
        for fault in faults:
            if fault.creeps:
                self._apply(fault)
        view = replace(self)
        for fault in faults:
            if not fault.creeps:
                view._apply(fault)
        return view

    def _apply(self, fault: Any) -> None:
        """Apply the transformation of a fault on top of the present transformation."""
        self.shift_mm += complex(*fault.by)
        self.scale *= fault.scale
        self.turned_rad += fault.turn

    def rigid_body_at(
        self, number: int, x: float, y: float, heading: float, height_mm: float
    ) -> RigidBody:
        """Create the tracked rigid body for a pose in the spec's axes.

        Args:
            number: Id of the rigid body.
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
            height_mm: Height above the floor [mm].
        """
        from_origin = complex(x, y) - complex(*self.origin)
        in_picture = from_origin * cmath.rect(self.scale, self.turned_rad) + self.shift_mm
        # the system's axes are the spec's turned by `rotation`, so coordinates turn by -rotation;
        # with y up, the system's z is the -y that it would have with z up
        floor_m = in_picture * cmath.rect(1e-3, -self.rotation)
        height_m = height_mm / 1000
        half_turn = cmath.rect(1.0, (heading + self.turned_rad - self.rotation) / 2)
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
        number: Id of the rigid body.
        name: Name of the rigid body.
        heading_offset: The robot's heading minus the rigid body's heading [rad].
        is_streamed: Whether the stream contains the poses of the rigid body.
    """

    number: int
    name: str
    heading_offset: float = 0.0
    is_streamed: bool = True


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
        noise: The noise of measured poses.
        acting: The faults that act now.
        shift_mm: Constant error of the measured position [mm].
        turned_rad: Constant error of the measured heading [rad].
        drift_mm: Error of the position that faults `ghost` have accumulated [mm].
        drift_rad: Error of the heading that faults `ghost` have accumulated [rad].
        exposures: Number of exposures so far.
        last_pose: The newest pose. None before the first exposure.
    """

    robot: Body
    asset: Asset
    noise: PoseNoise
    acting: ActingFaults = field(default_factory=ActingFaults)
    shift_mm: complex = 0j
    turned_rad: float = 0.0
    drift_mm: complex = 0j
    drift_rad: float = 0.0
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
            self._update_drift()
            self.last_pose = self._new_pose(view)
        body = replace(self.last_pose, id=self.asset.number)
        if not is_seen:
            return replace(body, tracking_valid=False)
        for fault in self.acting.of_kind("tipped", name):
            body = roll_body(body, fault.angle)
        if self.acting.of_kind("nan", name):
            body = replace(body, position=(math.nan, math.nan, math.nan))
        if self.acting.of_kind("bad_quaternion", name):
            x, y, z, w = body.quaternion
            body = replace(body, quaternion=(x / 2, y / 2, z / 2, w / 2))
        return body

    def _is_seen_now(self) -> bool:
        """Decide whether this frame shows the rigid body. A fault can make this random."""
        name = self.robot.name
        if self.acting.robots_are_carried or self.acting.of_kind("untracked", name):
            return False
        if any(self.exposures % fault.every for fault in self.acting.of_kind("half_tracked", name)):
            return False
        missing_share = self.acting.largest_share("half_tracked", name)
        return missing_share == 0 or self.noise.random.random() >= missing_share

    def _update_drift(self) -> None:
        """Accumulate the errors of the faults `ghost`, or reset them if no such fault acts."""
        ghosts = self.acting.of_kind("ghost", self.robot.name)
        if not ghosts:
            self.drift_mm = 0j
            self.drift_rad = 0.0
        for ghost in ghosts:
            axis = cmath.rect(1.0, self.robot.heading) if ghost.axes == "robot" else 1.0
            self.drift_mm += complex(*ghost.by) * axis
            self.drift_rad += ghost.turn

    def _new_pose(self, view: View) -> RigidBody:
        """Create the rigid body at its robot's pose, displaced by faults and noise, in a view."""
        robot = self.robot
        acting = self.acting
        displacement_mm = self.shift_mm + self.drift_mm
        turned_by_rad = self.turned_rad + self.drift_rad
        for jump in acting.of_kind("jump", robot.name):
            displacement_mm += complex(*jump.by)
        for slip in acting.of_kind("slip", robot.name):
            displacement_mm += complex(*slip.by) * cmath.rect(1.0, robot.heading)
            turned_by_rad += slip.turn
        lifted = acting.newest("lifted", robot.name)
        sample_gauss = self.noise.random.gauss
        x = robot.x + displacement_mm.real + sample_gauss(0, self.noise.position_mm)
        y = robot.y + displacement_mm.imag + sample_gauss(0, self.noise.position_mm)
        body_heading = robot.heading + (turned_by_rad - self.asset.heading_offset)
        heading = body_heading + sample_gauss(0, self.noise.heading_rad)
        height_mm = HEIGHT_MM if lifted is None else lifted.height
        return view.rigid_body_at(self.asset.number, x, y, heading, height_mm)


def has_valid_pose(body: RigidBody) -> bool:
    """Check whether the pose of a rigid body is valid.

    The position must be finite, and the norm of the quaternion must be 1.
    """
    is_finite = all(math.isfinite(value) for value in body.position)
    return is_finite and abs(math.hypot(*body.quaternion) - 1.0) <= NORM_TOLERANCE


def roll_body(body: RigidBody, angle: float) -> RigidBody:
    """Rotate a rigid body about its own x axis by an angle [rad]."""
    sin = math.sin(angle / 2)
    cos = math.cos(angle / 2)
    x, y, z, w = body.quaternion  # times (sin, 0, 0, cos) from the right: its own x axis
    product = x * cos + w * sin, y * cos + z * sin, z * cos - y * sin, w * cos - x * sin
    return replace(body, quaternion=product)
