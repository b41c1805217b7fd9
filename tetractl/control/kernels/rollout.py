"""The cost (7)-(9) of a whole swarm: the twin of `tetractl.control.cost.evaluate`.

Views of arrays are made outside the loops: each costs the compiled code a reference count.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tetractl.control.kernels.math import KERNEL, PART, sincos
from tetractl.control.kernels.motion import (
    GENTLE,
    advance,
    coast_past_one,
    constants,
    gentle_past_one,
    model_code,
)
from tetractl.control.kernels.obstacles import count_hits, count_one
from tetractl.control.kernels.update import move
from tetractl.core.poses import Floats
from tetractl.core.problem import Problem

LINE = 8  # numbers in a cache line


class Course(NamedTuple):
    """A problem laid out for N robots of P particles, with the room its rollouts work in."""

    start: Floats  # (4, N): x, y, cos and sin of the heading
    target: Floats  # (2, N)
    first: Floats  # (3, N): see `motion.constants`, of the first signal
    rest: Floats  # and of the others
    first_pieces: int
    rest_pieces: int
    model: int
    boxes: Floats  # (R, 4)
    discs: Floats  # (C, 3)
    weight: float
    swept: bool
    lanes: Floats  # (5, N, P): x, y, cos, sin, hits
    room: Floats  # (5, P): cos and sin of the direction; x, y before the step; gap of `world`


def aligned(shape: tuple[int, ...]) -> Floats:
    """Return an array that begins with a cache line: vectors across two take twice the time."""
    size = math.prod(shape)
    raw = np.empty(size + LINE)
    first = -raw.ctypes.data // raw.itemsize % LINE
    return raw[first : first + size].reshape(shape)


def lay_out(problem: Problem, particles: int) -> Course:
    """Prepare a problem for rollouts of so many particles at once."""
    p, a, v = problem.poses, problem.a, problem.speed
    first, first_pieces = constants(problem.motion, a, v, problem.first_period)
    rest, rest_pieces = constants(problem.motion, a, v, problem.period)
    return Course(
        start=np.stack([p.x, p.y, np.cos(p.heading), np.sin(p.heading)]),
        target=np.ascontiguousarray(problem.targets.T),
        first=first,
        rest=rest,
        first_pieces=first_pieces,
        rest_pieces=rest_pieces,
        model=model_code(problem.motion, a, problem.period),
        boxes=problem.obstacles.rectangles,
        discs=problem.obstacles.circles,
        weight=float(problem.obstacle_weight),
        swept=problem.swept,
        lanes=aligned((5, a.size, particles)),
        room=aligned((5, particles)),
    )


@njit(**KERNEL)
def costs(course, signals, total):
    """Write J of each column of signals (L, P) to total (P,); return whether all are finite."""
    key, none = np.uint64(0), 0.0
    return roll(
        course, signals, total, False, signals, signals, total, total, key, 0, none, none, none
    )


@njit(**PART)
def roll(course, signals, total, moving, v, best, better, u_gb, key, drawn, w, g1, g2):
    """`costs`, each row of signals moved just before it is followed, while it is at hand.

    `moving` says whether; what comes after it is then what `move` needs, with draws from `drawn`.
    """
    lanes, room, start, first, rest = (
        course.lanes,
        course.room,
        course.start,
        course.first,
        course.rest,
    )
    x, y, cos, sin, hits = lanes[0], lanes[1], lanes[2], lanes[3], lanes[4]
    cos_u, sin_u, x0, y0, gap = room[0], room[1], room[2], room[3], room[4]
    model, swept, boxes, discs = course.model, course.swept, course.boxes, course.discs
    alone = boxes.shape[0] == 1 and discs.shape[0] == 0
    printed = alone and not swept and model == GENTLE
    for n in range(gap.size):
        gap[n] = 1.0
    for i in range(x.shape[0]):
        for n in range(gap.size):
            x[i, n], y[i, n], hits[i, n] = start[0, i], start[1, i], 0.0
            cos[i, n], sin[i, n] = start[2, i], start[3, i]
    for j in range(signals.shape[0]):
        if moving:
            at = drawn + j * gap.size
            move(signals, v, best, better, j, u_gb[j], key, at, w, g1, g2)
        last = printed and j == signals.shape[0] - 1
        if not last:
            for n in range(gap.size):
                sin_u[n], cos_u[n] = sincos(signals[j, n])
        constant = first if j == 0 else rest
        pieces = course.first_pieces if j == 0 else course.rest_pieces
        for i in range(x.shape[0]):
            if swept:
                for n in range(gap.size):
                    x0[n], y0[n] = x[i, n], y[i, n]
            c0, c1, c2 = constant[0, i], constant[1, i], constant[2, i]
            if last:
                coast_past_one(x, y, cos, sin, i, c0, boxes, hits)
                continue
            if printed:
                gentle_past_one(x, y, cos, sin, cos_u, sin_u, i, c0, c1, boxes, hits)
                continue
            advance(model, pieces, x, y, cos, sin, cos_u, sin_u, i, c0, c1, c2)
            if alone:
                count_one(x0, y0, x, y, i, boxes, swept, hits)
            else:
                count_hits(x0, y0, x, y, i, boxes, discs, swept, gap, hits)
    _sum_up(x, y, hits, course.target, course.weight, total)
    finite = True
    for n in range(total.size):
        finite &= math.isfinite(total[n])
    return finite


@njit(**PART)
def _sum_up(x, y, hits, target, weight, total):
    """Add up (7) and (8) over the robots of each particle."""
    for n in range(total.size):
        total[n] = 0.0
    for i in range(x.shape[0]):
        for n in range(total.size):
            dx, dy = x[i, n] - target[0, i], y[i, n] - target[1, i]
            total[n] += math.sqrt(dx * dx + dy * dy) + weight * hits[i, n]
