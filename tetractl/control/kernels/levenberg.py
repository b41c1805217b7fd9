"""Levenberg-Marquardt on one sequence: drives f(u) of (8) to zero and the path out of obstacles.

The residuals are the 2N coordinates of the misses s_i - tar_i, each robot's scaled by the square
root of its distance so that the sum of squares is f itself (iteratively reweighted least squares),
and, for each robot and obstacle, how deep its deepest predicted position lies inside. L signals
answer for few residuals R, so the damped step is taken in the small space of the residuals:

    du = -J' (J J' + lambda I)^-1 r,      J (R, L).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tetractl.control.kernels.gradient import backward, trace
from tetractl.control.kernels.math import KERNEL, PART
from tetractl.control.kernels.motion import MODELS
from tetractl.core.poses import Floats
from tetractl.core.problem import Problem

LARGEST_STEP = 1.0  # of any signal in one iteration [rad]
DEPTH_WEIGHT = 3.0  # of a depth against a miss
PATIENCE = 6  # iterations over which a hopeful search must ...
PROGRESS = 0.8  # ... bring its cost below this share


class Route(NamedTuple):
    """A problem for one sequence at a time, with the room to polish it in."""

    start: Floats  # (N, 3) x, y, heading
    target: Floats  # (N, 2)
    a: Floats
    v: Floats
    first_period: float
    period: float
    model: int
    boxes: Floats  # (R, 4)
    discs: Floats  # (C, 3)
    weight: float
    swept: bool
    path: Floats  # (N, L, 2)
    slopes: Floats  # (N, L, 5)
    rows: Floats  # (R, L) the Jacobian
    residual: Floats  # (R,)
    gram: Floats  # (R, R)
    step: Floats  # (R,)
    trial: Floats  # (L,)


def lay_route(problem: Problem, length: int) -> Route:
    """Make room to polish sequences of `length` signals."""
    count = problem.a.size
    obstacles = len(problem.obstacles.rectangles) + len(problem.obstacles.circles)
    rows = 2 * count + count * obstacles
    return Route(
        start=problem.poses.array(),
        target=np.ascontiguousarray(problem.targets),
        a=problem.a,
        v=problem.speed,
        first_period=problem.first_period,
        period=problem.period,
        model=MODELS[problem.motion],
        boxes=problem.obstacles.rectangles,
        discs=problem.obstacles.circles,
        weight=float(problem.obstacle_weight),
        swept=problem.swept,
        path=np.empty((count, length, 2)),
        slopes=np.empty((count, length, 5)),
        rows=np.empty((rows, length)),
        residual=np.empty(rows),
        gram=np.empty((rows, rows)),
        step=np.empty(rows),
        trial=np.empty(length),
    )


@njit(**PART)
def _depth(boxes, discs, o, x, y):
    """(depth inside obstacle o, and the unit vector that leads out); depth <= 0 outside."""
    if o < boxes.shape[0]:
        left, right = boxes[o, 0] - x, x - boxes[o, 2]
        below, above = boxes[o, 1] - y, y - boxes[o, 3]
        if max(left, right) > max(below, above):
            return -max(left, right), -1.0 if left > right else 1.0, 0.0
        return -max(below, above), 0.0, -1.0 if below > above else 1.0
    c = o - boxes.shape[0]
    dx, dy = x - discs[c, 0], y - discs[c, 1]
    gap = math.sqrt(dx * dx + dy * dy)
    if gap < 1e-300:
        return discs[c, 2], 1.0, 0.0
    return discs[c, 2] - gap, dx / gap, dy / gap


@njit(**PART)
def _merit(route):
    """f(u) + DEPTH_WEIGHT times the depth of the deepest position of each robot and obstacle."""
    merit = 0.0
    last = route.path.shape[1] - 1
    for i in range(route.a.size):
        dx = route.path[i, last, 0] - route.target[i, 0]
        dy = route.path[i, last, 1] - route.target[i, 1]
        merit += math.sqrt(dx * dx + dy * dy)
        for o in range(route.boxes.shape[0] + route.discs.shape[0]):
            depth = 0.0
            for j in range(last + 1):
                x, y = route.path[i, j, 0], route.path[i, j, 1]
                depth = max(depth, _depth(route.boxes, route.discs, o, x, y)[0])
            merit += DEPTH_WEIGHT * depth
    return merit


@njit(**PART)
def _linearise(route, floor, slack):
    """Fill residuals and Jacobian; return how many rows are in use.

    Obstacles are grown by `slack`, so that what ends on their edge ends outside.
    """
    rows, residual, path = route.rows, route.residual, route.path
    last, r = path.shape[1] - 1, 0
    for i in range(route.a.size):
        dx, dy = path[i, last, 0] - route.target[i, 0], path[i, last, 1] - route.target[i, 1]
        scale = 1 / math.sqrt(max(math.sqrt(dx * dx + dy * dy), floor))
        residual[r], residual[r + 1] = scale * dx, scale * dy
        backward(route.slopes, i, last, scale, 0.0, rows[r])
        backward(route.slopes, i, last, 0.0, scale, rows[r + 1])
        r += 2
    for i in range(route.a.size):
        for o in range(route.boxes.shape[0] + route.discs.shape[0]):
            deepest, where, east, north = -slack, -1, 0.0, 0.0
            for j in range(last + 1):
                x, y = path[i, j, 0], path[i, j, 1]
                depth, e, n = _depth(route.boxes, route.discs, o, x, y)
                if depth > deepest:
                    deepest, where, east, north = depth, j, e, n
            if where >= 0:
                scale = DEPTH_WEIGHT / math.sqrt(max(deepest + slack, floor))
                residual[r] = scale * (deepest + slack)
                backward(route.slopes, i, where, -scale * east, -scale * north, rows[r])
                r += 1
    return r


@njit(**PART)
def _gram(route, r):
    """J J' of the first r rows."""
    rows, gram = route.rows, route.gram
    for p in range(r):
        for q in range(p + 1):
            total = 0.0
            for j in range(rows.shape[1]):
                total += rows[p, j] * rows[q, j]
            gram[p, q] = total


@njit(**PART)
def _solve(gram, residual, step, r, damping, factor):
    """Solve (gram + damping I) step = residual by Cholesky in `factor`; False if it fails."""
    for p in range(r):
        for q in range(p + 1):
            total = gram[p, q] + (damping if p == q else 0.0)
            for k in range(q):
                total -= factor[p, k] * factor[q, k]
            if p == q:
                if not total > 0.0:
                    return False
                factor[p, p] = math.sqrt(total)
            else:
                factor[p, q] = total / factor[q, q]
    for p in range(r):
        total = residual[p]
        for k in range(p):
            total -= factor[p, k] * step[k]
        step[p] = total / factor[p, p]
    for p in range(r - 1, -1, -1):
        total = step[p]
        for k in range(p + 1, r):
            total -= factor[k, p] * step[k]
        step[p] = total / factor[p, p]
    return True


@njit(**PART)
def _propose(route, u, r):
    """Write to route.trial the sequence u - J' step, no signal moved by more than LARGEST_STEP."""
    largest = 0.0
    for j in range(u.size):
        move = 0.0
        for p in range(r):
            move += route.rows[p, j] * route.step[p]
        route.trial[j] = move
        largest = max(largest, abs(move))
    shrink = min(1.0, LARGEST_STEP / largest) if largest > 0 else 1.0
    for j in range(u.size):
        route.trial[j] = u[j] - shrink * route.trial[j]


@njit(**KERNEL)
def polish(route, u, tolerance, slack, iterations, budget, factor, history):
    """Improve u (L,) in place; returns (merit, iterations used, evaluations).

    Ends when the merit is at most `tolerance`, when no step helps, when PATIENCE is at its end,
    after `iterations`, or before `budget` evaluations are exceeded. history[z] is the merit after z
    iterations, of room iterations + 1. A Jacobian counts as one evaluation for each of its rows.
    """
    start, a, v, t0, t = route.start, route.a, route.v, route.first_period, route.period
    trace(u, start, a, v, t0, t, route.model, route.path, route.slopes)
    merit = _merit(route)
    history[0] = merit
    evaluations, damping = 1, 1e-2
    z = 0
    most = route.residual.size + 1  # evaluations of one iteration
    while z < iterations and evaluations + most <= budget and not merit <= tolerance:
        r = _linearise(route, max(tolerance, 1e-9), slack)
        _gram(route, r)
        evaluations += r
        size = 0.0
        for p in range(r):
            size += route.gram[p, p] / r
        better = False
        while z < iterations and damping < 1e4 and evaluations < budget:
            z += 1
            history[z] = merit
            if _solve(route.gram, route.residual, route.step, r, damping * size, factor):
                _propose(route, u, r)
                trace(route.trial, start, a, v, t0, t, route.model, route.path, route.slopes)
                evaluations += 1
                new = _merit(route)
                if new < merit:
                    better = True
                    for j in range(u.size):
                        u[j] = route.trial[j]
                    merit = new
                    history[z] = merit
                    damping = max(0.2 * damping, 1e-10)
                    break
            damping *= 5
        if not better or (z >= PATIENCE and merit > PROGRESS * history[z - PATIENCE]):
            break
    return merit, z, evaluations
