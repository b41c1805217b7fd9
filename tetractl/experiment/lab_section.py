"""The lab's part of a spec: a camera, an actuator, and what a run must not exceed.

The sections of cameras and actuators are in the files of their adapters, and named in
`tetractl.core.registries`. Lengths whose name ends in `_mm` are millimetres, whatever the spec's
length unit; times are seconds.
"""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, model_validator

from tetractl.core.clock import SECOND, Clock, MonotonicClock
from tetractl.core.errors import UsageError
from tetractl.core.protocols import Actuator, Camera
from tetractl.core.registries import ACTUATORS, CAMERAS
from tetractl.core.registry import imported
from tetractl.core.setup import Setup
from tetractl.experiment.base import Finite, Model, Name, NonNegative, Point, Positive, inconsistent
from tetractl.experiment.plant import PlantSection
from tetractl.experiment.registry_fields import KindSection
from tetractl.experiment.yaml.problems import Loc

STOPS = 10
STOP_GAP_NS = SECOND // 50  # ten stops over 200 ms


@dataclass(frozen=True, slots=True)
class Measured:
    """The result of a calibration: values that replace those in the lab's sections.

    `camera` and `actuator` are parts of those sections; entries of lists are found by their `name`.
    `lines` say the same in words.
    """

    camera: Mapping[str, Any] = field(default_factory=dict)
    actuator: Mapping[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()


class RobotPart(Model):
    """A robot's entry in the section of a device of the lab."""

    name: Name
    """Name of a robot of the spec."""


class DeviceSection(Model):
    """A device of the lab and its parameters."""

    device: ClassVar[str] = ""
    """The class of the device, as "module:class": imported if one is built."""
    type: Any  # each section's own name, as a Literal
    settles: ClassVar[bool] = False
    """Whether trials that choose their robots can use the device: it has a method `settle`."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield where the section contradicts the experiment or itself, and how.

        Places are within the section. A section with `robots` checks them by `mismatches`.
        """
        yield from ()

    def bounds(self) -> dict[str, str]:
        """Return the device's address and limits for display, {name: text}."""
        return {}


class CameraSection(DeviceSection):
    """A camera system and its parameters."""

    def build(self, setup: Setup, clock: Clock, wake: Callable[[], None]) -> Camera:
        """Return the camera of the setup's robots, in their order; nothing is opened.

        `wake` is called after each frame. AbortError if the camera's software is not installed.
        """
        return imported(self.device)(self, setup, clock, wake)

    def measured_by(self, first: Point, second: Point, um: float) -> Measured:
        """Return scale and rotation from two points of the picture, column and row [px], and their
        distance along the spec's x axis [um]; UsageError if they are too near."""
        raise UsageError(f"a camera of type {self.type} is not calibrated by a micrometer")

    def heading_offset(self, name: str) -> float:
        """Return what the camera adds to the heading it sees of a robot [rad]."""
        return 0.0


class ActuatorSection(DeviceSection):
    """An actuator and its parameters."""

    calibration: ClassVar[str] = ""
    """A function that does what `calibrate` says, as "module:function"; "" if there is none."""

    def require_port(self) -> None:
        """Raise AbortError if the device is not there; quick, nothing is opened."""

    def build(self, setup: Setup, clock: Clock) -> Actuator:
        """Return the actuator of the setup's robots, in their order; nothing is opened."""
        return imported(self.device)(self, setup, clock)

    def stop_all(self, setup: Setup, alone: bool = True) -> str:
        """Stop every robot in reach, latched if the actuator can; needs only its port. If not
        `alone`, a run has the port too. Returns what was done,
        in words; AbortError if nothing can be sent.
        """
        clock = MonotonicClock()
        with self.build(setup, clock) as actuator:
            for _ in range(STOPS):
                actuator.stop(emergency=True)
                clock.sleep_until(clock.now() + STOP_GAP_NS)
        return f"sent {STOPS} stops"

    def calibrate(
        self,
        lab: "LabSection",
        setup: Setup,
        names: Sequence[str],
        limit: int,
        emergency: threading.Event,
        report: Callable[[str], None],
    ) -> Measured:
        """Measure robots by moving them, one after another; AbortError says what cannot be.

        `limit` bounds what is sent, in the actuator's own unit. `report` is called with lines for
        people, `emergency` set stops the robots.
        """
        if not self.calibration:
            raise UsageError(f"an actuator of type {self.type} is not calibrated by moving robots")
        measure = imported(self.calibration)
        return measure(self, lab, setup, names, limit, emergency, report)


class LabLimits(Model):
    """What ends a run, and what it waits for. The defaults are those of the fault table."""

    stale: Positive = 0.1
    """All robots stop when no new frame came for this long [s]."""
    stream_lost: Positive = 0.5
    """The run aborts when no new frame came for this long [s]."""
    untracked_stop: Positive = 0.05
    """A robot stops when it was not tracked for this long [s]; if the actuator cannot hold one
    robot alone, it is steered on."""
    untracked_abort: Positive = 0.3
    """The run aborts when a robot was not tracked for this long [s]."""
    identity: Positive = 3.0
    """The run aborts when, after cells have met, it was unknown for this long which of them is a
    robot [s]; only with cameras that report it."""
    jump_mm: NonNegative = 30.0
    """A pose is rejected that is further from any of the last second than twice the robot's
    speed allows, plus this [mm]."""
    height_mm: tuple[Finite, Finite] = (-100.0, 500.0)
    """A body whose height above the floor is not between these two is rejected, as taken off its
    robot [mm]; the camera system's own zero is the floor. Only if the camera reports heights."""
    tilt: Positive = 0.5
    """A body whose upward axis is tilted by more than this from the vertical is rejected [rad]."""
    damaged_frames: int = Field(default=20, ge=1, le=100_000)
    """The run aborts on more damaged camera frames than this within a second."""
    edge_mm: NonNegative = 0.0
    """Robots stay this far inside the arena [mm]."""
    separation_mm: NonNegative = 110.0
    """Least distance between the centres of two robots [mm]; 0 disables the test."""
    reaction: NonNegative = 0.15
    """Time from detecting an edge or another robot to standing still [s], over which the guard
    predicts."""
    wheel_error: Annotated[float, Field(ge=0, le=1)] = 0.12
    """Largest error of a wheel's speed, as a fraction of the speed commanded: a robot that moves
    otherwise ends the run."""
    late_steps: int = Field(default=5, ge=1, le=100_000)
    """The run aborts after this many control steps in a row that missed their deadline."""
    latency: Positive = 0.1
    """A run does not start when frames are older than this on arrival [s]."""
    start_mm: Positive = 50.0
    """Largest distance from its start at which a robot may stand [mm]."""
    start_heading: Positive = 0.3
    """Largest difference from its start heading [rad]."""
    placing: NonNegative = 0.0
    """How long to wait for robots to be put on their starts [s]; with a terminal, as long as it
    takes."""
    standstill: Positive = 2.0
    """How long robots may take to be seen standing still after a stop [s]."""
    standstill_mm: Positive = 10.0
    """Speed below which a robot stands still [mm/s]."""

    @model_validator(mode="after")
    def _heights_in_order(self) -> Self:
        if self.height_mm[0] >= self.height_mm[1]:
            raise inconsistent("height_mm", "must be the lowest and the highest, in this order")
        return self


class LabSection(PlantSection):
    """Real robots in a real arena: a camera in, an actuator out."""

    simulated: ClassVar[bool] = False
    camera: Annotated[CameraSection, KindSection(CAMERAS)]
    """What tracks the robots."""
    actuator: Annotated[ActuatorSection, KindSection(ACTUATORS)]
    """What moves the robots."""
    limits: LabLimits = LabLimits()
    """What ends a run, and what it waits for."""
    calibration: str | None = Field(default=None, min_length=1, max_length=500)
    """A file written by `tetractl lab calibrate`, relative to the spec; its values replace those in
    `camera` and `actuator`."""

    def require_devices(self) -> None:
        """Raise AbortError if the actuator's port is not there."""
        self.actuator.require_port()

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the contradictions of both devices."""
        for device, section in (("camera", self.camera), ("actuator", self.actuator)):
            for loc, message in section.contradictions(setup):
                yield (device, *loc), message

    def bounds(self) -> dict[str, str]:
        """Return where the devices are and what stops a run."""
        limits = self.limits
        return {
            **self.camera.bounds(),
            **self.actuator.bounds(),
            "all robots stop": f"{limits.stale:g} s after the last camera frame",
            "a robot stops": f"{limits.untracked_stop:g} s after it was last tracked",
            "the trial aborts": (
                f"{limits.stream_lost:g} s after the last frame, {limits.untracked_abort:g} s "
                f"after a robot was last tracked, or {limits.late_steps} late control steps in "
                "a row"
            ),
        }


def mismatches(
    robots: Sequence[RobotPart], names: Sequence[str], unique: Sequence[str] = ()
) -> Iterator[tuple[Loc, str]]:
    """Yield where a device's `robots` are not those of the spec, once each, and how.

    `unique` are fields, besides the name, in which two robots must differ unless they are None.
    """
    for missing in sorted(set(names) - {robot.name for robot in robots}):
        yield ("robots",), f"has no {missing}; every robot of the spec must be here"
    taken: dict[tuple[str, object], int] = {}
    for i, robot in enumerate(robots):
        if robot.name not in names:
            yield ("robots", i, "name"), f"is no robot of the spec; those are {', '.join(names)}"
        for key in ("name", *unique):
            value = getattr(robot, key)
            if value is not None and (first := taken.setdefault((key, value), i)) != i:
                yield ("robots", i, key), f"is that of {robots[first].name}; must differ"
