"""Compiled predictions: where robots go if they follow directions, and what their path costs.

    predict       all robots follow a plan: one direction after another, each for a signal period
    drive         each robot keeps a direction of its own
    costs_along   f and P of the paper's (8) and (9) for a path that `predict` found

`tetractl.control.search.cost` has readable reference implementations of `predict` and `costs_along`
with the same names. A problem is a `FlatProblem`. A path (M, N, 3) holds the poses of N robots at M
moments, with the columns X, Y and HEADING.
"""

import math

import numpy as np

from tetractl.control.search.kernels.clearance import crosses
from tetractl.control.search.kernels.elementary import cos, sin
from tetractl.control.search.kernels.motion import FlatProblem, derivatives, robot_of
from tetractl.core.poses import Floats
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST

X = 0
Y = 1
HEADING = 2


def predict(u: Floats, problem: FlatProblem, start: Floats) -> Floats:
    """Predict the path of robots that follow a sequence of signals.

    Args:
        u: The signals [rad], shape (L,).
        problem: The problem, a `FlatProblem`.
        start: Poses at the start, shape (N, 3).

    Returns:
        The poses, shape (L + 1, N, 3). The first row is the start.
    """
    path = np.empty((u.size + 1, *start.shape))
    _predict(u, problem, start, path)
    return path


@compiled(**ENTRY_FAST)
def _predict(u, problem, start, path):
    """Predict the `path` of robots that follow the signals u; see `predict`."""
    robots = len(problem.robots)
    for i in range(robots):
        path[0, i, X] = start[i, X]
        path[0, i, Y] = start[i, Y]
        path[0, i, HEADING] = start[i, HEADING]
    for j in range(u.size):
        seconds = problem.first_period if j == 0 else problem.period
        for i in range(robots):
            x, y, heading = _move_robot(problem, i, path[j, i], u[j], seconds)
            path[j + 1, i, X] = x
            path[j + 1, i, Y] = y
            path[j + 1, i, HEADING] = heading


def drive(directions: Floats, seconds: Floats, problem: FlatProblem) -> Floats:
    """Predict the poses of robots that each keep a direction of their own.

    Args:
        directions: Direction of each robot [rad], shape (N,). NaN if a robot stands still.
        seconds: The times to predict [s], shape (M,).
        problem: The problem, a `FlatProblem`. Robots begin at its poses.

    Returns:
        The poses, shape (M, N, 3).
    """
    path = np.empty((seconds.size, *problem.poses.shape))
    _drive(directions, seconds, problem, path)
    return path


@compiled(**ENTRY_FAST)
def _drive(directions, seconds, problem, path):
    """Predict the `path` of robots that each keep a direction of their own; see `drive`."""
    robots = len(problem.robots)
    for m in range(seconds.size):
        for i in range(robots):
            x, y, heading = _move_robot(problem, i, problem.poses[i], directions[i], seconds[m])
            path[m, i, X] = x
            path[m, i, Y] = y
            path[m, i, HEADING] = heading


@compiled(**INLINE_FAST)
def _move_robot(problem, i, pose, u, t):
    """Compute the pose of robot i after it has followed the direction u [rad] for t [s].

    The robot stands still if u is NaN.
    """
    x = pose[X]
    y = pose[Y]
    heading = pose[HEADING]
    if math.isnan(u):
        return x, y, heading
    bias_cos = problem.bias_cos[i]
    bias_sin = problem.bias_sin[i]
    direction_cos = cos(u) * bias_cos - sin(u) * bias_sin
    direction_sin = sin(u) * bias_cos + cos(u) * bias_sin
    robot = robot_of(problem.robots, i)
    heading_cos = cos(heading)
    heading_sin = sin(heading)
    dx, dy, turn = derivatives(
        problem.later_lanes, heading_cos, heading_sin, direction_cos, direction_sin, robot, t
    )[0]
    x = x + dx + t * problem.flow[i, X]
    y = y + dy + t * problem.flow[i, Y]
    return x, y, heading + turn


@compiled(**ENTRY_FAST)
def costs_along(problem, path):
    """Compute f of (8) and P of (9) for a predicted path (L + 1, N, 3), the start first."""
    last_index = path.shape[0] - 1
    distance_sum = 0.0
    n_contacts = 0.0
    for j in range(last_index):
        n_contacts += _count_contacts(problem, path[j], path[j + 1])
    for i in range(len(problem.robots)):
        dx = path[last_index, i, X] - problem.targets[i, X]
        dy = path[last_index, i, Y] - problem.targets[i, Y]
        distance_sum += math.sqrt(dx * dx + dy * dy)
    return distance_sum, n_contacts


@compiled(**INLINE_FAST)
def _count_contacts(problem, before, after):
    """Count the contacts of one step: robots in an obstacle, and pairs that are too close.

    Both are counted at the poses `after` a signal. If paths are `swept`, a robot also counts if it
    touches an obstacle on its way from its pose `before` the signal.
    """
    start = before if problem.swept else after
    n_contacts = 0.0
    for i in range(len(problem.robots)):
        x = after[i, X]
        y = after[i, Y]
        if crosses(problem.obstacles, start[i, X], start[i, Y], x, y):
            n_contacts += 1.0
        if problem.separation > 0:
            for k in range(i):
                dx = x - after[k, X]
                dy = y - after[k, Y]
                if dx * dx + dy * dy <= problem.separation * problem.separation:
                    n_contacts += 1.0
    return n_contacts
