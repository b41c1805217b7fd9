"""The distances that a plan keeps to obstacles and walls, and between robots.

A robot can deviate from its plan because its state is uncertain. The margin is the sum of the
robot's radius, the spec's margin and, if the margin is adaptive, the greatest deviation of any
robot,

    LOST_SHARE v T + SIGMAS (v sigma_tau + (v sigma_a/a + sigma_v) (tau + T)),

with its speed v, the control period T (while robots miss many commands, a signal's), the dead time
tau and the standard deviations sigma of the identified values. The first term is due to a lost
command, the others to uncertain values. The centres of two robots keep a distance of the spec's
separation plus twice that deviation.

If a robot or a target is already nearer to an obstacle, the margin is reduced to its distance,
because no plan could keep the full margin. It is never reduced below the robot's radius, unless a
target is nearer: a plan for a robot whose body touches something leads outward first. The
separation is not reduced below two radii unless two robots or targets are nearer already.

Robots that receive no command for a while keep their direction. `Margins.clear_unheard` tests
whether robots would stay clear if that happened at any one signal of a plan.
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
"""Deviation by a lost command, as a fraction of a period's path."""
SIGMAS = 2.0  # standard deviations by which uncertain values are taken into account
TESTED = np.linspace(0, 1, 5)  # parts of a time at which paths under a held direction are tested
SAMPLE_S = 0.15  # time step of paths under a held direction [s]


def off_course(
    speed: Floats, period_s: float, dead_time_s: float, estimate: Estimate | None
) -> float:
    """Return the greatest deviation of any robot from its plan in a control period [length
    unit]; `estimate` is None for a certain motion.
    """
    if estimate is None:
        return LOST_SHARE * max(speed.tolist()) * period_s
    a = estimate.a.tolist()
    a_std = estimate.a_std.tolist()
    v_std = estimate.speed_std.tolist()
    tau_std_s = estimate.dead_time_std or 0.0
    blind_s = dead_time_s + period_s
    greatest = 0.0
    for i, v in enumerate(speed.tolist()):
        lost = LOST_SHARE * v * period_s
        uncertain = v * tau_std_s + (v * a_std[i] / a[i] + v_std[i]) * blind_s
        greatest = max(greatest, lost + SIGMAS * uncertain)
    return greatest


@dataclass(frozen=True, slots=True)
class Unheard:
    """What `Margins.clear_unheard` computes once for a problem: the robots' motion, the time steps
    under a held direction, and the obstacles and the separation that robots keep."""

    problem: Problem
    motion: Flat
    step_s: float
    steps: int
    obstacles: Obstacles
    separation: float


class Margins:
    """The margins of a trial around the obstacles `shapes` and, if given, the walls of the arena;
    a grown obstacle contains none of the N targets. The robots' bodies have the radius `radius`
    [length unit]."""

    def __init__(
        self, shapes: Sequence[Shape], walls: Bounds | None, targets: Floats, radius: float = 0.0
    ) -> None:
        self._bare = Obstacles.of(shapes, 0.0, walls)
        self._bodies = Obstacles.of(shapes, radius, walls)
        self._radius = radius
        self._targets = targets
        x = targets[:, 0].copy()
        y = targets[:, 1].copy()
        # for each obstacle, the distance of the nearest target and the least margin, (O,)
        self._nearest = self._gaps(x, y).min(axis=1)
        touched = clearance.ROOM * np.maximum(self._nearest, 0.0)
        self._least = np.where(self._nearest > radius, radius, touched)
        self._targets_apart = clearance.least_apart(x, y)
        self._unheard: Unheard | None = None  # of the problem asked about last

    def around(
        self,
        problem: Problem,
        collision: Collision,
        period_s: float,
        dead_time_s: float,
        estimate: Estimate | None,
    ) -> tuple[Region, float]:
        """Return the obstacles of a problem, grown by the margins of `collision`, and its
        separation. Adaptive margins grow by the distance that robots may leave their course, given
        the estimate, which is None for a certain motion."""
        if not collision.adaptive:
            margin = np.full(self._bare.count, collision.margin + collision.radius)
            return self._bare.grown(margin), problem.separation
        off = off_course(problem.speed, period_s, dead_time_s, estimate)
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
            self._nearest,
            self._least,
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

    def entered(self, path: Floats) -> bool:
        """Return whether a body would touch an obstacle or another body, margins ignored, on the
        way along path (M, N, 3), or would go deeper if it touches one at the beginning.
        """
        return clearance.enters(
            self._bare.rows,
            self._bare.walls,
            self._bodies.rows,
            self._bodies.walls,
            self._radius,
            path,
        )

    def meets(self, problem: Problem, held: Floats, seconds: float) -> bool:
        """Return whether a body enters an obstacle within `seconds`, in which robots follow `held`
        (N,) [rad], NaN for a robot that stands still."""
        return self.entered(compiled_drive(problem, held, seconds * TESTED))

    def clear_unheard(
        self,
        problem: Problem,
        path: Floats,
        signals: Floats,
        seconds: float,
        margin: float,
        apart: float,
    ) -> bool:
        """Return whether robots keep clear even if any one signal is held for `seconds`.

        path (at least L, N, 3) are the poses before each of the signals (L,).

        Robots keep clear if they stay `margin` away from obstacles, or as far as at the start if
        that is less, and `apart` from each other, or the problem's separation if that is less.
        Times and distances are the same whenever the same problem is asked about.
        """
        if self._unheard is None or self._unheard.problem is not problem:
            steps = max(1, math.ceil(seconds / SAMPLE_S))
            self._unheard = Unheard(
                problem=problem,
                motion=flat(problem),
                step_s=seconds / steps,
                steps=steps,
                obstacles=self.obstacles(problem.poses, margin),
                separation=min(apart, problem.separation),
            )
        held = self._unheard
        return unheard(
            signals,
            held.motion.parameters,
            held.motion.drift,
            held.step_s,
            held.steps,
            held.motion.rest,
            path,
            held.obstacles.rows,
            held.obstacles.walls,
            held.separation,
        )

    def room(self, x: Floats, y: Floats, apart: float) -> Floats:
        """Return the least clearance (...) of robots at x, y (..., N): the least of all distances
        of a body to obstacles and walls, negative inside, and of all distances of two robots minus
        `apart`.
        """
        gaps = self._gaps(x.ravel(), y.ravel())
        nearest = gaps.min(axis=0, initial=np.inf).reshape(x.shape)
        i, k = np.triu_indices(x.shape[-1], 1)  # the pairs of robots
        between = np.hypot(x[..., i] - x[..., k], y[..., i] - y[..., k])
        to_robots = between.min(axis=-1, initial=np.inf) - apart
        to_obstacles = nearest.min(axis=-1) - self._radius
        return np.minimum(to_obstacles, to_robots)

    def separation(self, poses: Poses, wanted: float) -> float:
        """Return the separation to keep: `wanted`, or the least present distance between two robots
        or two targets if that is less, but two radii if robots and targets are so far apart.
        """
        if len(self._targets) < 2 or wanted <= 0:
            return 0.0
        present = min(clearance.least_apart(poses.x, poses.y), self._targets_apart)
        bodies = min(2 * self._radius, present)
        return min(wanted, max(clearance.ROOM * present, bodies))
