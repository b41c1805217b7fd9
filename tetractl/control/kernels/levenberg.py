"""Levenberg-Marquardt on one sequence: drives f(u) of (8) to zero and the path out of obstacles.

For a sequence u of L signals, s_i are the predicted last positions of the N robots, d_io is how
deep the predicted positions of robot i come into obstacle o, and d_ik by how much robots i and k
come nearer than their separation [length unit]. The merit, which bounds f from above, is

    m(u) = sqrt(N sum_i |s_i - tar_i|^2) + W (sum_io max(0, d_io) + sum_ik max(0, d_ik))

with W = `DEPTH_WEIGHT`. The R residuals r are the 2N coordinates of the misses and the depths that
are above zero, each times a factor of its own:

    r = c (s_i - tar_i),  c^2 = 1 / sqrt(sum_i |s_i - tar_i|^2 / N);     r = c d,  c^2 = W^2 / d

so that the squares of the misses add up to the first term of m. In the Jacobian J = dr/du, (R, L),
the factors c count as constants: J' r is the slope of m, with W^2 in place of W. There are far
fewer residuals than signals, so the damped step is computed from an R x R system:

    (J J' + lambda mu I) y = r,     mu = trace(J J') / R,     u <- u - J' y

A step that lowers the merit is taken, and lambda falls; else lambda grows, and the step is tried
again (Marquardt, SIAM Journal 11, 1963).

`polish` is that loop. `judge` returns the cost J of (7) of what came out, which counts obstacles
as the paper does. Both work in the arrays of a `Polish`; `lay_out_polish` makes one for a problem.
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
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, inlined

Integers = NDArray[np.int64]
_wrap = inlined(polynomials.wrap)

LARGEST_STEP = 1.0  # largest change of a signal in one iteration [rad]
DEPTH_WEIGHT = 3.0  # W, weight of a depth relative to a miss
PROGRESS = 0.8  # the merit must fall to this part of itself in `patience` iterations
DAMPING_FIRST = 1e-2  # lambda of the first step
DAMPING_LEAST = 1e-10  # lambda falls no lower
DAMPING_MOST = 1e4  # a polish ends if lambda reaches this: no step helps
EASED = 0.2  # lambda is multiplied by this after a step that is taken
STIFFENED = 5  # lambda is multiplied by this after a step that is not taken
FLOOR_LEAST = 1e-9  # the factors c are limited as if misses and depths were no less [length unit]


class Pulls(NamedTuple):
    """How residuals depend on positions: entry e says that residual `residual[e]` has the
    derivatives `east[e]` and `north[e]` by x and y of robot `robot[e]` after signal `signal[e]`.

    A miss or a depth depends on one position, a meeting of two robots on two.
    """

    residual: Integers
    robot: Integers
    signal: Integers
    east: Floats
    north: Floats


class Scratch(NamedTuple):
    """The working arrays for polishing one sequence at a time, of N robots, L signals, O obstacles
    and walls, at most R residuals; M = width(L)."""

    traced: Trace
    near: Floats  # (M,)
    x_before: Floats  # (L,) positions of one robot before each signal
    y_before: Floats  # (L,)
    clearance: Floats  # (L,) of one robot
    hits: Floats  # (N, M) number of obstacles and robots that each robot touches
    depths: Floats  # (N, O) d_io, the depth of each robot's deepest position in each obstacle
    deepest: Integers  # (N, O) number of the signal after which it has that position
    meetings: Floats  # (pairs,) d_ik, separation minus the least distance of each pair of robots
    nearest: Integers  # (pairs,) number of the signal after which they have that distance
    pulls: Pulls  # (R + pairs,) each
    rows: Floats  # (R, L) the Jacobian J
    residual: Floats  # (R,) r
    gram: Floats  # (R, R) J J', lower triangle
    factor: Floats  # (R, R) Cholesky factor of the damped J J', lower triangle
    step: Floats  # (R,) y
    trial: Floats  # (L,) the sequence that is tried
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
    flat_problem = flat(problem)
    obstacles = problem.obstacles
    keeps_apart = problem.separation > 0
    return Polish(
        start=flat_problem.start,
        turned=flat_problem.turned,
        target=np.ascontiguousarray(problem.targets),
        parameters=flat_problem.parameters,
        drift=flat_problem.drift,
        first_period=problem.first_period,
        period=problem.period,
        first=flat_problem.first,
        rest=flat_problem.rest,
        shapes=obstacles.rows,
        walls=obstacles.walls,
        separation=float(problem.separation),
        weight=float(problem.obstacle_weight),
        swept=problem.swept,
        room=_scratch(get_ident(), problem.a.size, obstacles.count, keeps_apart, length),
    )


@lru_cache(maxsize=64)
def _scratch(thread: int, robots: int, obstacles: int, keeps_apart: bool, length: int) -> Scratch:
    """Return the scratch arrays of one thread for robots, obstacles and signals of these numbers;
    `keeps_apart` if robots keep a separation."""
    pairs = robots * (robots - 1) // 2 if keeps_apart else 0
    residuals = 2 * robots + robots * obstacles + pairs
    across = width(length)
    return Scratch(
        traced=workspace(robots, length),
        near=np.empty(across),
        x_before=np.empty(length),
        y_before=np.empty(length),
        clearance=np.empty(length),
        hits=np.empty((robots, across)),
        depths=np.empty((robots, obstacles)),
        deepest=np.empty((robots, obstacles), dtype=np.int64),
        meetings=np.empty(pairs),
        nearest=np.empty(pairs, dtype=np.int64),
        pulls=Pulls(
            residual=np.empty(residuals + pairs, dtype=np.int64),
            robot=np.empty(residuals + pairs, dtype=np.int64),
            signal=np.empty(residuals + pairs, dtype=np.int64),
            east=np.empty(residuals + pairs),
            north=np.empty(residuals + pairs),
        ),
        rows=np.empty((residuals, length)),
        residual=np.empty(residuals),
        gram=np.empty((residuals, residuals)),
        factor=np.empty((residuals, residuals)),
        step=np.empty(residuals),
        trial=np.empty(length),
        damping=np.empty(1),
    )


@compiled(**INLINE_FAST)
def polish(work, u, tolerance, slack, iterations, patience, budget, history, z, pause):
    """Improve u (L,) in place; returns (iterations used, evaluations).

    Ends when the merit is at most `tolerance`, when no step helps, when the merit has not fallen to
    PROGRESS of itself over `patience` iterations, after `iterations`, or before `budget`
    evaluations are exceeded. An iteration tries one step; history[z] is the merit after z of them,
    (iterations + 1,). A Jacobian counts as one evaluation for each of its rows.

    A polish may be interrupted when a step was taken and `pause` iterations are done; then
    `damping` is finite, and the next call continues at iteration `z`. It returns the evaluations
    of that call alone.
    """
    room = work.room
    damping = DAMPING_FIRST if z == 0 else room.damping[0]
    evaluations = 1 if z == 0 else 0  # continued: u was evaluated before the interruption
    room.damping[0] = math.inf
    most = room.residual.size + 1  # largest number of evaluations for one step that is taken
    floor = max(tolerance, FLOOR_LEAST)
    predict_path(work, u)
    merit = measure(work, slack)
    history[z] = merit
    while merit > tolerance and z < iterations and evaluations + most <= budget:
        if z >= pause:
            room.damping[0] = damping
            break
        residuals = linearise(work, floor, slack)
        evaluations += residuals
        mean_square = _square_jacobian(room, residuals)
        lower = merit
        while z < iterations and damping < DAMPING_MOST and evaluations < budget:
            z += 1
            history[z] = merit
            if _solve(room, residuals, damping * mean_square):
                _step(room, u, residuals)
                evaluations += 1
                predict_path(work, room.trial)
                lower = measure(work, slack)
                if lower < merit:
                    break
            damping *= STIFFENED
        if not lower < merit:
            break
        merit = lower
        history[z] = merit
        for j in range(u.size):
            u[j] = room.trial[j]
        damping = max(EASED * damping, DAMPING_LEAST)
        if z >= patience and merit > PROGRESS * history[z - patience]:
            break
    return z, evaluations


@compiled(**INLINE_FAST)
def predict_path(work, u):
    """Predict the path under signals u (L,), and its gradients: fill `traced`."""
    trace(
        u,
        work.turned,
        work.parameters,
        work.drift,
        work.first_period,
        work.period,
        work.first,
        work.rest,
        work.room.traced,
    )


@compiled(**INLINE_FAST)
def measure(work, slack):
    """Return the merit m of the path in `traced`; fill `depths` and `meetings` with the d_io and
    d_ik, which are -slack for robots that come no nearer to an obstacle than that.
    """
    room = work.room
    path = room.traced.path
    length = room.rows.shape[1]
    robots = len(work.target)
    find_deepest(
        work.shapes, work.walls, path, length, -slack, room.near, room.depths, room.deepest
    )
    merit = math.sqrt(robots * _squared_misses(work))
    for i in range(robots):
        for o in range(room.depths.shape[1]):
            merit += DEPTH_WEIGHT * max(0.0, room.depths[i, o])
    if room.meetings.size:
        _find_meetings(work)
        for pair in range(room.meetings.size):
            merit += DEPTH_WEIGHT * max(0.0, room.meetings[pair])
    return merit


@compiled(**INLINE_FAST)
def _squared_misses(work):
    """Return sum_i |s_i - tar_i|^2."""
    path = work.room.traced.path
    last = work.room.rows.shape[1] - 1
    total = 0.0
    for i in range(len(work.target)):
        dx = path[0, i, last] - work.target[i, 0]
        dy = path[1, i, last] - work.target[i, 1]
        total += dx * dx + dy * dy
    return total


@compiled(**INLINE_FAST)
def _find_meetings(work):
    """Fill `meetings` and `nearest` for each pair of robots."""
    room = work.room
    path = room.traced.path
    pair = 0
    for i in range(len(work.target)):
        for k in range(i):
            least = math.inf
            signal = 0
            for j in range(room.rows.shape[1]):
                dx = path[0, i, j] - path[0, k, j]
                dy = path[1, i, j] - path[1, k, j]
                square = dx * dx + dy * dy
                if square < least:
                    least = square
                    signal = j
            room.meetings[pair] = work.separation - math.sqrt(least)
            room.nearest[pair] = signal
            pair += 1


@compiled(**INLINE_FAST)
def linearise(work, floor, slack):
    """Fill `residual` and the Jacobian `rows` for the path of the last `measure`; return the number
    of residuals.

    Obstacles are grown by `slack`, so that a path pushed to their edge ends outside. `floor` limits
    the factors c where a miss or a depth is nearly zero.
    """
    room = work.room
    _pull_to_targets(work, floor)
    residuals = 2 * len(work.target)
    residuals = _push_out_of_obstacles(work, floor, slack, residuals)
    pulls = residuals  # so far, each residual depends on one position
    if room.meetings.size:
        pulls, residuals = _push_apart(work, floor, slack, residuals)
    for r in range(residuals):
        for j in range(room.rows.shape[1]):
            room.rows[r, j] = 0.0
    for e in range(pulls):
        backward(
            room.traced.gradients,
            room.pulls.robot[e],
            room.pulls.signal[e],
            room.pulls.east[e],
            room.pulls.north[e],
            room.rows[room.pulls.residual[e]],
        )
    return residuals


@compiled(**INLINE_FAST)
def _pull_to_targets(work, floor):
    """Write the 2N residuals of the misses, r = c (s_i - tar_i)."""
    room = work.room
    path = room.traced.path
    last = room.rows.shape[1] - 1
    root_mean_square = math.sqrt(_squared_misses(work) / len(work.target))
    c = 1 / math.sqrt(max(root_mean_square, floor))
    for i in range(len(work.target)):
        r = 2 * i
        room.residual[r] = c * (path[0, i, last] - work.target[i, 0])
        _write_pull(room.pulls, r, r, i, last, c, 0.0)
        room.residual[r + 1] = c * (path[1, i, last] - work.target[i, 1])
        _write_pull(room.pulls, r + 1, r + 1, i, last, 0.0, c)


@compiled(**INLINE_FAST)
def _push_out_of_obstacles(work, floor, slack, residuals):
    """Write a residual r = c d for each depth d_io above zero; return the number of residuals."""
    room = work.room
    path = room.traced.path
    r = residuals
    for i in range(len(work.target)):
        for o in range(room.depths.shape[1]):
            depth = room.depths[i, o] + slack
            if depth > 0:
                signal = room.deepest[i, o]
                east, north = outward(
                    work.shapes, work.walls, o, path[0, i, signal], path[1, i, signal]
                )
                c = DEPTH_WEIGHT / math.sqrt(max(depth, floor))
                room.residual[r] = c * depth
                _write_pull(room.pulls, r, r, i, signal, -c * east, -c * north)
                r += 1
    return r


@compiled(**INLINE_FAST)
def _push_apart(work, floor, slack, residuals):
    """Write a residual r = c d for each d_ik above zero, which depends on two positions; return the
    numbers of pulls and of residuals.
    """
    room = work.room
    path = room.traced.path
    r = residuals
    e = residuals
    pair = 0
    for i in range(len(work.target)):
        for k in range(i):
            depth = room.meetings[pair] + slack
            signal = room.nearest[pair]
            pair += 1
            if depth > 0:
                dx = path[0, i, signal] - path[0, k, signal]
                dy = path[1, i, signal] - path[1, k, signal]
                distance = math.sqrt(dx * dx + dy * dy)
                c = DEPTH_WEIGHT / math.sqrt(max(depth, floor))
                share = c / distance if distance > 0 else 0.0
                room.residual[r] = c * depth
                _write_pull(room.pulls, e, r, i, signal, -share * dx, -share * dy)
                _write_pull(room.pulls, e + 1, r, k, signal, share * dx, share * dy)
                e += 2
                r += 1
    return e, r


@compiled(**INLINE_FAST)
def _write_pull(pulls, e, residual, robot, signal, east, north):
    """Write entry e of `Pulls`."""
    pulls.residual[e] = residual
    pulls.robot[e] = robot
    pulls.signal[e] = signal
    pulls.east[e] = east
    pulls.north[e] = north


@compiled(**INLINE_FAST)
def _square_jacobian(room, residuals):
    """Fill `gram` with J J'; return mu, the mean of its diagonal."""
    rows = room.rows
    for p in range(residuals):
        for q in range(p + 1):
            total = 0.0
            for j in range(rows.shape[1]):
                total += rows[p, j] * rows[q, j]
            room.gram[p, q] = total
    mean = 0.0
    for p in range(residuals):
        mean += room.gram[p, p] / residuals
    return mean


@compiled(**INLINE_FAST)
def _solve(room, residuals, damping):
    """Solve (J J' + damping I) step = residual; return whether the matrix is positive definite."""
    if not _factorise(room, residuals, damping):
        return False
    _substitute(room, residuals)
    return True


@compiled(**INLINE_FAST)
def _factorise(room, residuals, damping):
    """Fill `factor` with F of F F' = J J' + damping I (Cholesky); return whether there is one."""
    gram = room.gram
    factor = room.factor
    for p in range(residuals):
        for q in range(p):
            total = gram[p, q]
            for k in range(q):
                total -= factor[p, k] * factor[q, k]
            factor[p, q] = total / factor[q, q]
        total = gram[p, p] + damping
        for k in range(p):
            total -= factor[p, k] * factor[p, k]
        if not total > 0.0:
            return False
        factor[p, p] = math.sqrt(total)
    return True


@compiled(**INLINE_FAST)
def _substitute(room, residuals):
    """Solve F F' step = residual, F in `factor`: F z = residual, then F' step = z."""
    factor = room.factor
    step = room.step
    for p in range(residuals):
        total = room.residual[p]
        for k in range(p):
            total -= factor[p, k] * step[k]
        step[p] = total / factor[p, p]
    for p in range(residuals - 1, -1, -1):
        total = step[p]
        for k in range(p + 1, residuals):
            total -= factor[k, p] * step[k]
        step[p] = total / factor[p, p]


@compiled(**INLINE_FAST)
def _step(room, u, residuals):
    """Write u - b J' step to `trial`; b <= 1 keeps every change within LARGEST_STEP."""
    largest = 0.0
    for j in range(u.size):
        change = 0.0
        for p in range(residuals):
            change += room.rows[p, j] * room.step[p]
        room.trial[j] = change
        largest = max(largest, abs(change))
    b = min(1.0, LARGEST_STEP / largest) if largest > 0 else 1.0
    for j in range(u.size):
        room.trial[j] = u[j] - b * room.trial[j]


@compiled(**INLINE_FAST)
def judge(work, u):
    """Wrap u (L,) into [-pi, pi] in place, and return J of (7) of its path."""
    for j in range(u.size):
        u[j] = _wrap(u[j])
    predict_path(work, u)
    return _sum_of_distances(work) + work.weight * _sum_of_hits(work)


@compiled(**INLINE_FAST)
def _sum_of_distances(work):
    """Return f of (8) of the path in `traced`."""
    path = work.room.traced.path
    last = work.room.rows.shape[1] - 1
    total = 0.0
    for i in range(len(work.target)):
        dx = path[0, i, last] - work.target[i, 0]
        dy = path[1, i, last] - work.target[i, 1]
        total += math.sqrt(dx * dx + dy * dy)
    return total


@compiled(**INLINE_FAST)
def _sum_of_hits(work):
    """Return P of (9) of the path in `traced`."""
    room = work.room
    x = room.traced.path[0]
    y = room.traced.path[1]
    length = room.rows.shape[1]
    for i in range(len(work.target)):
        room.x_before[0] = work.start[i, 0]
        room.y_before[0] = work.start[i, 1]
        for j in range(length - 1):
            room.x_before[j + 1] = x[i, j]
            room.y_before[j + 1] = y[i, j]
        for j in range(length):
            room.hits[i, j] = 0.0
        count_hits(
            work.shapes,
            work.walls,
            room.x_before,
            room.y_before,
            x,
            y,
            i,
            work.swept,
            room.clearance,
            room.near,
            room.hits,
        )
    if work.separation > 0:
        count_meetings(x, y, work.separation, room.hits)
    total = 0.0
    for i in range(len(work.target)):
        for j in range(length):
            total += room.hits[i, j]
    return total
