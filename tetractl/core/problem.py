"""The optimal control problem of one control step, as data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Shape


class Region(Protocol):
    """The obstacle region O of (13); its edge belongs to it. Lengths in the spec's unit."""

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point lies in the region, p(s) of (13)."""
        ...

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether each straight segment from (x0, y0) to (x1, y1) touches the region."""
        ...

    @property
    def shapes(self) -> Sequence[Shape]:
        """Return the shapes that make up the region as their union."""
        ...

    def packed(self) -> tuple[Any, ...]:
        """Return the shapes as compiled code takes them, one `PackedShapes` for each kind."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The problem of one control step for N robots; lengths in the spec's unit.

    targets (N, 2); a (N,) rad/s; speed (N,) length unit/s; `motion` names the model of the
    prediction. Signal j is held for `period` seconds, except the first, held for `first_period`.
    `obstacle_weight` is omega_p of (7). `swept` tests the segments between predicted positions
    instead of the positions alone. Two robots are to keep `separation` between their centres at the
    predicted positions; 0 for robots that may meet. `bias` (N,) [rad] is added to the direction
    that each robot turns towards, and `flow` (N, 2) [length unit/s] is the drift that carries it;
    None for no bias or flow. With `within`, the robots are to stay within that distance of their
    targets [length unit]. Problems are compared by identity, so that one can be the key of a cache.
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
    separation: float = 0.0
    bias: Floats | None = None
    flow: Floats | None = None
    within: float | None = None

    def only(self, some: Bools) -> "Problem":
        """Return the problem of the robots for which `some` (N,) is true."""
        if some.all():
            return self
        return replace(
            self,
            poses=Poses.of(self.poses.array()[some]),
            targets=self.targets[some],
            a=self.a[some],
            speed=self.speed[some],
            bias=None if self.bias is None else self.bias[some],
            flow=None if self.flow is None else self.flow[some],
        )

    @property
    def drift(self) -> Floats:
        """Return bias and flow as compiled code takes them, (4, N): cosine and sine, x and y."""
        none = np.zeros(len(self.a))
        bias = none if self.bias is None else self.bias
        flow = (none, none) if self.flow is None else self.flow.T
        return np.array([np.cos(bias), np.sin(bias), *flow])

    def seconds(self, length: int) -> float:
        """Return how long a sequence of the given number of signals is held [s]."""
        return self.first_period + (length - 1) * self.period
