"""Robots as discs of one radius: whether they touch something, and how far they are from it.

Three questions, about N robots and O obstacles, each wall of the arena being one:

    enters            does a disc touch something along a path?
    enters_if_held    does one, if robots follow the same directions for some time?
    least_clearance   how far are discs from obstacles and from each other, in some places?

Lengths are in the spec's unit. No margin counts here: see `tetractl.control.search.margins`.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.control.search.evaluate import compiled_drive
from tetractl.control.search.kernels import clearance
from tetractl.control.search.kernels.obstacles import arrays_of
from tetractl.core import elementwise
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape

HELD_MOMENTS = np.linspace(0, 1, 5)
"""Moments at which `enters_if_held` looks, as fractions of the time: it also tests the straight
lines between them."""


def gaps(obstacles: Obstacles, x: Floats, y: Floats) -> Floats:
    """Return the distance of each point x, y (P,) to each obstacle, (O, P), negative inside."""
    distances = np.empty((obstacles.count, len(x)))
    clearance.gaps(arrays_of(obstacles), x, y, distances)
    return distances


class Discs:
    """Discs of a `radius` among the `shapes` and, if given, the four walls of the arena."""

    def __init__(self, radius: float, shapes: Sequence[Shape], walls: Bounds | None) -> None:
        self._radius = radius
        self._obstacles = Obstacles.of(shapes, 0.0, walls)
        # a disc touches an obstacle where its centre is in the obstacle grown by the radius
        self._grown = arrays_of(Obstacles.of(shapes, radius, walls))

    def enters(self, path: Floats) -> bool:
        """Return whether a disc touches an obstacle or another disc on the way along path
        (M, N, 3), or goes deeper if it touches one at the beginning."""
        return clearance.enters(self._grown, self._radius, path)

    def enters_if_held(self, problem: Problem, directions: Floats, seconds: float) -> bool:
        """Return whether a disc touches something within `seconds`, in which robots follow their
        directions (N,) [rad], NaN for a robot that stands still."""
        return self.enters(compiled_drive(problem, directions, seconds * HELD_MOMENTS))

    def least_clearance(self, x: Floats, y: Floats, separation: float) -> Floats:
        """Return the least clearance (...) of robots at x, y (..., N): the least of all distances
        of a disc to an obstacle, negative inside, and of all distances of two centres minus the
        separation."""
        to_each = gaps(self._obstacles, x.ravel(), y.ravel())
        to_obstacles = to_each.min(axis=0, initial=np.inf)
        nearest = to_obstacles.reshape(x.shape).min(axis=-1)
        i, k = np.triu_indices(x.shape[-1], 1)  # the pairs of robots
        between = elementwise.hypot(x[..., i] - x[..., k], y[..., i] - y[..., k])
        to_robots = between.min(axis=-1, initial=np.inf)
        return np.minimum(nearest - self._radius, to_robots - separation)
