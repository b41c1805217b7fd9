"""The values that a calibration measures for a robot on two wheels, and their fields in a spec."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

from pydantic import Field

from tetractl.core.errors import AbortError
from tetractl.core.setup import Setup
from tetractl.spec.base import Positive
from tetractl.spec.lab_section import ActuatorSection, RobotPart, find_unknown_radii, too_fast
from tetractl.spec.yaml.problems import Loc


class FoundWheel(NamedTuple):
    """The values of one wheel that a calibration has found.

    Attributes:
        gain_mm: Speed per output [mm/s].
        dead_zone: Output up to which the wheel does not turn.
        invert: Whether the wheel turns backward at positive outputs.
    """

    gain_mm: float
    dead_zone: int
    invert: bool


@dataclass(frozen=True, slots=True)
class Found:
    """The values of one robot that a calibration has found, named like the fields of the spec."""

    heading_offset: float
    radius_mm: float
    left: FoundWheel
    right: FoundWheel
    swap: bool

    def __str__(self) -> str:
        return (
            f"radius {self.radius_mm:.1f} mm, heading offset {self.heading_offset:+.3f} rad"
            f", left wheel {self.left.gain_mm:.2f} mm/s per count above {self.left.dead_zone}"
            f", right wheel {self.right.gain_mm:.2f} mm/s per count above {self.right.dead_zone}"
            f"{', wheels swapped' if self.swap else ''}"
        )


def wheel_gains(calibrated: Found, unit_mm: float) -> dict[str, float]:
    """Convert a calibration to the fields of robots that receive wheel speeds.

    Args:
        calibrated: The values that the calibration found.
        unit_mm: Nominal speed of a wheel that receives 1 [mm/s].

    Returns:
        The wheel distance r, and the gains of both wheels relative to the nominal speed.

    Raises:
        AbortError: If the wheels are swapped or inverted, which gains cannot express.
    """
    if calibrated.swap or calibrated.left.invert or calibrated.right.invert:
        raise AbortError(
            "a wheel turns backwards, or the two wheels are swapped",
            "swap the wires of the motor, or correct the robot's program",
        )
    return {
        "radius_mm": calibrated.radius_mm,
        "left_gain": round(calibrated.left.gain_mm / unit_mm, 4),
        "right_gain": round(calibrated.right.gain_mm / unit_mm, 4),
    }


class CalibratedSection(Protocol):
    """Base class of the spec's fields for an actuator whose robots' wheels can be calibrated."""

    dead_zone_max: ClassVar[int]
    """Maximum dead zone that the section can state [outputs]. 0 if it has no such field."""

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Return the output for a 127th of full speed, and the maximum output for a robot.

        Args:
            name: Name of the robot.
            limit: Maximum speed to allow, in 127ths of full speed.
        """
        ...

    def measured(self, calibrated: Found) -> dict[str, Any]:
        """Convert the values that a calibration measured to a robot's fields of the spec.

        Raises:
            AbortError: If the section cannot express what the calibration found.
        """
        ...


class SpeedRobot(RobotPart):
    """One robot that receives wheel speeds, in the spec of the lab."""

    radius_mm: float | None = Field(default=None, gt=0, le=1000, allow_inf_nan=False)
    """Distance r from a wheel to its centre [mm], as in its program. Default: the spec's."""
    left_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the left wheel, divided by the speed that was sent to it."""
    right_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the right wheel, divided by the speed that was sent to it."""


class SpeedSection(ActuatorSection):
    """Base class of the spec's sections for robots on two wheels that receive wheel speeds."""

    calibration: ClassVar[str] = "tetractl.lab.calibrate:calibrate_robots"
    dead_zone_max: ClassVar[int] = 0
    unit_mm: ClassVar[float] = 1.0
    """Nominal speed of a wheel that receives the number 1 [mm/s]."""
    rate: float = Field(default=20.0, ge=10, le=200, allow_inf_nan=False)
    """Number of commands sent to each robot per second [Hz]."""
    delay: float = Field(default=0.01, ge=0, le=0.2, allow_inf_nan=False)
    """Time from sending a command until the wheels follow it [s]."""
    speed_max_mm_s: Positive = Field(default=400.0, le=5000)
    """Maximum wheel speed that is sent [mm/s]."""

    def wheel_contradictions(
        self, setup: Setup, robots: Iterable[SpeedRobot]
    ) -> Iterator[tuple[Loc, str]]:
        """Yield the field and message of each problem with the wheels' speeds and radii."""
        yield from too_fast(setup, self.speed_max_mm_s)
        yield from find_unknown_radii(setup, [robot.radius_mm for robot in robots])

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Return the output for a 127th of the maximum wheel speed, and for `limit` of these."""
        unit = self.speed_max_mm_s / self.unit_mm / 127
        return unit, int(unit * limit)

    def measured(self, calibrated: Found) -> dict[str, Any]:
        """Return a robot's wheel distance r and gains, as fields of the spec."""
        return wheel_gains(calibrated, self.unit_mm)
