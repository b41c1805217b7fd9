"""The predicted path of one sequence, compiled: `tetractl.control.cost.predict` and `foresee`, and
where robots go that receive nothing."""

import math

import numpy as np

from tetractl.control.kernels.clearance import crosses
from tetractl.control.kernels.motion import derivatives, parameters_of
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST


@compiled(**INLINE_FAST)
def _robot(u, parameters, drift, t, motion, before, after, i):
    """Write the pose of robot i `after` the signal u; the robot stands if u is NaN."""
    x = before[i, 0]
    y = before[i, 1]
    heading = before[i, 2]
    after[i, 0] = x
    after[i, 1] = y
    after[i, 2] = heading
    if not math.isnan(u):
        cu = math.cos(u)
        su = math.sin(u)
        c = drift[0, i]
        s = drift[1, i]
        cos = math.cos(heading)
        sin = math.sin(heading)
        towards = (cu * c - su * s, su * c + cu * s)
        robot = parameters_of(parameters[i])
        dx, dy, turn = derivatives(motion, cos, sin, *towards, robot, t)[0]
        after[i, 0] = x + dx + t * drift[2, i]
        after[i, 1] = y + dy + t * drift[3, i]
        after[i, 2] = heading + turn


@compiled(**INLINE_FAST)
def _signal(u, parameters, drift, t, motion, before, after):
    """Write the poses (N, 3) `after` the signal u, held for t [s], from those `before` it."""
    for i in range(len(parameters)):
        _robot(u, parameters, drift, t, motion, before, after, i)


@compiled(**ENTRY_FAST)
def predict(u, parameters, drift, first_period, period, motion, path):
    """Fill path (L + 1, N, 3), whose first row is the start, with the poses under u (L,).

    The class of `motion`, a motion's constants, defines how robots move.
    """
    for j in range(u.size):
        t = first_period if j == 0 else period
        _signal(u[j], parameters, drift, t, motion, path[j], path[j + 1])


@compiled(**ENTRY_FAST)
def drive(start, towards, parameters, drift, motion, seconds, path):
    """Fill path (M, N, 3) with the poses of robots after each of `seconds` (M,), from start (N, 3).

    Each follows its own direction towards (N,) [rad], or stands if that is NaN.
    """
    for m in range(seconds.size):
        for i in range(len(parameters)):
            _robot(towards[i], parameters, drift, seconds[m], motion, start, path[m], i)


@compiled(**ENTRY_FAST)
def foresee(
    u, parameters, drift, first_period, period, motion, path, target, rows, walls, swept, apart
):
    """Fill path (L + 1, N, 3), whose first row is the start, with the poses under u (L,); return f
    of (8) and P of (9), which counts pairs of robots that are nearer than `apart`."""
    missed = touched = 0.0
    for j in range(u.size):
        before = path[j]
        after = path[j + 1]
        t = first_period if j == 0 else period
        _signal(u[j], parameters, drift, t, motion, before, after)
        for i in range(len(parameters)):
            x = after[i, 0]
            y = after[i, 1]
            x0, y0 = (before[i, 0], before[i, 1]) if swept else (x, y)
            touched += crosses(rows, walls, x0, y0, x, y)
            for k in range(i if apart > 0 else 0):
                dx = x - after[k, 0]
                dy = y - after[k, 1]
                touched += dx * dx + dy * dy <= apart * apart
    for i in range(len(parameters)):
        dx = path[u.size, i, 0] - target[i, 0]
        dy = path[u.size, i, 1] - target[i, 1]
        missed += math.sqrt(dx * dx + dy * dy)
    return missed, touched


@compiled(**ENTRY_FAST)
def unheard(u, parameters, drift, t, steps, motion, path, rows, walls, separation):
    """Return whether robots keep clear that after any one of the signals u (L,) follow it for
    `steps` times t [s] more; path (L + 1, N, 3) are the poses before each.

    They touch no obstacle on the way and come no nearer to each other than `separation`.
    """
    poses = np.empty((2, len(parameters), 3))
    for j in range(u.size):
        now = poses[0]
        then = poses[1]
        for i in range(len(parameters)):
            for k in range(3):
                now[i, k] = path[j, i, k]
        for m in range(steps + 1):
            for i in range(len(parameters)):
                x = now[i, 0]
                y = now[i, 1]
                if m > 0 and crosses(rows, walls, then[i, 0], then[i, 1], x, y):
                    return False
                for k in range(i):
                    if math.hypot(now[k, 0] - x, now[k, 1] - y) < separation:
                        return False
            if m < steps:
                _signal(u[j], parameters, drift, t, motion, now, then)
                now, then = then, now
    return True
