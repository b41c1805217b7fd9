"""Check the paths of robots for contacts with obstacles and for small distances.

The check finds which robots' centres entered an obstacle, and the minimum distances to obstacles,
to the arena's edge and between robots.
"""

from dataclasses import astuple
from typing import Self

import numpy as np

from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Bounds, Setup
from tetractl.core.trial import Verdict

BLOCK_SAMPLES = 10_000
"""Maximum number of samples of a recorded path that are checked together."""
COMPARE_ALL_MAX = 100
"""Maximum number of samples for which comparing every sample with the obstacles is fastest."""
ROUNDING_FRACTION = 1e-9
"""Upper bound of the rounding error of a distance, as a fraction of the arena's coordinates."""


class PathCheck:
    """A check of N robots' paths for contacts with obstacles and for small distances.

    The paths are added in parts. Between two samples, a path is a straight line. Distances are in
    the spec's length unit, and arrays have shape (N,).

    Args:
        obstacles: The obstacles.
        arena: The arena.
        n_robots: Number of robots N.

    Attributes:
        entered: Whether the path of each robot touched an obstacle.
        clearance: Minimum distance of each robot's samples to an obstacle. Negative inside, inf
            without obstacles.
        edge: Minimum distance of each robot to the arena's edge. Negative outside.
        apart: Minimum distance of each robot to another robot. inf for a single robot.
    """

    def __init__(self, obstacles: Obstacles, arena: Bounds, n_robots: int) -> None:
        self.obstacles = obstacles
        self.arena = arena
        self.entered = np.zeros(n_robots, dtype=np.bool_)
        self.clearance = np.full(n_robots, np.inf)
        self.edge = np.full(n_robots, np.inf)
        self.apart = np.full(n_robots, np.inf)
        self._rounding_error_max = ROUNDING_FRACTION * max(map(abs, astuple(arena)))
        self._last_positions: tuple[Floats, Floats] | None = None

    @classmethod
    def for_setup(cls, setup: Setup) -> Self:
        """Create a check for the robots of an experiment, without any samples yet."""
        return cls(Obstacles.from_shapes(setup.obstacles), setup.arena, len(setup.names))

    def add(self, x: Floats, y: Floats, tracked: Bools | None = None) -> None:
        """Add M more positions of the robots, in the order of time.

        Args:
            x: x of the robots, shape (M, N). NaN where a position is unknown.
            y: y of the robots, like `x`.
            tracked: Whether each robot was tracked, shape (M, N). The position of an untracked
                robot is its last known position, and is not used for distances to other robots.
                None if all robots were tracked.
        """
        x = np.ascontiguousarray(x.T)  # (N, M): reduced 10x faster
        y = np.ascontiguousarray(y.T)
        tracked_x = x if tracked is None else np.where(tracked.T, x, np.nan)
        self.apart = np.minimum(self.apart, compute_separations(tracked_x, y))
        if self._last_positions is not None:
            last_x, last_y = self._last_positions
            x = np.hstack([last_x, x])
            y = np.hstack([last_y, y])
        self._last_positions = (x[:, -1:], y[:, -1:])
        edge_distances = self.arena.depth_inside(x, y)
        self.edge = np.fmin(self.edge, np.fmin.reduce(edge_distances, axis=1))
        if self.obstacles.count:
            self._update_obstacle_distances(x, y)

    def _update_obstacle_distances(self, x: Floats, y: Floats) -> None:
        """Update the distances to obstacles with more samples (N, M)."""
        is_any_sample = np.ones(x.shape, dtype=np.bool_)
        may_be_nearest = (
            self._find_nearest_candidates(x, y) if x.shape[1] > COMPARE_ALL_MAX else is_any_sample
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
        """Find the samples (N, M) that may be nearer to an obstacle than all samples so far.

        The last sample before a step that touches an obstacle is also found.

        `lower_bounds` are lower bounds of the samples' distances that take little time to compute.
        A sample is left out if its bound exceeds two values. The first value is the smallest
        distance found so far: the sample is then not the nearest sample. The second value is the
        longest step: the path from the sample to the next sample then touches no obstacle. Samples
        with NaN are left out.
        """
        lower_bounds = self.obstacles.distance_lower_bound(x, y)
        robots = np.arange(len(x))
        nearest_samples = np.where(np.isnan(lower_bounds), np.inf, lower_bounds).argmin(1)
        nearest_distances = self.obstacles.distance(
            x[robots, nearest_samples], y[robots, nearest_samples]
        )
        clearance = np.fmin(self.clearance, nearest_distances)  # an upper bound for the whole path
        step_max = _compute_longest_steps(x) + _compute_longest_steps(y)
        return lower_bounds <= (np.fmax(clearance, step_max) + self._rounding_error_max)[:, None]

    def verdict(self, final: Poses, not_at_rest: str = "") -> Verdict:
        """Create the verdict on the paths so far.

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


def _compute_longest_steps(coordinates: Floats) -> Floats:
    """Compute the maximum change of a coordinate (N, M) between successive samples, shape (N,).

    NaN samples are ignored.
    """
    return np.fmax.reduce(np.abs(np.diff(coordinates)), axis=1, initial=0.0)


def compute_separations(x: Floats, y: Floats) -> Floats:
    """Compute the minimum distance of each robot to another robot over all samples, shape (N,).

    x and y have shape (N, M) [length unit]. NaN samples are ignored. The result is inf for a
    single robot.
    """
    n_robots = len(x)
    min_separations = np.full(n_robots, np.inf)
    for i in range(n_robots - 1):
        squared_distances = np.square(x[i + 1 :] - x[i]) + np.square(y[i + 1 :] - y[i])
        nearest = np.sqrt(np.fmin.reduce(squared_distances, axis=1, initial=np.inf))
        min_separations[i + 1 :] = np.minimum(min_separations[i + 1 :], nearest)
        min_separations[i] = min(min_separations[i], nearest.min())
    return min_separations


def check_path(setup: Setup, path: Floats, tracked: Bools, final: Poses) -> Verdict:
    """Check the recorded paths of N robots for contacts with obstacles and for small distances.

    Args:
        setup: The constants of the experiment.
        path: The paths, shape (M, N, 2 or more). The first two values are x and y.
        tracked: Whether each robot was tracked, shape (M, N). Samples of untracked robots are
            ignored.
        final: The final poses of the robots.
    """
    path_check = PathCheck.for_setup(setup)
    for robot in range(path.shape[1]):
        samples = path[tracked[:, robot], robot]
        if len(samples):
            robot_check = PathCheck(path_check.obstacles, setup.arena, 1)
            for first_row in range(0, len(samples), BLOCK_SAMPLES):
                samples_block = samples[first_row : first_row + BLOCK_SAMPLES]
                robot_check.add(samples_block[:, :1], samples_block[:, 1:2])
            path_check.entered[robot] = robot_check.entered[0]
            path_check.clearance[robot] = robot_check.clearance[0]
            path_check.edge[robot] = robot_check.edge[0]
    path_check.apart = compute_tracked_separations(path, tracked)
    return path_check.verdict(final)


def compute_tracked_separations(path: Floats, tracked: Bools) -> Floats:
    """Compute the minimum distance (N,) of each robot to another robot in their recorded paths.

    Args:
        path: The paths, shape (M, N, 2 or more). The first two values are x and y.
        tracked: Whether each robot was tracked, shape (M, N). A distance counts only if both robots
            were tracked.
    """
    positions = np.where(tracked[..., None], path[..., :2], np.nan)
    return compute_separations(positions[..., 0].T, positions[..., 1].T)
