"""Levenberg-Marquardt, a least-squares method, for one sequence of control signals.

It drives robots' final distances from their targets, f(u) of the paper's equation (8), to zero, and
pushes the path out of obstacles. For a sequence u of L signals, s_i are the predicted final
positions of the N robots. d_io is how deep the predicted positions of robot i enter obstacle o.
d_ik is by how much robots i and k come closer than their separation [length unit]. The merit, which
bounds f from above, is

    m(u) = sqrt(N sum_i |s_i - tar_i|^2) + W (sum_io max(0, d_io) + sum_ik max(0, d_ik))

with W = `DEPTH_WEIGHT`. A miss is the vector from a robot's target to its final position. The R
residuals r are the 2N coordinates of the misses and the depths above zero. Each is multiplied by
its own factor:

    r = c (s_i - tar_i),  c^2 = 1 / sqrt(sum_i |s_i - tar_i|^2 / N);     r = c d,  c^2 = W^2 / d

so that the squares of the misses add up to the first term of m. In the Jacobian J = dr/du, (R, L),
the factors c count as constants: J' r is the slope of m, with W^2 instead of W. There are far fewer
residuals than signals, so the damped step is computed from an R x R system:

    (J J' + lambda mu I) y = r,     mu = trace(J J') / R,     u <- u - J' y

If a step lowers the merit, it is taken, and lambda falls. Otherwise lambda grows, and the step is
tried again (Marquardt, SIAM Journal 11, 1963).

`polish` is the loop over such steps. `judge` returns the cost J of (7) for the result, which counts
obstacles as the paper does. Both take a `FlatProblem`, and use the working arrays of a `Room`.
"""

import math
from functools import lru_cache
from threading import get_ident
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.control.search.kernels.gradient import Trace, backward, trace, width
from tetractl.control.search.kernels.obstacles import Contacts, count_hits, find_deepest, outward
from tetractl.control.search.kernels.rollout import count_meetings
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, PART_FAST, inlined

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


class PolishSettings(NamedTuple):
    """When the polish of one sequence ends, and how far it keeps the path from obstacles."""

    tolerance: float
    """Merit at which the polish ends, because the sequence is good enough [length unit]."""
    slack: float
    """Minimum clearance of a path that is pushed out of an obstacle [length unit]."""
    patience: int
    """Number of iterations in which the merit must fall to PROGRESS times its value."""
    iterations_max: int
    """Maximum number of iterations. The array `merits` must be longer than this."""


POLISH_STATE = np.dtype(
    [
        ("iterations", np.int64),  # that are done
        ("evaluations", np.int64),  # that they took; 0 before the polish begins
        ("damping", np.float64),  # lambda of the next step
    ]
)
"""The progress of a polish, from which it continues after an interruption."""


class Room(NamedTuple):
    """The working arrays for improving one sequence of signals, allocated once and reused.

    Sizes: N robots, L signals, O obstacles and walls, M = width(L). R is the maximum number of
    residuals of the least-squares problem.
    """

    path: Trace
    contacts: Contacts  # of the path; hits (N, M), the other arrays (L,)
    box_depth: Floats  # (M,) how deep one robot is in the box around an obstacle
    depths: Floats  # (N, O) d_io, the depth of each robot's deepest position in each obstacle
    deepest: Integers  # (N, O) number of the signal after which it has that position
    meetings: Floats  # (pairs,) d_ik, separation minus the least distance of each pair of robots
    nearest: Integers  # (pairs,) number of the signal after which they have that distance
    rows: Floats  # (R, L) the Jacobian J
    residual: Floats  # (R,) r
    gram: Floats  # (R, R) J J', lower triangle
    factor: Floats  # (R, R) Cholesky factor of the damped J J', lower triangle
    step: Floats  # (R,) y
    trial: Floats  # (L,) the sequence that is tried


def room_for(problem: Problem, length: int) -> Room:
    """Return the working arrays of this thread for a problem and sequences of `length` signals.

    Problems with the same numbers of robots, obstacles and signals share them.
    """
    robots = len(problem.a)
    pairs = robots * (robots - 1) // 2 if problem.separation > 0 else 0
    return _room_for(get_ident(), robots, problem.obstacles.count, pairs, length)


@lru_cache(maxsize=64)
def _room_for(thread: int, robots: int, obstacles: int, pairs: int, length: int) -> Room:
    """Create the arrays of one thread for given numbers of robots, obstacles and signals.

    `pairs` is the number of pairs of robots that keep a separation.
    """
    residuals = 2 * robots + robots * obstacles + pairs
    across = width(length)
    return Room(
        path=Trace.room_for(robots, length),
        contacts=Contacts(np.empty((robots, across)), *np.empty((4, length))),
        box_depth=np.empty(across),
        depths=np.empty((robots, obstacles)),
        deepest=np.empty((robots, obstacles), dtype=np.int64),
        meetings=np.empty(pairs),
        nearest=np.empty(pairs, dtype=np.int64),
        rows=np.empty((residuals, length)),
        residual=np.empty(residuals),
        gram=np.empty((residuals, residuals)),
        factor=np.empty((residuals, residuals)),
        step=np.empty(residuals),
        trial=np.empty(length),
    )


@compiled(**PART_FAST)
def polish(problem, room, u, settings, budget, merits, state, pause):
    """Improve a sequence of signals in place, by iterations of the Levenberg-Marquardt method.

    The polish ends when the merit is at most the tolerance, when no step lowers the merit, when the
    merit has not fallen to the fraction PROGRESS of its value within `patience` iterations, after
    `iterations_max` iterations, or when the next iteration would exceed `budget` evaluations. Each
    iteration tries one step. A Jacobian counts as one evaluation for each of its rows.

    Args:
        problem: The problem, a `FlatProblem`.
        room: The working arrays.
        u: The sequence [rad], shape (L,).
        settings: When the polish ends.
        budget: Maximum number of evaluations.
        merits: merits[z] is filled with the merit after z iterations.
        state: How far the polish has come, a `POLISH_STATE`; an interrupted polish continues from
            it.
        pause: Number of iterations after which the polish is interrupted.

    Returns:
        Whether it was interrupted.
    """
    if state.evaluations == 0:
        state.evaluations = 1
        state.damping = DAMPING_FIRST
    step_evaluations_max = room.residual.size + 1  # of one step that is taken
    floor = max(settings.tolerance, FLOOR_LEAST)
    trace(u, problem, room.path)
    merit = measure(problem, room, settings.slack)
    z = state.iterations
    merits[z] = merit
    while (
        merit > settings.tolerance
        and z < settings.iterations_max
        and state.evaluations + step_evaluations_max <= budget
    ):
        if z >= pause:
            return True
        residuals = linearise(problem, room, floor, settings.slack)
        state.evaluations += residuals
        mean_square = _square_jacobian(room, residuals)
        lower = merit
        while (
            z < settings.iterations_max
            and state.damping < DAMPING_MOST
            and state.evaluations < budget
        ):
            z += 1
            state.iterations = z
            merits[z] = merit
            if _solve(room, residuals, state.damping * mean_square):
                _step(room, u, residuals)
                state.evaluations += 1
                trace(room.trial, problem, room.path)
                lower = measure(problem, room, settings.slack)
                if lower < merit:
                    break
            state.damping *= STIFFENED
        if not lower < merit:
            break
        merit = lower
        merits[z] = merit
        for j in range(u.size):
            u[j] = room.trial[j]
        state.damping = max(EASED * state.damping, DAMPING_LEAST)
        if z >= settings.patience and merit > PROGRESS * merits[z - settings.patience]:
            break
    return False


@compiled(**PART_FAST)
def measure(problem, room, slack):
    """Compute how bad a path is, its merit m, and how deep robots are in obstacles and each other.

    The depths d_io and d_ik are written to `depths` and `meetings` of the room.

    Args:
        problem: The problem, a `FlatProblem`.
        room: The working arrays, which hold the path.
        slack: Robots that come no nearer to an obstacle than this get the depth -slack.
    """
    robots = len(problem.robots)
    find_deepest(problem, -slack, room)
    merit = math.sqrt(robots * _squared_misses(problem, room))
    for i in range(robots):
        for o in range(room.depths.shape[1]):
            merit += DEPTH_WEIGHT * max(0.0, room.depths[i, o])
    if room.meetings.size:
        _find_meetings(problem, room)
        for pair in range(room.meetings.size):
            merit += DEPTH_WEIGHT * max(0.0, room.meetings[pair])
    return merit


@compiled(**INLINE_FAST)
def _squared_miss(problem, room, i):
    """Compute |s_i - tar_i|^2: the squared final distance of robot i from its target."""
    last = room.rows.shape[1] - 1
    dx = room.path.x[i, last] - problem.targets[i, 0]
    dy = room.path.y[i, last] - problem.targets[i, 1]
    return dx * dx + dy * dy


@compiled(**INLINE_FAST)
def _squared_misses(problem, room):
    """Compute sum_i |s_i - tar_i|^2: the sum of the robots' squared final distances."""
    total = 0.0
    for i in range(len(problem.robots)):
        total += _squared_miss(problem, room, i)
    return total


@compiled(**INLINE_FAST)
def _find_meetings(problem, room):
    """Find, for each pair of robots, by how much and after which signal they come closest.

    The results are written to `meetings` and `nearest` of the room.
    """
    path = room.path
    pair = 0
    for i in range(len(problem.robots)):
        for k in range(i):
            least = math.inf
            signal = 0
            for j in range(room.rows.shape[1]):
                dx = path.x[i, j] - path.x[k, j]
                dy = path.y[i, j] - path.y[k, j]
                square = dx * dx + dy * dy
                if square < least:
                    least = square
                    signal = j
            room.meetings[pair] = problem.separation - math.sqrt(least)
            room.nearest[pair] = signal
            pair += 1


@compiled(**INLINE_FAST)
def linearise(problem, room, floor, slack):
    """Compute the residuals of a path and their derivatives, the rows of the Jacobian.

    They are written to `residual` and `rows` of the room, for the path of the last call of
    `measure`.

    Args:
        problem: The problem, a `FlatProblem`.
        room: The working arrays.
        floor: Limits the factors c where a miss or a depth is nearly zero.
        slack: Obstacles are grown by this, so that a path that is pushed to their edge ends
            outside.

    Returns:
        The number of residuals.
    """
    _pull_to_targets(problem, room, floor)
    residuals = 2 * len(problem.robots)
    residuals = _push_out_of_obstacles(problem, room, floor, slack, residuals)
    if room.meetings.size:
        residuals = _push_apart(problem, room, floor, slack, residuals)
    return residuals


@compiled(**INLINE_FAST)
def _pull_to_targets(problem, room, floor):
    """Write the residuals that pull robots to their targets: the 2N coordinates c (s_i - tar_i)."""
    path = room.path
    last = room.rows.shape[1] - 1
    root_mean_square = math.sqrt(_squared_misses(problem, room) / len(problem.robots))
    c = 1 / math.sqrt(max(root_mean_square, floor))
    for i in range(len(problem.robots)):
        _begin_row(room, 2 * i, c * (path.x[i, last] - problem.targets[i, 0]))
        backward(path, i, last, c, 0.0, room.rows[2 * i])
        _begin_row(room, 2 * i + 1, c * (path.y[i, last] - problem.targets[i, 1]))
        backward(path, i, last, 0.0, c, room.rows[2 * i + 1])


@compiled(**INLINE_FAST)
def _push_out_of_obstacles(problem, room, floor, slack, residuals):
    """Write a residual r = c d for each depth d_io of a robot in an obstacle.

    The rows follow the `residuals` that are already written. Returns the new number of residuals.
    """
    path = room.path
    r = residuals
    for i in range(len(problem.robots)):
        for o in range(room.depths.shape[1]):
            depth = room.depths[i, o] + slack
            if depth > 0:
                signal = room.deepest[i, o]
                x = path.x[i, signal]
                y = path.y[i, signal]
                east, north = outward(problem.obstacles, o, x, y)
                c = DEPTH_WEIGHT / math.sqrt(max(depth, floor))
                _begin_row(room, r, c * depth)
                backward(path, i, signal, -c * east, -c * north, room.rows[r])
                r += 1
    return r


@compiled(**INLINE_FAST)
def _push_apart(problem, room, floor, slack, residuals):
    """Write a residual r = c d for each pair of robots that come too close to each other.

    Such a residual depends on the positions of two robots. Returns the new number of residuals.
    """
    path = room.path
    r = residuals
    pair = 0
    for i in range(len(problem.robots)):
        for k in range(i):
            depth = room.meetings[pair] + slack
            signal = room.nearest[pair]
            pair += 1
            if depth > 0:
                dx = path.x[i, signal] - path.x[k, signal]
                dy = path.y[i, signal] - path.y[k, signal]
                distance = math.sqrt(dx * dx + dy * dy)
                c = DEPTH_WEIGHT / math.sqrt(max(depth, floor))
                share = c / distance if distance > 0 else 0.0
                _begin_row(room, r, c * depth)
                backward(path, i, signal, -share * dx, -share * dy, room.rows[r])
                backward(path, k, signal, share * dx, share * dy, room.rows[r])
                r += 1
    return r


@compiled(**INLINE_FAST)
def _begin_row(room, r, residual):
    """Write residual r, and set its row of the Jacobian to zero.

    `backward` then adds the derivatives to this row.
    """
    room.residual[r] = residual
    for j in range(room.rows.shape[1]):
        room.rows[r, j] = 0.0


@compiled(**INLINE_FAST)
def _square_jacobian(room, residuals):
    """Write the matrix J J' of the Jacobian to `gram`, and return the mean of its diagonal."""
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
    """Solve (J J' + damping I) step = residual.

    Returns whether the matrix is positive definite. If it is not, `step` stays unchanged.
    """
    if not _factorise(room, residuals, damping):
        return False
    _substitute(room, residuals)
    return True


@compiled(**INLINE_FAST)
def _factorise(room, residuals, damping):
    """Compute the Cholesky factor F of J J' + damping I into `factor`, F F' being that matrix.

    Returns whether it exists, which means that the matrix is positive definite.
    """
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
    """Solve F F' step = residual for F in `factor`: first F z = residual, then F' step = z."""
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
    """Write the sequence after a step, u - b J' step, to `trial`, where b <= 1 limits the step.

    b is so small that no signal changes by more than LARGEST_STEP.
    """
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


@compiled(**PART_FAST)
def judge(problem, room, u):
    """Return the cost J of (7) for a sequence that was improved, to compare it with others.

    The signals are first brought into [-pi, pi], in place.

    Args:
        problem: The problem, a `FlatProblem`.
        room: The working arrays.
        u: The sequence [rad], shape (L,).
    """
    for j in range(u.size):
        u[j] = _wrap(u[j])
    trace(u, problem, room.path)
    return _sum_of_distances(problem, room) + problem.obstacle_weight * _sum_of_hits(problem, room)


@compiled(**INLINE_FAST)
def _sum_of_distances(problem, room):
    """Compute f of (8) for the path: the sum of robots' final distances from their targets."""
    total = 0.0
    for i in range(len(problem.robots)):
        total += math.sqrt(_squared_miss(problem, room, i))
    return total


@compiled(**PART_FAST)
def _sum_of_hits(problem, room):
    """Compute P of (9) for the path: the number of predicted contacts with obstacles and robots."""
    contacts = room.contacts
    x = room.path.x
    y = room.path.y
    length = room.rows.shape[1]
    for i in range(len(problem.robots)):
        contacts.x_before[0] = problem.poses[i, 0]
        contacts.y_before[0] = problem.poses[i, 1]
        for j in range(length - 1):
            contacts.x_before[j + 1] = x[i, j]
            contacts.y_before[j + 1] = y[i, j]
        for j in range(length):
            contacts.hits[i, j] = 0.0
        count_hits(problem, x, y, i, contacts)
    if problem.separation > 0:
        count_meetings(x, y, problem.separation, contacts.hits)
    total = 0.0
    for i in range(len(problem.robots)):
        for j in range(length):
            total += contacts.hits[i, j]
    return total
