"""Where robots go: `tetractl.control.cost.predict` and `costs_along` of one sequence, compiled.

In addition `drive`, for robots that each follow a direction of their own. A problem is a
`FlatProblem`; poses are x, y and heading (N, 3).
"""

import math

import numpy as np

from tetractl.control.kernels.clearance import crosses
from tetractl.control.kernels.motion import derivatives, robot_of
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST


@compiled(**INLINE_FAST)
def _move(problem, towards, t, before, after):
    """Write the poses of all robots `after` they followed their directions towards (N,) [rad] for
    t [s]; a robot stands if that is NaN."""
    robots = problem.robots
    lanes = problem.rest
    bias_cos = problem.bias_cos
    bias_sin = problem.bias_sin
    flow = problem.flow
    for i in range(len(robots)):
        x = before[i, 0]
        y = before[i, 1]
        heading = before[i, 2]
        after[i, 0] = x
        after[i, 1] = y
        after[i, 2] = heading
        u = towards[i]
        if not math.isnan(u):
            c = bias_cos[i]
            s = bias_sin[i]
            cu = math.cos(u) * c - math.sin(u) * s
            su = math.sin(u) * c + math.cos(u) * s
            cos = math.cos(heading)
            sin = math.sin(heading)
            dx, dy, turn = derivatives(lanes, cos, sin, cu, su, robot_of(robots, i), t)[0]
            after[i, 0] = x + dx + t * flow[i, 0]
            after[i, 1] = y + dy + t * flow[i, 1]
            after[i, 2] = heading + turn


@compiled(**ENTRY_FAST)
def predict(u, problem, path):
    """Fill path (L + 1, N, 3), whose first row is the start, with the poses under u (L,)."""
    robots = len(problem.robots)
    towards = np.empty(robots)
    for j in range(u.size):
        for i in range(robots):
            towards[i] = u[j]
        t = problem.first_period if j == 0 else problem.period
        _move(problem, towards, t, path[j], path[j + 1])


@compiled(**ENTRY_FAST)
def drive(towards, seconds, problem, path):
    """Fill path (M, N, 3) with the poses of robots after each of `seconds` (M,).

    Each follows its own direction towards (N,) [rad], or stands if that is NaN.
    """
    for m in range(seconds.size):
        _move(problem, towards, seconds[m], problem.poses, path[m])


@compiled(**ENTRY_FAST)
def costs_along(problem, path):
    """Return f of (8) and P of (9) of a path (L + 1, N, 3), whose first row is the start."""
    last = path.shape[0] - 1
    missed = 0.0
    touched = 0.0
    for j in range(last):
        touched += _count_touches(problem, path[j], path[j + 1])
    for i in range(len(problem.robots)):
        dx = path[last, i, 0] - problem.targets[i, 0]
        dy = path[last, i, 1] - problem.targets[i, 1]
        missed += math.sqrt(dx * dx + dy * dy)
    return missed, touched


@compiled(**INLINE_FAST)
def _count_touches(problem, before, after):
    """Return how many robots touch an obstacle `after` a signal, or, if that counts, on the way,
    and how many pairs are too near to each other then."""
    since = before if problem.swept else after
    touches = 0.0
    for i in range(len(problem.robots)):
        x = after[i, 0]
        y = after[i, 1]
        touches += crosses(problem.obstacles, since[i, 0], since[i, 1], x, y)
        for k in range(i if problem.separation > 0 else 0):
            dx = x - after[k, 0]
            dy = y - after[k, 1]
            touches += dx * dx + dy * dy <= problem.separation * problem.separation
    return touches
