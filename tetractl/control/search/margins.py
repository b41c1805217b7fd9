"""The margin by which a plan keeps clear of each obstacle, and the separation of its robots.

Robots deviate from a plan, because commands are lost and what is known of the robots is uncertain.
While a robot follows a command, it comes off its course by at most (`off_course`)

    off = lost_way + SIGMAS (v sigma_tau + (v sigma_a / a + sigma_v) (T + tau))

    v    speed [length unit/s]             T    time for which a command is followed [s]
    a    turning rate [rad/s], above 0     tau  dead time: from a command to its effect [s]
    r    radius of a robot [length unit]   sigma_v, sigma_a, sigma_tau  standard deviations

and with the greatest off of any robot, a plan is to keep (`Margins.applied`)

    full margin m       = collision.margin + r + off    of a centre to an obstacle or wall
    full separation s   = collision.separation + 2 off  of two centres; 0 if robots may meet

Where robots or targets are nearer than that already, no plan could keep it. Less is kept there:

    fit(m, g)           = m if it is less than the gap g, else REDUCED max(g, 0)
    margin of obstacle  = max(fit(m, g), fit(r, g_target))      fit(r, ...) <= r <= m
    separation          = min(s, max(REDUCED d, min(2 r, d)))

    g_target  gap between the obstacle and the target nearest to it [length unit], negative inside
    g         gap between it and the robot or target nearest to it
    d         least distance of two robots or of two targets

So a grown obstacle contains no target, and no robot unless its body touches the obstacle: the
margin of a radius stays, and a plan first leads this robot outward. Two robots that are farther
apart than two radii are to stay so.

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
"""Standard deviations by which uncertain values are taken into account; chosen."""
REDUCED = 0.98
"""Fraction of a gap that is kept where more does not fit into it; chosen."""


def off_course(
    speed: Floats, heard_s: float, dead_time_s: float, estimate: Estimate | None
) -> float:
    """Return the greatest deviation of any robot from its course while it follows a command, which
    takes `heard_s` [length unit]. Without an estimate the motion is certain: all sigma are 0.
    """
    lost = lost_way(speed, heard_s)
    if estimate is None:
        return float(lost.max())
    of_dead_time = speed * (estimate.dead_time_std or 0.0)
    # a is above 0: a spec states no other, and the filter estimates ln a
    of_rates = speed * estimate.a_std / estimate.a + estimate.speed_std
    uncertain = of_dead_time + of_rates * (dead_time_s + heard_s)
    return float((lost + SIGMAS * uncertain).max())


def fit(margin: float, gap: Floats) -> Floats:
    """Return how much of a margin fits into gaps (O,) [length unit]."""
    return np.where(gap > margin, margin, REDUCED * np.maximum(gap, 0.0))


class Margins:
    """The margins by which robots with N `targets` (N, 2) keep clear of the O obstacles: `shapes`
    and, if given, the four `walls` of the arena. It never changes."""

    def __init__(
        self,
        collision: Clearance,
        shapes: Sequence[Shape],
        walls: Bounds | None,
        targets: Floats,
    ) -> None:
        self._collision = collision
        self._obstacles = Obstacles.of(shapes, 0.0, walls)
        x = targets[:, 0].copy()
        y = targets[:, 1].copy()
        self._targets_apart = least_apart(x, y)
        self._gaps_to_targets = gaps(self._obstacles, x, y).min(axis=1, initial=np.inf)  # (O,)
        self._margins_of_bodies = fit(collision.radius, self._gaps_to_targets)  # (O,)

    def applied(
        self, problem: Problem, heard_s: float, dead_time_s: float, estimate: Estimate | None
    ) -> Problem:
        """Return a problem with its obstacles grown by the margins and its robots' separation,
        given that robots follow each command for `heard_s`, and the estimate, None for a certain
        motion."""
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
        """Return the obstacles grown by the margin, a radius or more, or by what fits between them
        and robots, and in any case by what fits of a radius between them and targets."""
        x = np.array(poses.x)  # a copy: an observation's are read-only, which is another type
        y = np.array(poses.y)
        gaps_to_robots = gaps(self._obstacles, x, y).min(axis=1, initial=np.inf)
        margins = fit(margin, np.minimum(self._gaps_to_targets, gaps_to_robots))
        return self._obstacles.grown(np.maximum(margins, self._margins_of_bodies))

    def separation(self, poses: Poses, wanted: float) -> float:
        """Return the wanted separation, or what fits between robots and between targets; 0 if it
        is not wanted."""
        present = min(least_apart(poses.x, poses.y), self._targets_apart)
        if wanted <= 0 or present == np.inf:  # a single robot
            return 0.0
        bodies = min(2 * self._collision.radius, present)
        return min(wanted, max(REDUCED * present, bodies))
