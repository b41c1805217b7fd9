"""The part `lab` of a spec: a camera, an actuator, and the limits of a run.

The section of each camera or actuator is in the file of its adapter, and registered in
`tetractl.core.registries`. Lengths with a name that ends in `_mm` are in millimetres, whatever the
spec's length unit is. Times are in seconds.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import Field, model_validator

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import UsageError
from tetractl.core.poses import UNKNOWN_SIGHT, Sight
from tetractl.core.protocols import Actuator, Camera
from tetractl.core.registries import ACTUATORS, CAMERAS
from tetractl.core.setup import Setup
from tetractl.spec.base import (
    Finite,
    Model,
    Name,
    NonNegative,
    Positive,
    PositiveAngle,
    inconsistent,
)
from tetractl.spec.plant import Microscope, PlantSection
from tetractl.spec.registry_fields import KindSection
from tetractl.spec.yaml.problems import Loc

UNTRACKED_STOP_S = 0.05
"""Time without tracking after which a robot is stopped [s].

It does not apply if the actuator cannot hold a single robot still.
"""
STANDSTILL_MM_S = 10.0
"""Speed below which a robot counts as standing still [mm/s]."""
REACTION_S = 0.15
"""Time for which the guard predicts motion, unless the limits say otherwise [s]."""
STOP_COUNT = 10
"""Number of stops that are sent one after another, because some may be lost."""
STOP_GAP_NS = SECOND // 50
"""Time between two of these stops [ns]."""


@dataclass(frozen=True, slots=True)
class Measured:
    """The result of a calibration: values that replace values in the lab's sections.

    Attributes:
        camera: New values for keys of the section `lab.camera`. An entry of a list is found by its
            `name`.
        actuator: New values for keys of the section `lab.actuator`, like `camera`.
        lines: A summary for readers.
        emulated: Names of the devices that were not real.
    """

    camera: Mapping[str, Any] = field(default_factory=dict)
    actuator: Mapping[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    emulated: tuple[str, ...] = ()


class RobotPart(Model):
    """One robot, in the part of the spec for a device of the lab."""

    name: Name
    """Name of a robot of the spec."""


class DeviceSection(Model):
    """Base class of the sections of the spec that describe a device of the lab."""

    device: ClassVar[str] = ""
    """The class of the device, as "module:class": imported only when the device is built."""
    type: Any  # the section's name, a Literal in each subclass
    settles: ClassVar[bool] = False
    """Whether the device has the method `settle`, which trials that choose their robots need."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield each field of the device that contradicts another field, with a message.

        Locations are relative to this section. If the section has `robots`, `mismatches` checks
        them.
        """
        yield from ()

    def bounds(self) -> dict[str, str]:
        """Describe the device's address and limits for display, as {name: text}.

        Empty by default.
        """
        return {}


class CameraSection(DeviceSection):
    """The section of the spec for the lab's camera system, with its parameters."""

    def build(self, setup: Setup, clock: Clock, wake: Callable[[], None]) -> Camera:
        """Create the camera for the setup's robots, in their order, without opening it.

        Args:
            setup: The constants of the experiment.
            clock: The clock of the run.
            wake: Called after each frame.

        Raises:
            AbortError: If the camera's software is not installed.
        """
        return resolve_name(self.device)(self, setup, clock, wake)

    @property
    def sight(self) -> Sight:
        """The precision and the frame rate of the camera. By default, they are unknown."""
        return UNKNOWN_SIGHT

    def heading_offset(self, name: str) -> float | None:
        """Return the angle that the camera adds to a robot's measured heading [rad].

        None if the section has no such angle, which is the default.
        """
        return None


class ActuatorSection(DeviceSection):
    """The section of the spec for the lab's actuator, which sends commands to the robots."""

    calibration: ClassVar[str] = ""
    """The function that implements `calibrate`, as "module:function". Empty if there is none."""
    checks: ClassVar[str] = "tetractl.lab.guard_checks:robot_checks"
    """The function that creates the guard's checks of the robots, as "module:function"."""
    stopping: ClassVar[str] = "tetractl.lab.stop_all:stop_all"
    """The function that implements `stop_all`, as "module:function"."""

    def beside(self, camera: CameraSection) -> Iterator[tuple[Loc, str]]:
        """Yield each contradiction between this actuator and the lab's camera, with a message.

        Locations are relative to the actuator's section. By default, there are no contradictions.
        """
        yield from ()

    def require_port(self) -> None:
        """Raise AbortError if the device's port does not exist. No device is opened.

        By default, nothing is checked, because a device need not have a port.
        """

    def build(self, setup: Setup, clock: Clock) -> Actuator:
        """Create the actuator for the setup's robots, in their order, without opening it.

        The class is imported only now.
        """
        return resolve_name(self.device)(self, setup, clock)

    def stop_all(self, setup: Setup, clock: Clock, alone: bool = True) -> str:
        """Stop every robot that the actuator reaches, with a latched stop if it has one.

        Only the actuator's port is needed.

        Args:
            setup: The names of the robots.
            clock: The clock for timeouts.
            alone: False if a run uses the port at the same time.

        Returns:
            A description of the stops that were sent.

        Raises:
            AbortError: If a stop could not be sent to all robots.
        """
        return resolve_name(self.stopping)(self, setup, clock, alone)

    def calibrate(
        self,
        lab: "LabSection",
        make_rig: Callable[["LabLimits", Setup], Any],
        setup: Setup,
        names: Sequence[str],
        limit: int,
        report: Callable[[str], None],
    ) -> Measured:
        """Calibrate robots, by moving one after another in small motions.

        Args:
            lab: The lab.
            make_rig: Returns the `Rig` of the lab for a setup with other limits.
            setup: The constants of the experiment.
            names: The robots to calibrate.
            limit: Maximum output, in 127ths of full speed.
            report: Called with lines for the operator.

        Raises:
            AbortError: If the calibration fails.
            UsageError: If this actuator cannot be calibrated by moving robots.
        """
        if not self.calibration:
            raise UsageError(
                f"an actuator of type {self.type} cannot be calibrated by moving robots"
            )
        measure = resolve_name(self.calibration)
        return measure(self, lab, make_rig, setup, names, limit, report)


class LabLimits(Model):
    """Limits that stop robots or end a run, and waiting times of a run.

    The fault table assumes the defaults.
    """

    stale: Positive = 0.1
    """All robots stop after this time without a new frame [s]."""
    stream_lost: Positive = 0.5
    """The run aborts after this time without a new frame [s]."""
    untracked_abort: Positive = 0.3
    """A robot is lost if it is untracked for this time [s], or is seen too rarely.

    The run then aborts, unless `on_lost` says otherwise.
    """
    identity: Positive = 3.0
    """A cell is lost if it has met another cell, and the camera could not tell them apart for this
    time [s]. The run then aborts, unless `on_lost` says otherwise. Only for cameras that report
    identities.
    """
    jump_mm: NonNegative = 30.0
    """A pose is rejected if it is too far from an accepted pose of the last second: further than
    the robot drives in that time at twice its speed, plus this length [mm].
    """
    height_mm: tuple[Finite, Finite] = (-100.0, 500.0)
    """Minimum and maximum height of a body above the camera system's zero, the floor [mm].

    A body outside this range is rejected, because it may have come off its robot. During a run, a
    body is also rejected if it is more than 40 mm above or below its height at the start. Only for
    cameras that report heights.
    """
    tilt: PositiveAngle = 0.5
    """Maximum tilt of a body's upward axis from the vertical [rad].

    A body with a larger tilt is rejected.
    """
    separation_mm: NonNegative = 110.0
    """Minimum distance between the centres of two robots [mm]. 0 disables the test."""
    reaction: NonNegative = REACTION_S
    """Time from detecting an edge, an obstacle or another robot until a robot stands still [s].

    The guard predicts the motion over this time.
    """
    wheel_error: Annotated[float, Field(ge=0, le=1)] = 0.12
    """Maximum error of a wheel's speed, as a fraction of the commanded speed.

    A larger error ends the run.
    """
    delay: float = Field(default=0.3, gt=0, le=1)
    """Longest time after which a robot obeys a command [s]: by the radio, by wheels that speed up
    slowly, and by lost commands. With more, a pose that moves against the commands is noticed
    later.
    """
    drift: Positive = 16.0
    """The drift check's statistic at which a pose counts as false: good trials of the emulated lab
    reach 13. With more, a pose that leaves its robot slowly is noticed later.
    """
    observe: bool = False
    """Let the guard's checks of motion and drift only report what they would have done, as
    warnings, and stop no robot: for tuning `wheel_error`, `delay` and `drift` on a lab's own runs.
    Without these checks no false pose and no robot that disobeys is noticed, so keep the emergency
    stop at hand.
    """
    late_steps: int = Field(default=5, ge=1, le=100_000)
    """The run aborts after this many control steps in a row that missed their deadline."""
    latency: Positive = 0.1
    """A run does not start if frames are older than this on arrival [s]."""
    start_mm: Positive = 50.0
    """Maximum distance from its start at which a robot may stand when a run starts [mm]."""
    start_heading: PositiveAngle = 0.3
    """Maximum difference of a robot's heading from its start heading when a run starts [rad]."""
    placing: NonNegative = 0.0
    """Maximum time to wait for robots to be put on their starts [s], at least 1 s.

    There is no limit if a person starts the run in a terminal without `--yes`.
    """

    @model_validator(mode="after")
    def _heights_in_order(self) -> Self:
        if self.height_mm[0] >= self.height_mm[1]:
            raise inconsistent("height_mm", "must be two heights, with the lower one first")
        return self


class LabSection(PlantSection):
    """A lab with real robots: a camera, an actuator and limits."""

    simulated: ClassVar[bool] = False
    camera: Annotated[CameraSection, KindSection(CAMERAS, CameraSection)]
    """The camera system that tracks the robots."""
    actuator: Annotated[ActuatorSection, KindSection(ACTUATORS, ActuatorSection)]
    """The actuator that moves the robots."""
    limits: LabLimits = LabLimits()
    """Limits that stop robots or end a run, and waiting times of a run."""
    calibration: str | None = Field(default=None, min_length=1, max_length=500)
    """File written by `tetractl lab calibrate` or `tetractl lab survey --micrometer`, relative to
    the spec. Its values replace values in `camera` and `actuator`.
    """
    lag: NonNegative | None = None
    """Time constant with which the wheels of real and emulated robots follow a command [s].

    Default: `wheels.lag`, which also applies to simulations.
    """

    def with_files(self, folder: Path | None) -> Self:
        """Return the lab with the contents of the files that its fields refer to.

        Args:
            folder: The folder that file names are relative to. None if the spec comes from no file.
        """
        return self

    @property
    def microscope(self) -> Microscope | None:
        """The camera, if its images have a known scale and position. Otherwise None."""
        return self.camera if isinstance(self.camera, Microscope) else None

    @property
    def sight(self) -> Sight:
        """The precision and the frame rate of the lab's camera."""
        return self.camera.sight

    def require_devices(self) -> None:
        """Raise AbortError if the actuator's port does not exist. No device is opened."""
        self.actuator.require_port()

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield each field of the lab that contradicts another field, with a message.

        Each device checks its own section, and the actuator also compares itself with the camera. A
        lag is refused for robots without wheels. Locations are relative to the lab's section.
        """
        for device, section in (("camera", self.camera), ("actuator", self.actuator)):
            for loc, message in section.contradictions(setup):
                yield (device, *loc), message
        for loc, message in self.actuator.beside(self.camera):
            yield ("actuator", *loc), message
        if self.lag is not None and not setup.on_wheels:
            yield ("lag",), "is for robots on wheels, but the spec has no `wheels`"

    def bounds(self) -> dict[str, str]:
        """Describe the devices' addresses and the run's limits for display, as {name: text}."""
        limits = self.limits
        return {
            **self.camera.bounds(),
            **self.actuator.bounds(),
            "all robots stop": f"{limits.stale:g} s after the last camera frame",
            "a robot stops": f"{UNTRACKED_STOP_S:g} s after the robot was last tracked",
            "the trial aborts": (
                f"{limits.stream_lost:g} s after the last frame, {limits.untracked_abort:g} s "
                f"after a robot was last tracked, or {limits.late_steps} late control steps in "
                "a row"
            ),
            **({"motion and drift checks": "only report"} if limits.observe else {}),
        }


Part = TypeVar("Part", bound=RobotPart)


def entry(robots: Sequence[Part], name: str) -> Part:
    """Return a robot's entry in the section of a device.

    The entry must exist. `mismatches` checks this.
    """
    return next(robot for robot in robots if robot.name == name)


def mismatches(
    robots: Sequence[RobotPart], names: Sequence[str], unique: Sequence[str] = ()
) -> Iterator[tuple[Loc, str]]:
    """Find mismatches between the `robots` of a device and the robots of the spec.

    Args:
        robots: The entries of the device's section.
        names: The names of the spec's robots.
        unique: Further fields in which two robots must differ, unless the value is None.

    Yields:
        The location and text of each mismatch.
    """
    for missing in sorted(set(names) - {robot.name for robot in robots}):
        yield ("robots",), f"has no entry for {missing}; list every robot of the spec"
    index_by_value: dict[tuple[str, object], int] = {}
    for i, robot in enumerate(robots):
        if robot.name not in names:
            yield (
                ("robots", i, "name"),
                f"is not a robot of the spec, whose robots are {', '.join(names)}",
            )
        for key in ("name", *unique):
            value = dict(robot)[key]
            if value is None:
                continue
            earlier_index = index_by_value.setdefault((key, value), i)
            if earlier_index != i:
                yield (
                    ("robots", i, key),
                    f"is also the value of {robots[earlier_index].name}; the values must differ",
                )


def too_fast(setup: Setup, speed_max_mm_s: float) -> Iterator[tuple[Loc, str]]:
    """Yield a contradiction if the fastest robot exceeds the maximum speed [mm/s].

    The speeds of the spec are converted to mm/s. A speed equal to the maximum is allowed.
    """
    speeds = setup.speed * setup.metres * 1000
    if speeds.max() > speed_max_mm_s:
        name = setup.names[int(speeds.argmax())]
        yield ("speed_max_mm_s",), f"is below the speed of {name}, which is {speeds.max():g} mm/s"


def find_unknown_radii(setup: Setup, radii_mm: Iterable[float | None]) -> Iterator[tuple[Loc, str]]:
    """Find robots whose distance from the wheels to the centre is missing in the spec.

    Args:
        setup: The constants of the experiment, which may state one radius for all robots.
        radii_mm: The radius in each robot's entry [mm], N entries. None if the entry has none.

    Yields:
        Location and text of each problem, in the form of `contradictions`.
    """
    if setup.on_wheels:
        return
    for i, radius_mm in enumerate(radii_mm):
        if radius_mm is None:
            message = "is missing; add it, or add 'wheels: {radius: ..}' for all robots"
            yield ("robots", i, "radius_mm"), message
