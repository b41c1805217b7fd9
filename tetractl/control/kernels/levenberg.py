"""Levenberg-Marquardt on one sequence: drives f(u) of (8) to zero and the path out of obstacles.

The residuals are the 2N coordinates of the misses s_i - tar_i, scaled by one factor so that the sum
of their squares is sqrt(N sum_i |s_i - tar_i|^2), which f never exceeds, and, for each robot and
obstacle, the greatest depth of its predicted positions inside; and for each pair of robots, by how
much they come nearer than their separation. There are far fewer residuals R than signals L, so the
damped step is computed from an R x R system:

    du = -J' (J J' + lambda I)^-1 r,      J (R, L).

A step that lowers the merit, `_merit`, is taken, and lambda falls; else lambda grows, and the step
is tried again (Marquardt, SIAM Journal 11, 1963).
"""

import math
from functools import lru_cache
from threading import get_ident
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.control.kernels.gradient import Trace, backward, trace, width, workspace
from tetractl.control.kernels.motion import flat
from tetractl.control.kernels.obstacles import count_hits, find_deepest, outward
from tetractl.control.kernels.rollout import count_meetings
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import INLINE_FAST, inlined
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials
from tetractl.model.motion.motion import DIRECTION

Integers = NDArray[np.int64]
_wrap = inlined(polynomials.wrap)

LARGEST_STEP = DIRECTION.largest_step
DEPTH_WEIGHT = 3.0  # weight of a depth relative to a miss
PROGRESS = 0.8  # the merit must fall by this factor in `patience` iterations


class Scratch(NamedTuple):
    """The working arrays for polishing one sequence at a time, of N robots, L signals, O obstacles,
    R residuals."""

    traced: Trace
    near: Floats  # (M,)
    before: Floats  # (3, L) positions of one robot before each signal, and its clearance
    hits: Floats  # (N, M) number of obstacles and robots that each robot touches
    depths: Floats  # (N, O) depth of each robot's deepest position in each obstacle
    where: Integers  # (N, O) index of that position
    meetings: Floats  # (pairs,) separation minus the least distance of each pair of robots
    nearest: Integers  # (pairs,) index of the positions with that least distance
    pulls: Floats  # (R + pairs, 5) residual, robot, index of a position, and derivatives by x and y
    rows: Floats  # (R, L) the Jacobian
    residual: Floats  # (R,)
    gram: Floats  # (R, R)
    factor: Floats  # (R, R)
    step: Floats  # (R,)
    trial: Floats  # (L,)
    damping: Floats  # (1,) with which a polish that was interrupted continues, inf if it has ended


class Polish(NamedTuple):
    """A problem, and room for polishing one sequence at a time."""

    start: Floats  # (N, 3) x, y, heading
    turned: Floats  # (4, N) x, y, cos and sin of the heading
    target: Floats  # (N, 2)
    parameters: Floats  # (N, K) of the motion
    drift: Floats  # (4, N) cos and sin of the bias, flow
    first_period: float
    period: float
    first: Any  # `Lanes`, constants of the motion for the first signal
    rest: Any  # `Lanes`, the same for the other signals
    shapes: Floats  # `Obstacles.rows`
    walls: Floats  # `Obstacles.walls`
    separation: float  # least distance of two robots, 0 for robots that may meet
    weight: float  # of a hit in J
    swept: bool
    room: Scratch


@lru_cache(maxsize=4)  # lengths searched for one problem
def lay_out_polish(problem: Problem, length: int) -> Polish:
    """Return a problem with the scratch arrays for sequences of `length` signals, which other
    problems of the same shape laid out in this thread use too."""
    of, obstacles = flat(problem), problem.obstacles
    paired = problem.separation > 0
    return Polish(
        of.start,
        of.turned,
        np.ascontiguousarray(problem.targets),
        of.parameters,
        of.drift,
        problem.first_period,
        problem.period,
        of.first,
        of.rest,
        obstacles.rows,
        obstacles.walls,
        float(problem.separation),
        float(problem.obstacle_weight),
        problem.swept,
        _scratch(get_ident(), problem.a.size, obstacles.count, paired, length),
    )


@lru_cache(maxsize=64)
def _scratch(thread: int, count: int, obstacles: int, paired: bool, length: int) -> Scratch:
    """Return the scratch arrays of one thread for robots, obstacles and signals of these numbers;
    `paired` if robots keep a separation."""
    pairs = count * (count - 1) // 2 if paired else 0
    rows, across = 2 * count + count * obstacles + pairs, width(length)
    return Scratch(
        traced=workspace(count, length),
        near=np.empty(across),
        before=np.empty((3, length)),
        hits=np.empty((count, across)),
        depths=np.empty((count, obstacles)),
        where=np.empty((count, obstacles), dtype=np.int64),
        meetings=np.empty(pairs),
        nearest=np.empty(pairs, dtype=np.int64),
        pulls=np.empty((rows + pairs, 5)),
        rows=np.empty((rows, length)),
        residual=np.empty(rows),
        gram=np.empty((rows, rows)),
        factor=np.empty((rows, rows)),
        step=np.empty(rows),
        trial=np.empty(length),
        damping=np.empty(1),
    )


@compiled(**INLINE_FAST)
def _trace(work, u):
    """Predict the path under signals u, and its gradients."""
    motion = work.drift, work.first_period, work.period, work.first, work.rest
    trace(u, work.turned, work.parameters, *motion, work.room.traced)


@compiled(**INLINE_FAST)
def _merit(work, slack):
    """Return the bound of f(u) plus DEPTH_WEIGHT times the sum of all depths in obstacles and
    meetings; find the depths of positions that are within `slack` of an obstacle.
    """
    room = work.room
    path, length = room.traced.path, room.rows.shape[1]
    shapes, walls, depths = work.shapes, work.walls, room.depths
    find_deepest(shapes, walls, path, length, -slack, room.near, depths, room.where)
    merit = 0.0
    last = length - 1
    for i in range(len(work.target)):
        dx = path[0, i, last] - work.target[i, 0]
        dy = path[1, i, last] - work.target[i, 1]
        merit += dx * dx + dy * dy
    merit = math.sqrt(len(work.target) * merit)
    for i in range(len(work.target)):
        for o in range(room.depths.shape[1]):
            merit += DEPTH_WEIGHT * max(0.0, room.depths[i, o])
    if room.meetings.size:
        _find_meetings(work)
        for m in range(room.meetings.size):
            merit += DEPTH_WEIGHT * max(0.0, room.meetings[m])
    return merit


@compiled(**INLINE_FAST)
def _find_meetings(work):
    """Find the nearest positions of each pair of robots, and the separation minus their
    distance.
    """
    room = work.room
    path, m = room.traced.path, 0
    for i in range(len(work.target)):
        for k in range(i):
            least, at = math.inf, 0
            for j in range(room.rows.shape[1]):
                dx, dy = path[0, i, j] - path[0, k, j], path[1, i, j] - path[1, k, j]
                square = dx * dx + dy * dy
                if square < least:
                    least, at = square, j
            room.meetings[m], room.nearest[m] = work.separation - math.sqrt(least), at
            m += 1


@compiled(**INLINE_FAST)
def _pull(pulls, e, r, i, at, east, north):
    """Write one pull: residual r has the derivatives (east, north) by position `at` of robot i."""
    pulls[e, 0], pulls[e, 1], pulls[e, 2], pulls[e, 3], pulls[e, 4] = r, i, at, east, north


@compiled(**INLINE_FAST)
def _linearise(work, floor, slack):
    """Fill residuals and Jacobian for the path of the last `_merit`; return the number of rows.

    Obstacles are grown by `slack`, so that a path pushed to their edge ends outside. Each residual
    is linear in one position or, for two robots that meet, in two: the pulls.
    """
    room = work.room
    rows, residual, path, pulls = room.rows, room.residual, room.traced.path, room.pulls
    last, r, squares = rows.shape[1] - 1, 0, 0.0
    for i in range(len(work.target)):
        dx, dy = path[0, i, last] - work.target[i, 0], path[1, i, last] - work.target[i, 1]
        squares += dx * dx + dy * dy
    scale = 1 / math.sqrt(max(math.sqrt(squares / len(work.target)), floor))
    for i in range(len(work.target)):
        residual[r] = scale * (path[0, i, last] - work.target[i, 0])
        residual[r + 1] = scale * (path[1, i, last] - work.target[i, 1])
        _pull(pulls, r, r, i, last, scale, 0.0)
        _pull(pulls, r + 1, r + 1, i, last, 0.0, scale)
        r += 2
    for i in range(len(work.target)):
        for o in range(room.depths.shape[1]):
            deepest, at = room.depths[i, o] + slack, room.where[i, o]
            if deepest > 0:
                x, y = path[0, i, at], path[1, i, at]
                east, north = outward(work.shapes, work.walls, o, x, y)
                scale = DEPTH_WEIGHT / math.sqrt(max(deepest, floor))
                residual[r] = scale * deepest
                _pull(pulls, r, r, i, at, -scale * east, -scale * north)
                r += 1
    e, m = r, 0
    for i in range(len(work.target) if room.meetings.size else 0):
        for k in range(i):
            depth, at = room.meetings[m] + slack, room.nearest[m]
            m += 1
            if depth > 0:
                dx, dy = path[0, i, at] - path[0, k, at], path[1, i, at] - path[1, k, at]
                apart = math.sqrt(dx * dx + dy * dy)
                scale = DEPTH_WEIGHT / math.sqrt(max(depth, floor))
                share = scale / apart if apart > 0 else 0.0
                residual[r] = scale * depth
                _pull(pulls, e, r, i, at, -share * dx, -share * dy)
                _pull(pulls, e + 1, r, k, at, share * dx, share * dy)
                e, r = e + 2, r + 1
    for p in range(r):
        for j in range(last + 1):
            rows[p, j] = 0.0
    for p in range(e):
        backward(room.traced.gradients, pulls[p], rows)
    return r


@compiled(**INLINE_FAST)
def _gram(work, r):
    """Compute J J' of the first r rows."""
    room = work.room
    rows, gram = room.rows, room.gram
    for p in range(r):
        for q in range(p + 1):
            total = 0.0
            for j in range(rows.shape[1]):
                total += rows[p, j] * rows[q, j]
            gram[p, q] = total


@compiled(**INLINE_FAST)
def _solve(room, r, damping):
    """Solve (gram + damping I) step = residual by Cholesky in `factor`; False if it fails."""
    gram, residual, step, factor = room.gram, room.residual, room.step, room.factor
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


@compiled(**INLINE_FAST)
def _propose(work, u, r):
    """Write u - c J' step to `trial`; c <= 1 keeps every change within LARGEST_STEP."""
    room = work.room
    largest = 0.0
    for j in range(u.size):
        move = 0.0
        for p in range(r):
            move += room.rows[p, j] * room.step[p]
        room.trial[j] = move
        largest = max(largest, abs(move))
    shrink = min(1.0, LARGEST_STEP / largest) if largest > 0 else 1.0
    for j in range(u.size):
        room.trial[j] = u[j] - shrink * room.trial[j]


@compiled(**INLINE_FAST)
def polish(work, u, tolerance, slack, iterations, patience, budget, history, z, pause):
    """Improve u (L,) in place; returns (iterations used, evaluations).

    A polish may be interrupted at iteration `pause`; it continues at iteration `z`, with the
    evaluations since then.

    Ends when the merit is at most `tolerance`, when no step helps, when it has not fallen to
    PROGRESS of itself over `patience` iterations, after `iterations`, or before `budget`
    evaluations are exceeded. history[z] is the merit after z iterations, (iterations + 1,). A
    Jacobian counts as one evaluation for each of its rows.
    """
    room = work.room
    evaluations, damping = (1, 1e-2) if z == 0 else (0, room.damping[0])
    room.damping[0] = math.inf
    most = room.residual.size + 1  # largest number of evaluations in one iteration
    merit, begins, r, size = math.inf, True, 0, 0.0
    for j in range(u.size):
        room.trial[j] = u[j]
    while True:
        _trace(work, room.trial)
        new = _merit(work, slack)
        if begins or new < merit:
            merit = history[z] = new
            for j in range(u.size):
                u[j] = room.trial[j]
            if not begins:
                damping = max(0.2 * damping, 1e-10)
                if z >= patience and merit > PROGRESS * history[z - patience]:
                    break
            begins = False
            if z >= iterations or evaluations + most > budget or merit <= tolerance:
                break
            if z >= pause:
                room.damping[0] = damping
                break
            r = _linearise(work, max(tolerance, 1e-9), slack)
            _gram(work, r)
            evaluations += r
            size = 0.0
            for p in range(r):
                size += room.gram[p, p] / r
        else:
            damping *= 5
        solved = False
        while not solved and z < iterations and damping < 1e4 and evaluations < budget:
            z += 1
            history[z] = merit
            solved = _solve(room, r, damping * size)
            if not solved:
                damping *= 5
        if not solved:
            break
        _propose(work, u, r)
        evaluations += 1
    return z, evaluations


@compiled(**INLINE_FAST)
def score(work, length):
    """Return f of (8) and P of (9) of the path in `traced` after `length` signals."""
    room = work.room
    path, hits, before = room.traced.path, room.hits, room.before
    x, y, x0, y0, gap, last = path[0], path[1], before[0], before[1], before[2], length - 1
    target = obstacle = 0.0
    for i in range(len(work.target)):
        x0[0], y0[0] = work.start[i, 0], work.start[i, 1]
        for j in range(last):
            x0[j + 1], y0[j + 1] = x[i, j], y[i, j]
        for j in range(length):
            hits[i, j] = 0.0
        rows, walls, swept = work.shapes, work.walls, work.swept
        count_hits(rows, walls, x0, y0, x, y, i, swept, gap, room.near, hits)
        dx, dy = x[i, last] - work.target[i, 0], y[i, last] - work.target[i, 1]
        target += math.sqrt(dx * dx + dy * dy)
    if work.separation > 0:
        count_meetings(x, y, work.separation, hits)
    for i in range(len(work.target)):
        for j in range(length):
            obstacle += hits[i, j]
    return target, obstacle


@compiled(**INLINE_FAST)
def judge(work, u):
    """Wrap u (L,) into [-pi, pi] in place, and return J of (7) of its path."""
    for j in range(u.size):
        u[j] = _wrap(u[j])
    _trace(work, u)
    target, obstacle = score(work, u.size)
    return target + work.weight * obstacle
