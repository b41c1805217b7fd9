"""The distances that a plan keeps to obstacles and walls, and between robots.

A robot can deviate from its plan because its state is uncertain. The margin is the sum of the
robot's radius, the spec's margin and, if the margin is adaptive, the greatest deviation of any
robot,

    LOST_SHARE v T + SIGMAS (v sigma_tau + (v sigma_a/a + sigma_v) (tau + T)),

with its speed v, the control period T, the dead time tau and the standard deviations sigma of the
identified values. The first term is due to a lost command, the others to uncertain values. The
centres of two robots keep a distance of the spec's separation plus twice that deviation.

An adaptive margin does not always fit. If a robot or a target is nearer to an obstacle than that,
no plan could keep it, and it is reduced to a little less (REDUCED) than the gap:

    least gap of a robot or target    margin
    more than the full margin         the full margin
    less than that                    REDUCED times the gap, but at least the radius; if a target is
                                      nearer than a radius, at least REDUCED times the target's gap

A robot whose body touches something keeps the margin of a radius: its plan leads outward first. The
separation is reduced in the same way, and to less than two radii only if two robots or targets are
nearer already.

Four questions are asked of a way that robots may go; bodies are discs of the radius:

    Margins.enters           does a body touch something along a path, whatever the margins are?
    Margins.enters_if_held   does it, if robots follow the same directions for some time?
    Silence.keeps_clear      do robots keep clear if they receive nothing after a signal of a plan?
    Margins.least_clearance  how far are bodies from everything, in some places?
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.control.collision import Collision
from tetractl.control.evaluate import compiled_drive
from tetractl.control.kernels import clearance
from tetractl.control.kernels.motion import Flat, flat
from tetractl.control.kernels.prediction import unheard
from tetractl.core.plan import Estimate, Problem, Region
from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.model.obstacles import Obstacles

LOST_SHARE = 0.75
"""Deviation by a lost command, as a fraction of the path that it was to act for; chosen."""
SIGMAS = 2.0
"""Standard deviations by which uncertain values are taken into account; chosen."""
HELD_MOMENTS = np.linspace(0, 1, 5)
"""Moments at which `enters_if_held` looks, as fractions of the time: it also tests the straight
lines between them."""
SILENCE_STEP_S = 0.15
"""Longest time step of the paths of robots that receive nothing [s]; chosen."""


def off_course(
    speed: Floats, heard_s: float, dead_time_s: float, estimate: Estimate | None
) -> float:
    """Return the greatest deviation of any robot from its plan while it follows a command, which
    takes `heard_s` [length unit]; `estimate` is None for a certain motion.
    """
    if estimate is None:
        return LOST_SHARE * max(speed.tolist()) * heard_s
    a = estimate.a.tolist()
    a_std = estimate.a_std.tolist()
    v_std = estimate.speed_std.tolist()
    tau_std_s = estimate.dead_time_std or 0.0
    blind_s = dead_time_s + heard_s
    greatest = 0.0
    for i, v in enumerate(speed.tolist()):
        lost = LOST_SHARE * v * heard_s
        uncertain = v * tau_std_s + (v * a_std[i] / a[i] + v_std[i]) * blind_s
        greatest = max(greatest, lost + SIGMAS * uncertain)
    return greatest


@dataclass(frozen=True, slots=True)
class Silence:
    """A while in which robots receive no command, and keep their direction: `steps` time steps of
    `step_s` [s]. Meanwhile they are to keep clear of `obstacles`, which have grown by a margin, and
    to keep the `separation` from each other [length unit]."""

    motion: Flat
    step_s: float
    steps: int
    obstacles: Obstacles
    separation: float

    def keeps_clear(self, path: Floats, signals: Floats) -> bool:
        """Return whether robots keep clear, whichever of the signals (L,) is the one after which
        they receive nothing; path (at least L, N, 3) are the poses before each signal.

        A robot that is nearer to something at the beginning is not to come nearer still.
        """
        return unheard(
            signals,
            self.motion.parameters,
            self.motion.drift,
            self.step_s,
            self.steps,
            self.motion.rest,
            path,
            self.obstacles.rows,
            self.obstacles.walls,
            self.separation,
        )


class Margins:
    """The margins of a trial around O obstacles, the `shapes` and, if given, the four walls of the
    arena; a grown obstacle contains none of the N targets. The robots' bodies have the radius
    `radius` [length unit]. It never changes."""

    def __init__(
        self, shapes: Sequence[Shape], walls: Bounds | None, targets: Floats, radius: float = 0.0
    ) -> None:
        self._bare = Obstacles.of(shapes, 0.0, walls)
        self._bodies = Obstacles.of(shapes, radius, walls)
        self._radius = radius
        self._number = len(targets)
        x = targets[:, 0].copy()
        y = targets[:, 1].copy()
        self._targets_apart = clearance.least_apart(x, y)
        # (O,) gap between each obstacle and the target nearest to it, and the margin that it keeps
        # however near robots are: a radius, unless this target is nearer
        self._target_gaps = self._gaps(x, y).min(axis=1)
        below_target = clearance.REDUCED * np.maximum(self._target_gaps, 0.0)
        self._least_margins = np.where(self._target_gaps > radius, radius, below_target)

    def around(
        self,
        problem: Problem,
        collision: Collision,
        heard_s: float,
        dead_time_s: float,
        estimate: Estimate | None,
    ) -> tuple[Region, float]:
        """Return the obstacles of a problem, grown by the margins of `collision`, and the
        separation of its robots, which follow each command for `heard_s`.

        Margins that are not adaptive are those of the paper: they are the same everywhere, and
        never reduced. Adaptive ones grow by the distance that robots may leave their course, given
        the estimate, which is None for a certain motion."""
        if not collision.adaptive:
            margin = np.full(self._bare.count, collision.margin + collision.radius)
            return self._bare.grown(margin), problem.separation
        off = off_course(problem.speed, heard_s, dead_time_s, estimate)
        apart = collision.separation + 2 * off if collision.separation else 0.0
        grown = self.obstacles(problem.poses, collision.margin + collision.radius + off)
        return grown, self.separation(problem.poses, apart)

    def obstacles(self, poses: Poses, margin: float) -> Obstacles:
        """Return the obstacles grown by the margin, or less so that they contain no target, and no
        robot unless its body touches them."""
        bare = self._bare
        grown = Obstacles(np.empty_like(bare.rows), np.empty_like(bare.walls), bare.boxes)
        clearance.grow(
            bare.rows,
            bare.walls,
            bare.boxes,
            np.array(poses.x),  # a copy: an observation's are read-only, which is another type
            np.array(poses.y),
            self._target_gaps,
            self._least_margins,
            margin,
            grown.rows,
            grown.walls,
        )
        return grown

    def _gaps(self, x: Floats, y: Floats) -> Floats:
        """Return the distance of each point (P,) to each obstacle, (O, P), negative inside."""
        gaps = np.empty((self._bare.count, len(x)))
        clearance.gaps(self._bare.rows, self._bare.walls, x, y, gaps)
        return gaps

    def enters(self, path: Floats) -> bool:
        """Return whether a body touches an obstacle or another body, margins ignored, on the way
        along path (M, N, 3), or goes deeper if it touches one at the beginning.
        """
        return clearance.enters(
            self._bare.rows,
            self._bare.walls,
            self._bodies.rows,
            self._bodies.walls,
            self._radius,
            path,
        )

    def enters_if_held(self, problem: Problem, directions: Floats, seconds: float) -> bool:
        """Return whether a body touches something within `seconds`, in which robots follow their
        directions (N,) [rad], NaN for a robot that stands still."""
        return self.enters(compiled_drive(problem, directions, seconds * HELD_MOMENTS))

    def silence(self, problem: Problem, seconds: float, margin: float, apart: float) -> Silence:
        """Return a silence of some seconds in which the robots of a problem are to stay `margin`
        away from obstacles, or as far as they are now if that is less, and `apart` from each other,
        or the problem's separation if that is less."""
        steps = max(1, math.ceil(seconds / SILENCE_STEP_S))
        return Silence(
            motion=flat(problem),
            step_s=seconds / steps,
            steps=steps,
            obstacles=self.obstacles(problem.poses, margin),
            separation=min(apart, problem.separation),
        )

    def least_clearance(self, x: Floats, y: Floats, apart: float) -> Floats:
        """Return the least clearance (...) of robots at x, y (..., N): the least of all distances
        of a body to obstacles and walls, negative inside, and of all distances of two robots minus
        `apart`.
        """
        gaps = self._gaps(x.ravel(), y.ravel())
        to_obstacles = gaps.min(axis=0, initial=np.inf).reshape(x.shape).min(axis=-1)
        i, k = np.triu_indices(x.shape[-1], 1)  # the pairs of robots
        between = np.hypot(x[..., i] - x[..., k], y[..., i] - y[..., k])
        to_robots = between.min(axis=-1, initial=np.inf)
        return np.minimum(to_obstacles - self._radius, to_robots - apart)

    def separation(self, poses: Poses, wanted: float) -> float:
        """Return the separation to keep: `wanted`, or the least present distance between two robots
        or two targets if that is less, but two radii if robots and targets are so far apart.
        """
        if self._number < 2 or wanted <= 0:
            return 0.0
        present = min(clearance.least_apart(poses.x, poses.y), self._targets_apart)
        bodies = min(2 * self._radius, present)
        return min(wanted, max(clearance.REDUCED * present, bodies))
