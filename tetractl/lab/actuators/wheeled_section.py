"""What sections of actuators of robots on two wheels say and take of calibration."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

from tetractl.core.errors import AbortError
from tetractl.core.setup import Setup
from tetractl.experiment.yaml.problems import Loc


class FoundWheel(NamedTuple):
    """A wheel's speed per output [mm/s], dead zone, and whether it turns backward at positive
    outputs."""

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

    def gains(self, unit_mm: float) -> dict[str, Any]:
        """Return r and the gains of wheels that are nominally driven at `unit_mm` [mm/s] per
        output; AbortError if they are swapped or inverted."""
        if self.swap or self.left.invert or self.right.invert:
            raise AbortError(
                "a wheel turns the wrong way, or the wheels are swapped",
                "change its motor's wires, or the robot's program",
            )
        gains = {"left_gain": self.left.gain_mm, "right_gain": self.right.gain_mm}
        in_outputs = {name: round(gain / unit_mm, 4) for name, gain in gains.items()}
        return {"radius_mm": self.radius_mm, **in_outputs}

    def __str__(self) -> str:
        return (
            f"r {self.radius_mm:.1f} mm, heading offset {self.heading_offset:+.3f} rad"
            f", left {self.left.gain_mm:.2f} mm/s per count above {self.left.dead_zone}"
            f", right {self.right.gain_mm:.2f} above {self.right.dead_zone}"
            f"{', swapped' if self.swap else ''}"
        )


def too_fast(setup: Setup, speed_max_mm_s: float) -> Iterator[tuple[Loc, str]]:
    """Yield, as a section's `contradictions`, that a robot is faster than its wheels are driven."""
    speeds = setup.speed * setup.metres * 1000
    if speeds.max() > speed_max_mm_s:
        name = setup.names[int(speeds.argmax())]
        yield ("speed_max_mm_s",), f"is below the speed of {name}, {speeds.max():g} mm/s"


def unknown_radii(setup: Setup, radii_mm: Iterable[float | None]) -> Iterator[tuple[Loc, str]]:
    """Yield, as a section's `contradictions`, the robots of which neither their entries, by the
    radii (N,), nor the spec says how far the wheels are from the centre."""
    if setup.wheel_radius is not None:
        return
    for i, radius_mm in enumerate(radii_mm):
        if radius_mm is None:
            message = "is missing; add it, or 'wheels: {radius: ..}' for all robots"
            yield ("robots", i, "radius_mm"), message


class CalibratedSection(Protocol):
    """The section of an actuator of robots on two wheels, for calibration."""

    dead_zone_max: ClassVar[int]
    """The largest dead zone that the section can state [outputs]."""

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Return the output for a 127th of full speed, and the largest output to a robot within
        `limit` of them."""
        ...

    def measured(self, calibrated: Found) -> dict[str, Any]:
        """Return a robot's fields in the section; AbortError if it cannot state what was found."""
        ...
