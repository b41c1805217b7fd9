"""The rules of the guard: the limits of a lab, and the abilities of its robots."""

from dataclasses import dataclass
from typing import Self

from tetractl.core.clock import SECOND
from tetractl.core.poses import UNKNOWN_SIGHT, Sight
from tetractl.core.setup import MILLIMETRE_M, Bounds, Setup
from tetractl.core.shape import Shape
from tetractl.spec.lab_section import LabLimits

NOISE_MM = 2.0
"""Maximum error of a pose [mm], in addition to the error that the camera's section states."""
SILENCE_MIN_S = 0.5
"""Minimum time without a direction after which a run ends [s], however short the period."""


@dataclass(frozen=True, slots=True)
class GuardRules:
    """The spec's `limits`, and the properties of robots, arena and camera that the guard needs.

    Attributes:
        names: Names of the N robots.
        speeds: Their speeds [length unit/s].
        turning: Their maximum turning rates [rad/s].
        arena: The arena.
        limits: The limits in the spec.
        obstacles: The obstacles, each grown by the radius of a robot's body.
        mm_per_unit: Number of millimetres per length unit.
        silence_ns: Maximum time between two directions from the controller [ns].
        wheel_radius: Distance from a wheel to the centre [length unit]. 0 without wheels.
        may_lose_robots: Whether a run continues without a lost robot, until the last robot is lost.
        sight: How precisely the camera measures.
    """

    names: tuple[str, ...]
    speeds: tuple[float, ...]
    turning: tuple[float, ...]
    arena: Bounds
    limits: LabLimits
    obstacles: tuple[Shape, ...] = ()
    mm_per_unit: float = 1.0
    silence_ns: int = 2 * SECOND
    wheel_radius: float = 0.0
    may_lose_robots: bool = False
    sight: Sight = UNKNOWN_SIGHT

    @classmethod
    def from_setup(cls, setup: Setup, limits: LabLimits) -> Self:
        """Create the rules for a setup, with lengths in the spec's length unit."""
        per_mm = MILLIMETRE_M / setup.metres
        silence_s = setup.period_s * (limits.late_steps + 1)
        return cls(
            names=setup.names,
            speeds=tuple(setup.speed.tolist()),
            turning=tuple(setup.a.tolist()),
            arena=setup.arena,
            limits=limits,
            obstacles=tuple(shape.grown(setup.body_radius) for shape in setup.obstacles),
            mm_per_unit=1 / per_mm,
            silence_ns=round(max(silence_s, SILENCE_MIN_S) * SECOND),
            wheel_radius=setup.wheel_radius or 0.0,
            may_lose_robots=setup.loss is not None and not setup.loss.ends_trial,
            sight=setup.sight,
        )

    @property
    def position_error_max(self) -> float:
        """The maximum error of a position that the camera measures [length unit]."""
        return (NOISE_MM + self.sight.largest_error_mm) / self.mm_per_unit
