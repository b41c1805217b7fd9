"""The optimal control problem of one control step, as data."""

from dataclasses import dataclass
from typing import Protocol

from tetractl.core.poses import Bools, Floats, Poses


class Region(Protocol):
    """The obstacle region O of (13); its edge belongs to it. Lengths in the spec's unit."""

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point lies in the region, p(s) of (13)."""
        ...

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether each straight segment from (x0, y0) to (x1, y1) touches the region."""
        ...

    @property
    def rectangles(self) -> Floats:
        """Left, bottom, right, top of each rectangle, (R, 4)."""
        ...

    @property
    def circles(self) -> Floats:
        """Centre x, y and radius of each circle, (C, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class Problem:
    """What one control step has to solve for N robots; lengths in the spec's unit.

    targets (N, 2); a (N,) rad/s; speed (N,) length unit/s; `motion` names the model of the
    prediction. Signal j is held for `period` seconds, except the first, held for `first_period`.
    `obstacle_weight` is omega_p of (7). `swept` tests the segments between predicted positions
    instead of the positions alone.
    """

    poses: Poses
    targets: Floats
    a: Floats
    speed: Floats
    motion: str
    period: float
    first_period: float
    obstacles: Region
    obstacle_weight: float
    swept: bool
