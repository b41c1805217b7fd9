"""Checks the robots' paths: which centres entered an obstacle, and the least distances to
obstacles, to the arena's edge and between robots.
"""

from typing import Self

import numpy as np

from tetractl.core.commands import Verdict
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Bounds, Setup
from tetractl.model.obstacles import Obstacles

BLOCK = 10_000  # number of samples of a recorded path that are checked at a time


class PathCheck:
    """Checks the paths of N robots, which are added in parts and are straight between samples.

    `entered` (N,) is True for robots whose path touched an obstacle; `clearance` (N,) is the least
    signed distance of each robot's samples to an obstacle [length unit], inf without obstacles.
    `edge` (N,) is each robot's least signed distance to the arena's edge, negative outside, and
    `apart` (N,) its least distance to another robot, inf for a single robot.
    """

    def __init__(self, obstacles: Obstacles, arena: Bounds, count: int) -> None:
        self.obstacles, self.arena = obstacles, arena
        self.entered = np.zeros(count, dtype=np.bool_)
        self.clearance = np.full(count, np.inf)
        self.edge = np.full(count, np.inf)
        self.apart = np.full(count, np.inf)
        self._last: tuple[Floats, Floats] | None = None

    @classmethod
    def of(cls, setup: Setup) -> Self:
        """Return an empty check for an experiment's robots."""
        return cls(Obstacles.of(setup.obstacles), setup.arena, len(setup.names))

    def add(self, x: Floats, y: Floats, known: Bools | None = None) -> None:
        """Add M further samples in time order; x, y (M, N), NaN where a position is unknown. Where
        `known` (M, N) is False, the position is the last known one, from which no distance to
        another robot follows.
        """
        seen = x if known is None else np.where(known, x, np.nan)
        self.apart = np.minimum(self.apart, separations(seen.T, y.T))
        if self._last is not None:
            x, y = np.vstack([self._last[0], x]), np.vstack([self._last[1], y])
        self._last = (x[-1], y[-1])
        x, y = (np.ascontiguousarray(column.T) for column in (x, y))  # (N, M): reduced 10x faster
        before, after = (x[:, :-1], y[:, :-1]), (x[:, 1:], y[:, 1:])
        gaps = self.obstacles.distance(x, y)
        self.entered |= (gaps <= 0).any(axis=1)
        self.entered |= self.obstacles.cross(*before, *after).any(axis=1)
        self.clearance = np.fmin(self.clearance, _least(gaps))
        self.edge = np.fmin(self.edge, _least(self.arena.inside(x, y)))

    def verdict(self, final: Poses, not_at_rest: str = "") -> Verdict:
        """Return the verdict on the path so far, with the final poses `final`."""
        return Verdict(
            final,
            tuple(bool(entered) for entered in self.entered),
            tuple(self.clearance.tolist()),
            not_at_rest,
            tuple(self.edge.tolist()),
            tuple(self.apart.tolist()),
        )


def _least(each: Floats) -> Floats:
    return np.fmin.reduce(each, axis=1)


def separations(x: Floats, y: Floats) -> Floats:
    """Return the least distance of each of N robots to another robot over M samples, (N,).

    x, y are (N, M) [length unit]; NaN samples are ignored.
    """
    count = len(x)
    apart = np.full(count, np.inf)
    for i in range(count - 1):
        squared = (x[i + 1 :] - x[i]) ** 2 + (y[i + 1 :] - y[i]) ** 2
        nearest = np.sqrt(np.fmin.reduce(squared, axis=1, initial=np.inf))
        apart[i + 1 :] = np.minimum(apart[i + 1 :], nearest)
        apart[i] = min(apart[i], nearest.min())
    return apart


def check_path(setup: Setup, path: Floats, known: Bools, final: Poses) -> Verdict:
    """Return the verdict of `PathCheck` on a recorded path which ended in `final`.

    `path` (M, N, 2 or more) begins with x and y; samples for which `known` (M, N) is False
    are ignored.
    """
    whole = PathCheck.of(setup)
    for robot in range(path.shape[1]):
        samples = path[known[:, robot], robot]
        if len(samples):
            check = PathCheck(whole.obstacles, setup.arena, 1)
            for begin in range(0, len(samples), BLOCK):
                block = samples[begin : begin + BLOCK]
                check.add(block[:, :1], block[:, 1:2])
            whole.entered[robot], whole.clearance[robot] = check.entered[0], check.clearance[0]
            whole.edge[robot] = check.edge[0]
    seen = np.where(known[..., None], path[..., :2], np.nan)
    whole.apart = separations(seen[..., 0].T, seen[..., 1].T)
    return whole.verdict(final)
