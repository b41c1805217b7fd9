"""Checks a path against the obstacles: which robots entered one, and how near each robot came."""

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.model.obstacles import Obstacles

BLOCK = 10_000  # samples of a recorded path that are checked at a time


class PathCheck:
    """The path of N robots, added sample by sample; between samples it is taken as straight.

    `entered` (N,) is True for robots whose path touched an obstacle; `clearance` (N,) is the least
    signed distance of each robot's samples to an obstacle [length unit], inf without obstacles.
    """

    def __init__(self, obstacles: Obstacles, count: int) -> None:
        self.obstacles = obstacles
        self.entered = np.zeros(count, dtype=np.bool_)
        self.clearance = np.full(count, np.inf)
        self._last: tuple[Floats, Floats] | None = None

    def add(self, x: Floats, y: Floats) -> None:
        """Add M further samples in time order; x, y of shape (M, N)."""
        if self._last is not None:
            x, y = np.vstack([self._last[0], x]), np.vstack([self._last[1], y])
        self._last = (x[-1], y[-1])
        self.entered |= self.obstacles.contain(x, y).any(axis=0)
        self.entered |= self.obstacles.cross(x[:-1], y[:-1], x[1:], y[1:]).any(axis=0)
        self.clearance = np.minimum(self.clearance, self.obstacles.distance(x, y).min(axis=0))


def check_path(obstacles: Obstacles, path: Floats, known: Bools) -> tuple[Bools, Floats]:
    """Return `entered` (N,) and `clearance` (N,) of `PathCheck` for a recorded path.

    `path` (M, N, 2 or more) begins with x and y; samples that are not `known` (M, N) are left out.
    """
    count = path.shape[1]
    entered, clearance = np.zeros(count, dtype=np.bool_), np.full(count, np.inf)
    for robot in range(count):
        samples = path[known[:, robot], robot]
        if len(samples):
            check = PathCheck(obstacles, 1)
            for begin in range(0, len(samples), BLOCK):
                block = samples[begin : begin + BLOCK]
                check.add(block[:, :1], block[:, 1:2])
            entered[robot], clearance[robot] = check.entered[0], check.clearance[0]
    return entered, clearance
