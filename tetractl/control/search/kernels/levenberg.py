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

`polish` is the loop over such steps. `wrap_and_evaluate` returns the cost J of (7) for the result,
which counts obstacles as the paper does. Both take a `FlatProblem`, and use the working arrays of a
`Workspace`.
"""

import math
from functools import lru_cache
from threading import get_ident
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.control.search.kernels.gradient import Trace, backpropagate, padded_length, trace
from tetractl.control.search.kernels.obstacles import Contacts, count_hits, find_deepest, outward
from tetractl.control.search.kernels.rollout import count_meetings
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, PART_FAST, inlined

Integers = NDArray[np.int64]
_wrap = inlined(polynomials.wrap)

SIGNAL_CHANGE_MAX = 1.0  # largest change of a signal in one iteration [rad]
DEPTH_WEIGHT = 3.0  # W, weight of a depth relative to a miss
PROGRESS = 0.8  # the merit must fall to this part of itself in `patience` iterations
DAMPING_FIRST = 1e-2  # lambda of the first step
DAMPING_MIN = 1e-10  # lambda falls no lower
DAMPING_MAX = 1e4  # a polish ends if lambda reaches this: no step helps
DAMPING_DECREASE = 0.2  # lambda is multiplied by this after a step that is taken
DAMPING_INCREASE = 5  # lambda is multiplied by this after a step that is not taken
FLOOR_MIN = 1e-9  # the factors c are limited as if misses and depths were no less [length unit]


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


class Workspace(NamedTuple):
    """The working arrays for improving one sequence of signals, allocated once and reused.

    Sizes: N robots, L signals, O obstacles and walls, M = padded_length(L). R is the maximum number
    of residuals of the least-squares problem.
    """

    path: Trace
    contacts: Contacts  # of the path; hits (N, M), the other arrays (L,)
    box_depth: Floats  # (M,) how deep one robot is in the box around an obstacle
    depths: Floats  # (N, O) d_io, the depth of each robot's deepest position in each obstacle
    deepest_signal: Integers  # (N, O) number of the signal after which it has that position
    meetings: Floats  # (pairs,) d_ik, separation minus the least distance of each pair of robots
    nearest_signal: Integers  # (pairs,) number of the signal after which they have that distance
    jacobian: Floats  # (R, L) the Jacobian J
    residual: Floats  # (R,) r
    gram: Floats  # (R, R) J J', lower triangle
    factor: Floats  # (R, R) Cholesky factor of the damped J J', lower triangle
    step: Floats  # (R,) y
    trial: Floats  # (L,) the sequence that is tried


def workspace_for(problem: Problem, length: int) -> Workspace:
    """Return the working arrays of this thread for a problem and sequences of `length` signals.

    Problems with the same numbers of robots, obstacles and signals share them.
    """
    robots = len(problem.a)
    pairs = robots * (robots - 1) // 2 if problem.separation > 0 else 0
    return _allocate_workspace(get_ident(), robots, problem.obstacles.count, pairs, length)


@lru_cache(maxsize=64)
def _allocate_workspace(
    thread: int, robots: int, obstacles: int, pairs: int, length: int
) -> Workspace:
    """Create the arrays of one thread for given numbers of robots, obstacles and signals.

    `pairs` is the number of pairs of robots that keep a separation.
    """
    n_residuals = 2 * robots + robots * obstacles + pairs
    padded_size = padded_length(length)
    return Workspace(
        path=Trace.allocate(robots, length),
        contacts=Contacts(np.empty((robots, padded_size)), *np.empty((4, length))),
        box_depth=np.empty(padded_size),
        depths=np.empty((robots, obstacles)),
        deepest_signal=np.empty((robots, obstacles), dtype=np.int64),
        meetings=np.empty(pairs),
        nearest_signal=np.empty(pairs, dtype=np.int64),
        jacobian=np.empty((n_residuals, length)),
        residual=np.empty(n_residuals),
        gram=np.empty((n_residuals, n_residuals)),
        factor=np.empty((n_residuals, n_residuals)),
        step=np.empty(n_residuals),
        trial=np.empty(length),
    )


@compiled(**PART_FAST)
def polish(problem, workspace, u, settings, budget, merits, state, pause):
    """Improve a sequence of signals in place, by iterations of the Levenberg-Marquardt method.

    The polish ends when the merit is at most the tolerance, when no step lowers the merit, when the
    merit has not fallen to the fraction PROGRESS of its value within `patience` iterations, after
    `iterations_max` iterations, or when the next iteration would exceed `budget` evaluations. Each
    iteration tries one step. A Jacobian counts as one evaluation for each of its rows.

    Args:
        problem: The problem, a `FlatProblem`.
        workspace: The working arrays.
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
    step_evaluations_max = workspace.residual.size + 1  # of one step that is taken
    floor = max(settings.tolerance, FLOOR_MIN)
    trace(u, problem, workspace.path)
    merit = compute_merit(problem, workspace, settings.slack)
    z = state.iterations
    merits[z] = merit
    while (
        merit > settings.tolerance
        and z < settings.iterations_max
        and state.evaluations + step_evaluations_max <= budget
    ):
        if z >= pause:
            return True
        n_residuals = linearise(problem, workspace, floor, settings.slack)
        state.evaluations += n_residuals
        mean_square = _square_jacobian(workspace, n_residuals)
        new_merit = merit
        while (
            z < settings.iterations_max
            and state.damping < DAMPING_MAX
            and state.evaluations < budget
        ):
            z += 1
            state.iterations = z
            merits[z] = merit
            if _solve(workspace, n_residuals, state.damping * mean_square):
                _write_trial(workspace, u, n_residuals)
                state.evaluations += 1
                trace(workspace.trial, problem, workspace.path)
                new_merit = compute_merit(problem, workspace, settings.slack)
                if new_merit < merit:
                    break
            state.damping *= DAMPING_INCREASE
        if not new_merit < merit:
            break
        merit = new_merit
        merits[z] = merit
        for j in range(u.size):
            u[j] = workspace.trial[j]
        state.damping = max(DAMPING_DECREASE * state.damping, DAMPING_MIN)
        if z >= settings.patience and merit > PROGRESS * merits[z - settings.patience]:
            break
    return False


@compiled(**PART_FAST)
def compute_merit(problem, workspace, slack):
    """Compute how bad a path is, its merit m, and how deep robots are in obstacles and each other.

    The depths d_io and d_ik are written to `depths` and `meetings` of the workspace.

    Args:
        problem: The problem, a `FlatProblem`.
        workspace: The working arrays, which hold the path.
        slack: Robots that come no nearer to an obstacle than this get the depth -slack.
    """
    robots = len(problem.robots)
    find_deepest(problem, -slack, workspace)
    merit = math.sqrt(robots * _sum_squared_misses(problem, workspace))
    for i in range(robots):
        for o in range(workspace.depths.shape[1]):
            merit += DEPTH_WEIGHT * max(0.0, workspace.depths[i, o])
    if workspace.meetings.size:
        _find_meetings(problem, workspace)
        for pair in range(workspace.meetings.size):
            merit += DEPTH_WEIGHT * max(0.0, workspace.meetings[pair])
    return merit


@compiled(**INLINE_FAST)
def _squared_miss(problem, workspace, i):
    """Compute |s_i - tar_i|^2: the squared final distance of robot i from its target."""
    last = workspace.jacobian.shape[1] - 1
    dx = workspace.path.x[i, last] - problem.targets[i, 0]
    dy = workspace.path.y[i, last] - problem.targets[i, 1]
    return dx * dx + dy * dy


@compiled(**INLINE_FAST)
def _sum_squared_misses(problem, workspace):
    """Compute sum_i |s_i - tar_i|^2: the sum of the robots' squared final distances."""
    total = 0.0
    for i in range(len(problem.robots)):
        total += _squared_miss(problem, workspace, i)
    return total


@compiled(**INLINE_FAST)
def _find_meetings(problem, workspace):
    """Find, for each pair of robots, by how much and after which signal they come closest.

    The results are written to `meetings` and `nearest_signal` of the workspace.
    """
    path = workspace.path
    pair = 0
    for i in range(len(problem.robots)):
        for k in range(i):
            min_square = math.inf
            signal = 0
            for j in range(workspace.jacobian.shape[1]):
                dx = path.x[i, j] - path.x[k, j]
                dy = path.y[i, j] - path.y[k, j]
                square = dx * dx + dy * dy
                if square < min_square:
                    min_square = square
                    signal = j
            workspace.meetings[pair] = problem.separation - math.sqrt(min_square)
            workspace.nearest_signal[pair] = signal
            pair += 1


@compiled(**INLINE_FAST)
def linearise(problem, workspace, floor, slack):
    """Compute the residuals of a path and their derivatives, the rows of the Jacobian.

    They are written to `residual` and `jacobian` of the workspace, for the path of the last call of
    `compute_merit`.

    Args:
        problem: The problem, a `FlatProblem`.
        workspace: The working arrays.
        floor: Limits the factors c where a miss or a depth is nearly zero.
        slack: Obstacles are grown by this, so that a path that is pushed to their edge ends
            outside.

    Returns:
        The number of residuals.
    """
    _pull_to_targets(problem, workspace, floor)
    n_residuals = 2 * len(problem.robots)
    n_residuals = _push_out_of_obstacles(problem, workspace, floor, slack, n_residuals)
    if workspace.meetings.size:
        n_residuals = _push_apart(problem, workspace, floor, slack, n_residuals)
    return n_residuals


@compiled(**INLINE_FAST)
def _pull_to_targets(problem, workspace, floor):
    """Write the residuals that pull robots to their targets: the 2N coordinates c (s_i - tar_i)."""
    path = workspace.path
    last = workspace.jacobian.shape[1] - 1
    root_mean_square = math.sqrt(_sum_squared_misses(problem, workspace) / len(problem.robots))
    c = 1 / math.sqrt(max(root_mean_square, floor))
    for i in range(len(problem.robots)):
        _begin_row(workspace, 2 * i, c * (path.x[i, last] - problem.targets[i, 0]))
        backpropagate(path, i, last, c, 0.0, workspace.jacobian[2 * i])
        _begin_row(workspace, 2 * i + 1, c * (path.y[i, last] - problem.targets[i, 1]))
        backpropagate(path, i, last, 0.0, c, workspace.jacobian[2 * i + 1])


@compiled(**INLINE_FAST)
def _push_out_of_obstacles(problem, workspace, floor, slack, n_residuals):
    """Write a residual r = c d for each depth d_io of a robot in an obstacle.

    The rows follow the `n_residuals` that are already written. Returns the new number of residuals.
    """
    path = workspace.path
    r = n_residuals
    for i in range(len(problem.robots)):
        for o in range(workspace.depths.shape[1]):
            depth = workspace.depths[i, o] + slack
            if depth > 0:
                signal = workspace.deepest_signal[i, o]
                x = path.x[i, signal]
                y = path.y[i, signal]
                east, north = outward(problem.obstacles, o, x, y)
                c = DEPTH_WEIGHT / math.sqrt(max(depth, floor))
                _begin_row(workspace, r, c * depth)
                backpropagate(path, i, signal, -c * east, -c * north, workspace.jacobian[r])
                r += 1
    return r


@compiled(**INLINE_FAST)
def _push_apart(problem, workspace, floor, slack, n_residuals):
    """Write a residual r = c d for each pair of robots that come too close to each other.

    Such a residual depends on the positions of two robots. Returns the new number of residuals.
    """
    path = workspace.path
    r = n_residuals
    pair = 0
    for i in range(len(problem.robots)):
        for k in range(i):
            depth = workspace.meetings[pair] + slack
            signal = workspace.nearest_signal[pair]
            pair += 1
            if depth > 0:
                dx = path.x[i, signal] - path.x[k, signal]
                dy = path.y[i, signal] - path.y[k, signal]
                distance = math.sqrt(dx * dx + dy * dy)
                c = DEPTH_WEIGHT / math.sqrt(max(depth, floor))
                scale = c / distance if distance > 0 else 0.0
                _begin_row(workspace, r, c * depth)
                backpropagate(path, i, signal, -scale * dx, -scale * dy, workspace.jacobian[r])
                backpropagate(path, k, signal, scale * dx, scale * dy, workspace.jacobian[r])
                r += 1
    return r


@compiled(**INLINE_FAST)
def _begin_row(workspace, r, residual):
    """Write residual r, and set its row of the Jacobian to zero.

    `backpropagate` then adds the derivatives to this row.
    """
    workspace.residual[r] = residual
    for j in range(workspace.jacobian.shape[1]):
        workspace.jacobian[r, j] = 0.0


@compiled(**INLINE_FAST)
def _square_jacobian(workspace, n_residuals):
    """Write the matrix J J' of the Jacobian to `gram`, and return the mean of its diagonal."""
    jacobian = workspace.jacobian
    for p in range(n_residuals):
        for q in range(p + 1):
            total = 0.0
            for j in range(jacobian.shape[1]):
                total += jacobian[p, j] * jacobian[q, j]
            workspace.gram[p, q] = total
    mean = 0.0
    for p in range(n_residuals):
        mean += workspace.gram[p, p] / n_residuals
    return mean


@compiled(**INLINE_FAST)
def _solve(workspace, n_residuals, damping):
    """Solve (J J' + damping I) step = residual.

    Returns whether the matrix is positive definite. If it is not, `step` stays unchanged.
    """
    if not _factorise(workspace, n_residuals, damping):
        return False
    _substitute(workspace, n_residuals)
    return True


@compiled(**INLINE_FAST)
def _factorise(workspace, n_residuals, damping):
    """Compute the Cholesky factor F of J J' + damping I into `factor`, F F' being that matrix.

    Returns whether it exists, which means that the matrix is positive definite.
    """
    gram = workspace.gram
    factor = workspace.factor
    for p in range(n_residuals):
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
def _substitute(workspace, n_residuals):
    """Solve F F' step = residual for F in `factor`: first F z = residual, then F' step = z."""
    factor = workspace.factor
    step = workspace.step
    for p in range(n_residuals):
        total = workspace.residual[p]
        for k in range(p):
            total -= factor[p, k] * step[k]
        step[p] = total / factor[p, p]
    for p in range(n_residuals - 1, -1, -1):
        total = step[p]
        for k in range(p + 1, n_residuals):
            total -= factor[k, p] * step[k]
        step[p] = total / factor[p, p]


@compiled(**INLINE_FAST)
def _write_trial(workspace, u, n_residuals):
    """Write the sequence after a step, u - b J' step, to `trial`, where b <= 1 limits the step.

    b is so small that no signal changes by more than SIGNAL_CHANGE_MAX.
    """
    largest_change = 0.0
    for j in range(u.size):
        change = 0.0
        for p in range(n_residuals):
            change += workspace.jacobian[p, j] * workspace.step[p]
        workspace.trial[j] = change
        largest_change = max(largest_change, abs(change))
    b = min(1.0, SIGNAL_CHANGE_MAX / largest_change) if largest_change > 0 else 1.0
    for j in range(u.size):
        workspace.trial[j] = u[j] - b * workspace.trial[j]


@compiled(**PART_FAST)
def wrap_and_evaluate(problem, workspace, u):
    """Return the cost J of (7) for a sequence that was improved, to compare it with others.

    The signals are first brought into [-pi, pi], in place.

    Args:
        problem: The problem, a `FlatProblem`.
        workspace: The working arrays.
        u: The sequence [rad], shape (L,).
    """
    for j in range(u.size):
        u[j] = _wrap(u[j])
    trace(u, problem, workspace.path)
    return _sum_of_distances(problem, workspace) + problem.obstacle_weight * _sum_of_hits(
        problem, workspace
    )


@compiled(**INLINE_FAST)
def _sum_of_distances(problem, workspace):
    """Compute f of (8) for the path: the sum of robots' final distances from their targets."""
    total = 0.0
    for i in range(len(problem.robots)):
        total += math.sqrt(_squared_miss(problem, workspace, i))
    return total


@compiled(**PART_FAST)
def _sum_of_hits(problem, workspace):
    """Compute P of (9) for the path: the number of predicted contacts with obstacles and robots."""
    contacts = workspace.contacts
    x = workspace.path.x
    y = workspace.path.y
    length = workspace.jacobian.shape[1]
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
