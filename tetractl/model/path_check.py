"""Check the paths of robots for contacts and small distances.

The check finds which centres entered an obstacle, and the minimum distances to obstacles, to the
arena's edge and between robots.
"""

from dataclasses import astuple
from typing import Self

import numpy as np

from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Bounds, Setup
from tetractl.core.trial import Verdict

SAMPLES_AT_A_TIME = 10_000
"""Number of samples of a recorded path that are checked at a time."""
COMPARE_ALL_MAX = 100
"""Maximum number of samples that are all compared with obstacles, which is faster for so few."""
ROUNDING = 1e-9
"""Upper bound of rounding errors of distances, as a fraction of the arena's coordinates."""


class PathCheck:
    """A check of the paths of N robots, which are added in parts and are straight between samples.

    Distances are in the spec's length unit, arrays have shape (N,).

    Args:
        obstacles: The obstacles.
        arena: The arena.
        count: Number of robots N.

    Attributes:
        entered: Whether the path of each robot touched an obstacle.
        clearance: Minimum distance of each robot's samples to an obstacle. Negative inside, inf
            without obstacles.
        edge: Minimum distance of each robot to the arena's edge. Negative outside.
        apart: Minimum distance of each robot to another robot. inf for a single robot.
    """

    def __init__(self, obstacles: Obstacles, arena: Bounds, count: int) -> None:
        self.obstacles = obstacles
        self.arena = arena
        self.entered = np.zeros(count, dtype=np.bool_)
        self.clearance = np.full(count, np.inf)
        self.edge = np.full(count, np.inf)
        self.apart = np.full(count, np.inf)
        self._slack = ROUNDING * max(map(abs, astuple(arena)))
        self._last: tuple[Floats, Floats] | None = None

    @classmethod
    def for_setup(cls, setup: Setup) -> Self:
        """Create a check for an experiment's robots, without any samples yet."""
        return cls(Obstacles.from_shapes(setup.obstacles), setup.arena, len(setup.names))

    def add(self, x: Floats, y: Floats, tracked: Bools | None = None) -> None:
        """Add M more positions of the robots, in the order of time.

        Args:
            x: x of the robots, shape (M, N). NaN where a position is unknown.
            y: y of the robots, like `x`.
            tracked: Whether each robot was tracked, shape (M, N). If not, its position is the last
                known one, and is not used for distances to other robots. None if all were tracked.
        """
        x = np.ascontiguousarray(x.T)  # (N, M): reduced 10x faster
        y = np.ascontiguousarray(y.T)
        tracked_x = x if tracked is None else np.where(tracked.T, x, np.nan)
        self.apart = np.minimum(self.apart, separations(tracked_x, y))
        if self._last is not None:
            last_x, last_y = self._last
            x = np.hstack([last_x, x])
            y = np.hstack([last_y, y])
        self._last = (x[:, -1:], y[:, -1:])
        edge_distances = self.arena.depth_inside(x, y)
        self.edge = np.fmin(self.edge, np.fmin.reduce(edge_distances, axis=1))
        if self.obstacles.count:
            self._update_obstacle_distances(x, y)

    def _update_obstacle_distances(self, x: Floats, y: Floats) -> None:
        """Update the distances to obstacles with more samples (N, M)."""
        every_sample = np.ones(x.shape, dtype=np.bool_)
        may_be_nearest = (
            self._find_nearest_candidates(x, y) if x.shape[1] > COMPARE_ALL_MAX else every_sample
        )
        robot, sample = may_be_nearest.nonzero()
        distances = self.obstacles.distance(x[robot, sample], y[robot, sample])
        np.fmin.at(self.clearance, robot, distances)
        self.entered[robot[distances <= 0]] = True
        robot, sample = may_be_nearest[:, :-1].nonzero()
        crosses = self.obstacles.meets_segments(
            x[robot, sample], y[robot, sample], x[robot, sample + 1], y[robot, sample + 1]
        )
        self.entered[robot[crosses]] = True

    def _find_nearest_candidates(self, x: Floats, y: Floats) -> Bools:
        """Find the samples (N, M) that may be the nearest to an obstacle so far.

        The last sample before a step that touches an obstacle also counts.

        `distance_min` is a lower bound of each sample's distance that takes little time to compute.
        A sample is left out if its bound exceeds two values: the smallest distance found so far,
        because the sample then is not the nearest one; and the longest step, because the path from
        the sample to the next one then touches no obstacle. Samples with NaN are left out.
        """
        distance_min = self.obstacles.distance_lower_bound(x, y)
        robots = np.arange(len(x))
        nearest = np.where(np.isnan(distance_min), np.inf, distance_min).argmin(1)
        distance = self.obstacles.distance(x[robots, nearest], y[robots, nearest])
        clearance = np.fmin(self.clearance, distance)  # an upper bound for the whole path
        step_max = _longest_step(x) + _longest_step(y)
        return distance_min <= (np.fmax(clearance, step_max) + self._slack)[:, None]

    def verdict(self, final: Poses, not_at_rest: str = "") -> Verdict:
        """Return the verdict on the path so far.

        Args:
            final: The final poses of the robots.
            not_at_rest: Describes robots that did not stand still at the end. Empty if all did.
        """
        return Verdict(
            final=final,
            entered=tuple(bool(entered) for entered in self.entered),
            clearance=tuple(self.clearance.tolist()),
            not_at_rest=not_at_rest,
            edge=tuple(self.edge.tolist()),
            apart=tuple(self.apart.tolist()),
        )


def _longest_step(coordinates: Floats) -> Floats:
    """Return the maximum change of a coordinate (N, M) between successive samples, (N,).

    NaN samples are ignored.
    """
    return np.fmax.reduce(np.abs(np.diff(coordinates)), axis=1, initial=0.0)


def separations(x: Floats, y: Floats) -> Floats:
    """Compute the minimum distance of each of N robots to another robot over M samples, (N,).

    x and y have shape (N, M) [length unit]. NaN samples are ignored. The result is inf for a
    single robot.
    """
    count = len(x)
    minima = np.full(count, np.inf)
    for i in range(count - 1):
        squared = np.square(x[i + 1 :] - x[i]) + np.square(y[i + 1 :] - y[i])
        nearest = np.sqrt(np.fmin.reduce(squared, axis=1, initial=np.inf))
        minima[i + 1 :] = np.minimum(minima[i + 1 :], nearest)
        minima[i] = min(minima[i], nearest.min())
    return minima


def check_path(setup: Setup, path: Floats, tracked: Bools, final: Poses) -> Verdict:
    """Check a recorded path for contacts with obstacles and edges, by a `PathCheck`.

    Args:
        setup: The constants of the experiment.
        path: The path, shape (M, N, 2 or more), beginning with x and y.
        tracked: Whether each robot was tracked, shape (M, N). Other samples are ignored.
        final: The poses in which the path ended.
    """
    path_check = PathCheck.for_setup(setup)
    for robot in range(path.shape[1]):
        samples = path[tracked[:, robot], robot]
        if len(samples):
            check = PathCheck(path_check.obstacles, setup.arena, 1)
            for start in range(0, len(samples), SAMPLES_AT_A_TIME):
                block = samples[start : start + SAMPLES_AT_A_TIME]
                check.add(block[:, :1], block[:, 1:2])
            path_check.entered[robot] = check.entered[0]
            path_check.clearance[robot] = check.clearance[0]
            path_check.edge[robot] = check.edge[0]
    path_check.apart = tracked_separations(path, tracked)
    return path_check.verdict(final)


def tracked_separations(path: Floats, tracked: Bools) -> Floats:
    """Compute the minimum distance (N,) of each robot to another robot in a recorded path.

    Args:
        path: The path, shape (M, N, 2 or more).
        tracked: Whether each robot was tracked, shape (M, N). Only samples for which both are
            tracked count.
    """
    positions = np.where(tracked[..., None], path[..., :2], np.nan)
    return separations(positions[..., 0].T, positions[..., 1].T)
