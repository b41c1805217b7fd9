"""Checks a path against the obstacles: which robots were ever inside one, and how near they came.
"""

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.obstacles import Obstacles


class PathCheck:
    """Checks positions of N robots as they come; between two samples, the segment is tested.

    `entered` (N,) tells which robots ever touched an obstacle, `clearance` (N,) is each one's least
    distance to one at the samples [length unit], inf without obstacles.
    """

    def __init__(self, obstacles: Obstacles, count: int) -> None:
        self.obstacles = obstacles
        self.entered = np.zeros(count, dtype=np.bool_)
        self.clearance = np.full(count, np.inf)
        self._last: tuple[Floats, Floats] | None = None

    def add(self, x: Floats, y: Floats) -> None:
        """Check M further samples in time order; x, y of shape (M, N)."""
        if self._last is not None:
            x, y = np.vstack([self._last[0], x]), np.vstack([self._last[1], y])
        self._last = (x[-1], y[-1])
        self.entered |= self.obstacles.contain(x, y).any(axis=0)
        self.entered |= self.obstacles.cross(x[:-1], y[:-1], x[1:], y[1:]).any(axis=0)
        self.clearance = np.minimum(self.clearance, self.obstacles.distance(x, y).min(axis=0))
