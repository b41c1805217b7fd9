"""What the guard is given and what it returns: its states, rules and rulings."""

from dataclasses import dataclass
from enum import StrEnum

from tetractl.core.clock import SECOND
from tetractl.core.poses import UNSTATED, Pose, Sight
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.experiment.lab_section import LabLimits

NOISE_MM = 2.0
"""Largest error of a pose [mm], in addition to that which the camera's section states."""


class GuardState(StrEnum):
    """The guard's states."""

    PREFLIGHT = "preflight"
    READY = "ready"
    RUN = "run"
    HOLD = "hold"
    ABORT = "abort"


@dataclass(frozen=True, slots=True)
class GuardRules:
    """The spec's `limits`, and the properties of robots and arena that the guard needs.

    `speeds` (N,) are the robots' speeds [length unit/s], `turning` (N,) the greatest turning rates
    [rad/s]; `mm` is the number of millimetres per length unit. A run that `goes_on` continues
    without a lost robot, and ends when the last robot is lost. `sight` is what the camera can see.
    """

    names: tuple[str, ...]
    speeds: tuple[float, ...]
    turning: tuple[float, ...]
    arena: Bounds
    limits: LabLimits
    obstacles: tuple[Shape, ...] = ()  # each grown by the radius of a body
    mm: float = 1.0
    silence_ns: int = 2 * SECOND  # longest time between two directions from the controller
    wheel_radius: float = 0.0  # 0 for robots without wheels
    goes_on: bool = False
    sight: Sight = UNSTATED

    @property
    def largest_error(self) -> float:
        """The largest error of a position [length unit]."""
        return (NOISE_MM + self.sight.largest[0]) / self.mm


@dataclass(frozen=True, slots=True)
class Ruling:
    """The decision of a tick: which robots may move, `moving` (N,), and the accepted `poses` (N,).

    A pose is None if the robot is not tracked. `reason` is why the run was aborted, "" otherwise.
    """

    state: GuardState
    moving: tuple[bool, ...]
    poses: tuple[Pose | None, ...]
    reason: str = ""
    warnings: tuple[str, ...] = ()
