"""What calibration measures of a robot on two wheels, and how an actuator's section states it."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

from tetractl.core.errors import AbortError


class FoundWheel(NamedTuple):
    """What a calibration found about a wheel.

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
    """The measured values of one robot; see the fields of the same name in the spec."""

    heading_offset: float
    radius_mm: float
    left: FoundWheel
    right: FoundWheel
    swap: bool

    def __str__(self) -> str:
        return (
            f"r {self.radius_mm:.1f} mm, heading offset {self.heading_offset:+.3f} rad"
            f", left {self.left.gain_mm:.2f} mm/s per count above {self.left.dead_zone}"
            f", right {self.right.gain_mm:.2f} above {self.right.dead_zone}"
            f"{', swapped' if self.swap else ''}"
        )


def wheel_gains(calibrated: Found, unit_mm: float) -> dict[str, float]:
    """Return r and the gains of wheels that nominally drive at `unit_mm` [mm/s] per output.

    Raises:
        AbortError: If the wheels are swapped or inverted, which gains cannot express.
    """
    if calibrated.swap or calibrated.left.invert or calibrated.right.invert:
        raise AbortError(
            "a wheel turns the wrong way, or the wheels are swapped",
            "change its motor's wires, or the robot's program",
        )
    return {
        "radius_mm": calibrated.radius_mm,
        "left_gain": round(calibrated.left.gain_mm / unit_mm, 4),
        "right_gain": round(calibrated.right.gain_mm / unit_mm, 4),
    }


class CalibratedSection(Protocol):
    """What the section of an actuator must have so that its robots' wheels can be calibrated."""

    dead_zone_max: ClassVar[int]
    """The largest dead zone that the section can state [outputs]."""

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Return the output for a 127th of full speed, and the maximum output for a robot.

        Args:
            name: The robot.
            limit: Maximum speed, in 127ths of full speed.
        """
        ...

    def measured(self, calibrated: Found) -> dict[str, Any]:
        """Return a robot's fields in the section.

        Raises:
            AbortError: If the section cannot express what the calibration found.
        """
        ...
