"""The cost (7)-(9) of a whole swarm: the twin of `tetractl.control.cost.evaluate`.

Views of arrays are made outside the loops: each costs the compiled code a reference count.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tetractl.control.cost import Problem
from tetractl.control.kernels.motion import advance, constants, model_code
from tetractl.control.kernels.numeric import KERNEL, PART, sincos
from tetractl.control.kernels.world import count_hits
from tetractl.model.state import Floats


class Course(NamedTuple):
    """A problem laid out in lanes for P particles, with the room its rollouts work in."""

    start: Floats  # (4, M): x, y, cos and sin of the heading
    target: Floats  # (2, M)
    first: Floats  # (3, M): see `motion.constants`, of the first signal
    rest: Floats  # and of the others
    first_pieces: int
    rest_pieces: int
    model: int
    boxes: Floats  # (R, 4)
    discs: Floats  # (C, 3)
    weight: float
    swept: bool
    lanes: Floats  # (8, M): x, y, cos, sin; x, y before the step; count and gap of `world`
    facing: Floats  # (2, N, P): cos and sin of the direction


def lay_out(problem: Problem, particles: int) -> Course:
    """Spread a problem over lanes = robot * particles + particle."""

    def lanes(per_robot: Floats) -> Floats:
        return np.repeat(np.asarray(per_robot, dtype=np.float64), particles, axis=-1)

    p, a, v = problem.poses, problem.a, problem.speed
    first, first_pieces = constants(problem.model, a, v, problem.first_period)
    rest, rest_pieces = constants(problem.model, a, v, problem.period)
    return Course(
        start=lanes(np.stack([p.x, p.y, np.cos(p.heading), np.sin(p.heading)])),
        target=lanes(problem.targets.T),
        first=lanes(first),
        rest=lanes(rest),
        first_pieces=first_pieces,
        rest_pieces=rest_pieces,
        model=model_code(problem.model, a, problem.period),
        boxes=problem.obstacles.rectangles,
        discs=problem.obstacles.circles,
        weight=float(problem.obstacle_weight),
        swept=problem.swept,
        lanes=np.empty((8, a.size * particles)),
        facing=np.empty((2, a.size, particles)),
    )


@njit(**PART)
def face(signals, j, cos_u, sin_u):
    """Point every robot's lanes (N, P) at the j-th signal of their particle."""
    for n in range(signals.shape[1]):
        sin_u[0, n], cos_u[0, n] = sincos(signals[j, n])
    for i in range(1, cos_u.shape[0]):
        for n in range(signals.shape[1]):
            cos_u[i, n] = cos_u[0, n]
            sin_u[i, n] = sin_u[0, n]


@njit(**KERNEL)
def costs(course, signals, total):
    """Write J of each column of signals (L, P) to total (P,); return whether all are finite."""
    lanes, start, facing, first, rest = (
        course.lanes,
        course.start,
        course.facing,
        course.first,
        course.rest,
    )
    x, y, cos, sin, x0, y0 = lanes[0], lanes[1], lanes[2], lanes[3], lanes[4], lanes[5]
    count, gap = lanes[6], lanes[7]
    cos_u, sin_u = facing[0], facing[1]
    flat_cos_u, flat_sin_u = cos_u.reshape(x.size), sin_u.reshape(x.size)
    f0, f1, f2, r0, r1, r2 = first[0], first[1], first[2], rest[0], rest[1], rest[2]
    model, swept, boxes, discs = course.model, course.swept, course.boxes, course.discs
    for n in range(x.size):
        x[n], y[n], cos[n], sin[n] = start[0, n], start[1, n], start[2, n], start[3, n]
        count[n], gap[n] = 0.0, 1.0
    for j in range(signals.shape[0]):
        face(signals, j, cos_u, sin_u)
        if swept:
            for n in range(x.size):
                x0[n], y0[n] = x[n], y[n]
        if j == 0:
            pieces = course.first_pieces
            advance(model, pieces, x, y, cos, sin, flat_cos_u, flat_sin_u, f0, f1, f2)
        else:
            pieces = course.rest_pieces
            advance(model, pieces, x, y, cos, sin, flat_cos_u, flat_sin_u, r0, r1, r2)
        count_hits(x0, y0, x, y, boxes, discs, swept, gap, count)
    _sum_up(x, y, count, course.target, course.weight, total)
    finite = True
    for n in range(total.size):
        finite &= math.isfinite(total[n])
    return finite


@njit(**PART)
def _sum_up(x, y, count, target, weight, total):
    """Add up (7) and (8) over the robots of each particle."""
    particles = total.size
    for n in range(particles):
        total[n] = 0.0
    for lane in range(0, x.size, particles):
        for n in range(particles):
            dx, dy = x[lane + n] - target[0, lane + n], y[lane + n] - target[1, lane + n]
            total[n] += math.sqrt(dx * dx + dy * dy) + weight * count[lane + n]
