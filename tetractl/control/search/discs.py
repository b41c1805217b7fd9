"""Robots modelled as discs of equal radius: tests for contact, and clearances.

The functions answer three questions about N robots and O obstacles. Each wall of the arena counts
as an obstacle.

    collide            does a disc touch an obstacle or another disc along a path?
    collide_if_held    does a disc touch anything if robots keep their directions for some time?
    min_clearance      how far are discs from obstacles and from each other, at given positions?

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

HELD_FRACTIONS = np.linspace(0, 1, 5)
"""Moments at which `collide_if_held` predicts the robots, as fractions of the held time.

The straight lines between the positions at these moments are tested, too.
"""


def distances_to_obstacles(obstacles: Obstacles, x: Floats, y: Floats) -> Floats:
    """Compute the distances of P points to O obstacles, shape (O, P), negative inside.

    Args:
        obstacles: The obstacles and walls.
        x: x of the points, shape (P,).
        y: y of the points, shape (P,).
    """
    distances = np.empty((obstacles.count, len(x)))
    clearance.distances_to_obstacles(arrays_of(obstacles), x, y, distances)
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
        self._grown_obstacles = arrays_of(Obstacles.from_shapes(shapes, radius, walls))

    def collide(self, path: Floats) -> bool:
        """Check whether any disc touches an obstacle or another disc along a path (M, N, 3).

        If a disc already touches an obstacle at the beginning, that counts only if the disc goes
        deeper.
        """
        return clearance.collide(self._grown_obstacles, self._radius, path)

    def collide_if_held(self, problem: Problem, directions: Floats, duration_s: float) -> bool:
        """Check whether any disc touches anything while robots keep their directions for a time.

        Args:
            problem: The problem of the control step.
            directions: Direction of each robot [rad], shape (N,). NaN if a robot stands still.
            duration_s: How long the robots keep their directions [s].
        """
        return self.collide(compiled_drive(problem, directions, duration_s * HELD_FRACTIONS))

    def min_clearance(self, x: Floats, y: Floats, separation: float) -> Floats:
        """Compute the minimum clearance of robots at given positions, shape (...).

        The clearance is the minimum of all distances from a disc to an obstacle, which are negative
        inside, and of all distances between two centres minus the separation.

        Args:
            x: x of the robots, shape (..., N).
            y: y of the robots, shape (..., N).
            separation: Minimum distance between two robots [length unit].
        """
        obstacle_distances = distances_to_obstacles(self._obstacles, x.ravel(), y.ravel())
        nearest_obstacle = obstacle_distances.min(axis=0, initial=np.inf)
        to_obstacles = nearest_obstacle.reshape(x.shape).min(axis=-1)
        i, k = np.triu_indices(x.shape[-1], 1)  # the pairs of robots
        pair_distances = elementwise.hypot(x[..., i] - x[..., k], y[..., i] - y[..., k])
        to_robots = pair_distances.min(axis=-1, initial=np.inf)
        return np.minimum(to_obstacles - self._radius, to_robots - separation)
