"""Robots modelled as discs of one radius: whether they touch anything, and how far away it is.

The functions answer three questions about N robots and O obstacles. Each wall of the arena counts
as an obstacle.

    enters            does a disc touch an obstacle or a disc along a path?
    enters_if_held    does it, if robots keep their present directions for some time?
    least_clearance   how far are discs from obstacles and from each other, at given positions?

Lengths are in the spec's unit. The margins that plans add to obstacles do not count here: see
`tetractl.control.search.margins`.
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
"""Moments at which `enters_if_held` predicts the robots, as fractions of the time.

It also tests the straight lines between the positions at these moments.
"""


def gaps(obstacles: Obstacles, x: Floats, y: Floats) -> Floats:
    """Compute the distances of P points to O obstacles, shape (O, P), negative inside.

    Args:
        obstacles: The obstacles and walls.
        x: x of the points, shape (P,).
        y: y of the points, shape (P,).
    """
    distances = np.empty((obstacles.count, len(x)))
    clearance.gaps(arrays_of(obstacles), x, y, distances)
    return distances


class Discs:
    """The bodies of robots, as discs of equal size, among obstacles and walls.

    Args:
        radius: Radius of each disc [length unit].
        shapes: The obstacles.
        walls: The walls of the arena. None if it has none.
    """

    def __init__(self, radius: float, shapes: Sequence[Shape], walls: Bounds | None) -> None:
        self._radius = radius
        self._obstacles = Obstacles.from_shapes(shapes, 0.0, walls)
        # a disc touches an obstacle where its centre is in the obstacle grown by the radius
        self._grown = arrays_of(Obstacles.from_shapes(shapes, radius, walls))

    def enters(self, path: Floats) -> bool:
        """Check whether any disc touches an obstacle or another disc along a path (M, N, 3).

        If a disc already touches an obstacle at the beginning, that counts only if the disc goes
        deeper.
        """
        return clearance.enters(self._grown, self._radius, path)

    def enters_if_held(self, problem: Problem, directions: Floats, seconds: float) -> bool:
        """Check whether any disc touches something if robots keep their directions for a time.

        Args:
            problem: The problem of the control step.
            directions: Direction of each robot [rad], shape (N,). NaN if a robot stands still.
            seconds: How long they keep them [s].
        """
        return self.enters(compiled_drive(problem, directions, seconds * HELD_MOMENTS))

    def least_clearance(self, x: Floats, y: Floats, separation: float) -> Floats:
        """Compute the minimum clearance of robots at given positions, shape (...).

        It is the minimum of all distances from a disc to an obstacle, which are negative inside,
        and of all distances between two centres minus the separation.

        Args:
            x: x of the robots, shape (..., N).
            y: y of the robots, shape (..., N).
            separation: Minimum distance between two robots [length unit].
        """
        to_each = gaps(self._obstacles, x.ravel(), y.ravel())
        to_obstacles = to_each.min(axis=0, initial=np.inf)
        nearest = to_obstacles.reshape(x.shape).min(axis=-1)
        i, k = np.triu_indices(x.shape[-1], 1)  # the pairs of robots
        between = elementwise.hypot(x[..., i] - x[..., k], y[..., i] - y[..., k])
        to_robots = between.min(axis=-1, initial=np.inf)
        return np.minimum(nearest - self._radius, to_robots - separation)
