"""Safety distances of a plan: the margin to each obstacle, and the separation between robots.

Robots deviate from a plan because some commands are lost, and because the robots' speeds and other
parameters are only known with some uncertainty. While a robot follows a command, it leaves its
course by at most (`off_course`)

    off = lost_way + min(a T, 1) v (l + SIGMAS sigma_l)
          + SIGMAS (v sigma_tau + (v sigma_a / a + sigma_v) (T + tau))

    v    speed [length unit/s]             T    time for which a command is followed [s]
    a    turning rate [rad/s], above 0     tau  dead time: from a command to its effect [s]
    r    radius of a robot [length unit]   l    lag of the wheels [s], 0 if there is none
    sigma_v, sigma_a, sigma_tau, sigma_l   standard deviations

The second term accounts for wheels that respond with a lag. After a lost command, such wheels still
follow the wrong turn: the heading is wrong by up to a T over a distance of v l, so the robot leaves
its course by no more than this distance.

With off, the largest such deviation of any robot, a plan should keep (`Margins.applied`)

    full margin m       = collision.margin + r + off    between a centre and an obstacle or wall
    full separation s   = collision.separation + 2 off  between two centres; 0 if robots may meet

Where robots or targets are already closer than that, no plan could keep it. There, less is kept:

    fit(m, g)           = m if it is less than the gap g, else REDUCED max(g, 0)
    margin of obstacle  = max(fit(m, g), fit(r, g_target))      fit(r, ...) <= r <= m
    separation          = min(s, max(REDUCED d, min(2 r, d)))

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

from tetractl.control.search.discs import gaps
from tetractl.control.search.kernels.clearance import least_apart
from tetractl.control.search.near_targets import lost_way
from tetractl.core.motion_estimate import Estimate
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.spec.section_abilities import Clearance

SIGMAS = 2.0
"""Number of standard deviations by which uncertain values are taken into account; chosen."""
REDUCED = 0.98
"""Fraction of a gap that is kept where more does not fit into it; chosen."""


def off_course(
    speed: Floats, heard_s: float, dead_time_s: float, estimate: Estimate | None
) -> float:
    """Compute the maximum deviation of any robot from its course during one command [length unit].

    Args:
        speed: Speeds [length unit/s], shape (N,).
        heard_s: How long a command is followed [s].
        dead_time_s: Time from a command to its effect [s].
        estimate: The estimate of the motion. None if the motion is known exactly.
    """
    lost = lost_way(speed, heard_s)
    if estimate is None:
        return float(lost.max())
    if estimate.lag is not None:
        lag_std_s = 0.0 if estimate.lag_std is None else estimate.lag_std
        rolled = speed * (estimate.lag + SIGMAS * lag_std_s)
        lost += np.minimum(estimate.a * heard_s, 1.0) * rolled
    of_dead_time = speed * (estimate.dead_time_std or 0.0)
    # a is above 0: a spec states no other, and the filter estimates ln a
    of_rates = speed * estimate.a_std / estimate.a + estimate.speed_std
    uncertain = of_dead_time + of_rates * (dead_time_s + heard_s)
    return float((lost + SIGMAS * uncertain).max())


def fit(margin: float, gap: Floats) -> Floats:
    """Return the margin to keep in each gap, shape (O,).

    It is the whole margin if that is smaller than the gap, and otherwise REDUCED times the gap, or
    0 if the gap is negative.
    """
    return np.where(gap > margin, margin, REDUCED * np.maximum(gap, 0.0))


class Margins:
    """The distances that a plan keeps from obstacles and walls, for one task.

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
        self._targets_apart = least_apart(x, y)
        self._gaps_to_targets = gaps(self._obstacles, x, y).min(axis=1, initial=np.inf)  # (O,)
        self._margins_of_bodies = fit(collision.radius, self._gaps_to_targets)  # (O,)

    def applied(
        self, problem: Problem, heard_s: float, dead_time_s: float, estimate: Estimate | None
    ) -> Problem:
        """Return the problem with the distances that plans must keep from obstacles and robots.

        Obstacles and walls grow by the margin, the robot radius, and an allowance for how far
        robots may be off their course; by less where a robot or target would be inside. If
        `collision.adaptive` is false, they always grow by the margin and the radius, and the
        separation of the robots is that of the spec.

        Args:
            problem: The problem of the control step.
            heard_s: How long robots follow each command [s].
            dead_time_s: Time from a command to its effect [s].
            estimate: The estimate of the motion. None if the motion is known exactly.
        """
        collision = self._collision
        margin = collision.margin + collision.radius
        if not collision.adaptive:
            everywhere = self._obstacles.grown(np.full(self._obstacles.count, margin))
            return replace(problem, obstacles=everywhere, separation=collision.separation)
        off = off_course(problem.speed, heard_s, dead_time_s, estimate)
        separation = collision.separation + 2 * off if collision.separation else 0.0
        return replace(
            problem,
            obstacles=self.grown(problem.poses, margin + off),
            separation=self.separation(problem.poses, separation),
        )

    def grown(self, poses: Poses, margin: float) -> Obstacles:
        """Grow each obstacle and wall by a margin, or by less if the margin does not fit.

        A margin fits if no robot and no target is inside the grown obstacle. At least the part of
        a robot's radius that fits between obstacles and targets is always kept.
        """
        x = np.array(poses.x)  # a copy: an observation's are read-only, which is another type
        y = np.array(poses.y)
        gaps_to_robots = gaps(self._obstacles, x, y).min(axis=1, initial=np.inf)
        margins = fit(margin, np.minimum(self._gaps_to_targets, gaps_to_robots))
        return self._obstacles.grown(np.maximum(margins, self._margins_of_bodies))

    def separation(self, poses: Poses, wanted: float) -> float:
        """Return the distance that two robots keep: the wanted one, or less if they are closer.

        Targets that are closer together count likewise. The result is 0 if no separation is
        wanted, or if there is only one robot. Lengths are in the spec's unit.
        """
        present = min(least_apart(poses.x, poses.y), self._targets_apart)
        if wanted <= 0 or present == np.inf:  # a single robot
            return 0.0
        bodies = min(2 * self._collision.radius, present)
        return min(wanted, max(REDUCED * present, bodies))
