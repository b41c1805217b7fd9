"""Safety distances of a plan: the margin to each obstacle, and the separation between robots.

Robots deviate from a plan because some commands are lost, and because the robots' speeds and other
parameters are only known with some uncertainty. While a robot follows a command, it leaves its
course by at most (`max_deviation`)

    off = lost + min(a T, 1) v (l + N_SIGMAS sigma_l)
          + N_SIGMAS (v sigma_tau + (v sigma_a / a + sigma_v) (T + tau))

    v    speed [length unit/s]             T    time for which a command is followed [s]
    a    turning rate [rad/s], above 0     tau  dead time: from a command to its effect [s]
    r    radius of a robot [length unit]   l    lag of the wheels [s], 0 if there is none
    lost deviation after a lost command    (`near_targets.lost_command_deviation`)
    sigma_v, sigma_a, sigma_tau, sigma_l   standard deviations

The second term accounts for wheels that respond with a lag. After a lost command, such wheels still
follow the wrong turn: the heading is wrong by up to a T over a distance of v l, so the robot leaves
its course by no more than this distance.

With off, the largest such deviation of any robot, a plan should keep (`Margins.apply`)

    full margin m       = collision.margin + r + off    between a centre and an obstacle or wall
    full separation s   = collision.separation + 2 off  between two centres; 0 if robots may meet

Where robots or targets are already closer than that, no plan could keep it. There, less is kept:

    fit(m, g)           = m if it is less than the gap g, else GAP_FRACTION max(g, 0)
    margin of obstacle  = max(fit(m, g), fit(r, g_target))      fit(r, ...) <= r <= m
    separation          = min(s, max(GAP_FRACTION d, min(2 r, d)))

    g_target  gap between the obstacle and the target nearest to it [length unit], negative inside
    g         gap between it and the robot or target nearest to it
    d         minimum distance of two robots or of two targets

A grown obstacle therefore contains no target, and it contains a robot only if the robot's body
touches the obstacle: then the margin of one radius remains, and a plan first leads this robot
outward. Two robots that are more than two radii apart have to stay so.

With `collision.adaptive: false` the margins are the paper's: off = 0, and nothing is reduced.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tetractl.control.search.discs import distances_to_obstacles
from tetractl.control.search.kernels.clearance import min_pair_distance
from tetractl.control.search.near_targets import lost_command_deviation
from tetractl.core.motion_estimate import Estimate
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.spec.section_abilities import Clearance

N_SIGMAS = 2.0
"""Number of standard deviations that margins add for uncertain parameters; chosen."""
GAP_FRACTION = 0.98
"""Fraction of a gap that robots keep free if the full margin does not fit into it; chosen."""


def max_deviation(
    speed: Floats, held_s: float, dead_time_s: float, estimate: Estimate | None
) -> float:
    """Compute the maximum deviation of any robot from its course during one command [length unit].

    Args:
        speed: Speeds [length unit/s], shape (N,).
        held_s: How long a command is followed [s].
        dead_time_s: Time from a command to its effect [s].
        estimate: The estimate of the motion. None if the motion is known exactly.
    """
    deviations = lost_command_deviation(speed, held_s)
    if estimate is None:
        return float(deviations.max())
    if estimate.lag is not None:
        lag_std_s = 0.0 if estimate.lag_std is None else estimate.lag_std
        lag_path = speed * (estimate.lag + N_SIGMAS * lag_std_s)
        deviations += np.minimum(estimate.a * held_s, 1.0) * lag_path
    dead_time_part = speed * (estimate.dead_time_std or 0.0)
    # a is above 0: a spec states no other, and the filter estimates ln a
    rates_part = speed * estimate.a_std / estimate.a + estimate.speed_std
    uncertainties = dead_time_part + rates_part * (dead_time_s + held_s)
    return float((deviations + N_SIGMAS * uncertainties).max())


def fit_margins(margin: float, gap: Floats) -> Floats:
    """Compute the margin that fits into each gap between an obstacle and a point, shape (O,).

    The result is the whole margin if it is smaller than the gap. Otherwise it is GAP_FRACTION times
    the gap, or 0 if the gap is negative.

    Args:
        margin: The whole margin [length unit].
        gap: Distance from each obstacle to the nearest point [length unit], shape (O,).
    """
    return np.where(gap > margin, margin, GAP_FRACTION * np.maximum(gap, 0.0))


class Margins:
    """The margins that plans keep from obstacles and other robots, on one leg of a trial.

    The object never changes.

    Args:
        collision: The fields `collision` of the controller.
        shapes: The obstacles.
        walls: The walls of the arena. None if it has none.
        targets: Targets of the N robots [length unit], shape (N, 2).
    """

    def __init__(
        self,
        collision: Clearance,
        shapes: Sequence[Shape],
        walls: Bounds | None,
        targets: Floats,
    ) -> None:
        self._collision = collision
        self._obstacles = Obstacles.from_shapes(shapes, 0.0, walls)
        x = targets[:, 0].copy()
        y = targets[:, 1].copy()
        self._target_separation = min_pair_distance(x, y)
        # shape (O,)
        self._target_gaps = distances_to_obstacles(self._obstacles, x, y).min(
            axis=1, initial=np.inf
        )
        self._body_margins = fit_margins(collision.radius, self._target_gaps)  # (O,)

    def apply(
        self, problem: Problem, held_s: float, dead_time_s: float, estimate: Estimate | None
    ) -> Problem:
        """Return a problem with obstacles grown by their margins, and with the robots' separation.

        Obstacles and walls grow by the spec's margin, the robot's radius, and the maximum deviation
        of robots from their courses. They grow by less if a robot or target would otherwise be
        inside. If `collision.adaptive` is false, obstacles always grow by the margin and the
        radius, and the robots keep the spec's separation.

        Args:
            problem: The problem of the control step.
            held_s: How long robots follow each command [s].
            dead_time_s: Time from a command to its effect [s].
            estimate: The estimate of the motion. None if the motion is known exactly.
        """
        collision = self._collision
        margin = collision.margin + collision.radius
        if not collision.adaptive:
            grown = self._obstacles.grown(np.full(self._obstacles.count, margin))
            return replace(problem, obstacles=grown, separation=collision.separation)
        deviation = max_deviation(problem.speed, held_s, dead_time_s, estimate)
        separation = collision.separation + 2 * deviation if collision.separation else 0.0
        return replace(
            problem,
            obstacles=self.grow_obstacles(problem.poses, margin + deviation),
            separation=self.separation(problem.poses, separation),
        )

    def grow_obstacles(self, poses: Poses, margin: float) -> Obstacles:
        """Grow each obstacle and wall by a margin, or by less if the margin does not fit.

        A margin fits if no robot and no target is inside the grown obstacle. At least the part of
        a robot's radius that fits between obstacles and targets is always kept.
        """
        x = np.array(poses.x)  # a copy: an observation's are read-only, which is another type
        y = np.array(poses.y)
        robot_gaps = distances_to_obstacles(self._obstacles, x, y).min(axis=1, initial=np.inf)
        margins = fit_margins(margin, np.minimum(self._target_gaps, robot_gaps))
        return self._obstacles.grown(np.maximum(margins, self._body_margins))

    def separation(self, poses: Poses, full_separation: float) -> float:
        """Compute the separation that plans keep between two robots [length unit].

        The result is the full separation, or less if two robots or two targets are already closer
        together. The result is 0 if there is only one robot.

        Args:
            poses: Present poses of the robots.
            full_separation: The separation to keep if there is enough space [length unit]. 0 if
                robots may meet.
        """
        closest = min(min_pair_distance(poses.x, poses.y), self._target_separation)
        if full_separation <= 0 or closest == np.inf:  # a single robot
            return 0.0
        touching = min(2 * self._collision.radius, closest)
        return min(full_separation, max(GAP_FRACTION * closest, touching))
