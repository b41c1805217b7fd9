"""Predicts the path of a sequence, and each step's derivatives by heading and signal.

With phi = u - heading, a step moves a robot by d(heading, u) and turns it; `trace` stores, for each
robot and signal, the partial derivatives of d and of the next heading g:

    EAST_H, NORTH_H = dd/dheading;  EAST_U, NORTH_U = dd/du;  KEEP = dg/dheading = 1 - dg/du

(the turn depends on phi alone). The derivative of a later position by an earlier signal follows by
the chain rule backwards in time, in `backward`.

Only the headings depend on the previous step. They are computed first, as cosine and sine; then the
steps of a robot are independent of each other, and the loop over them is vector code. Arrays over
the signals are therefore padded to whole vectors, of length `width(L)`; entries beyond the last
signal are meaningless. Each quantity is a separate array (N, M), because in an array of several
quantities the compiler could not exclude overlaps and would not vectorise the loop.
"""

from typing import NamedTuple

import numpy as np

from tetractl.control.kernels.motion import derivatives, parameters_of, turned
from tetractl.core.poses import Floats
from tetractl.model.motion.polynomials import sincos, wrap
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, inlined

# Numbers of `Trace.gradients`.
EAST_H = 0
"""dx of a step by the heading [length unit/rad]."""
NORTH_H = 1
"""dy of a step by the heading [length unit/rad]."""
EAST_U = 2
"""dx of a step by the direction u [length unit/rad]."""
NORTH_U = 3
"""dy of a step by the direction u [length unit/rad]."""
KEEP = 4
"""The next heading by the heading."""
VECTOR = 8
"""Number of float64 in the widest vector of any processor, and in a cache line."""

_sincos = inlined(sincos)
_wrap = inlined(wrap)


class Trace(NamedTuple):
    """The arrays that `trace` fills, for N robots and L signals, M = width(L)."""

    cos: Floats  # (N + 1, M) of the headings before each signal; last row: of the signals
    sin: Floats  # (N + 1, M)
    path: Floats  # (2, N, M) x and y after each signal
    gradients: Floats  # (5, N, M)


def width(length: int) -> int:
    """Return the padded length of arrays for `length` signals."""
    return -(-length // VECTOR) * VECTOR


def workspace(count: int, length: int) -> Trace:
    """Return the arrays for `count` robots."""
    across = width(length)
    cos = np.ones((count + 1, across))
    sin = np.zeros((count + 1, across))
    return Trace(cos, sin, np.empty((2, count, across)), np.empty((5, count, across)))


@compiled(**INLINE_FAST)
def trace(u, start, parameters, drift, first_period, period, first, rest, traced):
    """Predict under signals u (L,) from start, with the motion's parameters (N, K), drift (4, N).

    start (4, N) are x, y, and cos and sin of the heading.

    `first` and `rest` are the motion's constants for the first signal's period and the others';
    their class defines how robots move.
    """
    cos = traced.cos
    sin = traced.sin
    path = traced.path
    count = len(parameters)
    across = cos.shape[1]
    for i in range(count):
        cos[i, 0] = start[2, i]
        sin[i, 0] = start[3, i]
    for j in range(u.size):
        sin[count, j], cos[count, j] = _sincos(_wrap(u[j]))
    for j in range(u.size - 1):
        cu = cos[count, j]
        su = sin[count, j]
        for i in range(count):
            lanes = first if j == 0 else rest
            cos[i, j + 1], sin[i, j + 1] = turned(
                lanes,
                cos[i, j],
                sin[i, j],
                cu * drift[0, i] - su * drift[1, i],
                su * drift[0, i] + cu * drift[1, i],
                i,
                parameters_of(parameters[i]),
                first_period if j == 0 else period,
            )
    x = path[0]
    y = path[1]
    for i in range(count):
        robot = parameters_of(parameters[i])
        for again in range(1 if first_period == period else 2):  # then the first signal's period
            t, upto = (period, across) if again == 0 else (first_period, 1)
            if robot[3] < 1:
                _steps(i, robot, t, upto, drift, rest, traced)
            else:  # by a constant, so that the compiler leaves out what it does not need
                _steps(i, (robot[0], robot[1], robot[2], 1.0), t, upto, drift, rest, traced)
        fx = drift[2, i]
        fy = drift[3, i]
        x[i, 0] = start[0, i] + x[i, 0] + fx * first_period
        y[i, 0] = start[1, i] + y[i, 0] + fy * first_period
        for j in range(1, u.size):
            x[i, j] = x[i, j - 1] + x[i, j] + fx * period
            y[i, j] = y[i, j - 1] + y[i, j] + fy * period


@compiled(**INLINE_FAST)
def _steps(i, robot, t, upto, drift, motion, traced):
    """Write the displacement of robot i by each of the signals `upto` one, and its derivatives."""
    count = len(traced.cos) - 1
    (cos, sin, path, gradients) = traced
    x = path[0]
    y = path[1]
    cu = cos[count]
    su = sin[count]
    cb = drift[0, i]
    sb = drift[1, i]
    east_h = gradients[EAST_H]
    north_h = gradients[NORTH_H]
    east_u = gradients[EAST_U]
    north_u = gradients[NORTH_U]
    keep = gradients[KEEP]
    for j in range(upto):
        c = cos[i, j]
        s = sin[i, j]
        c_u = cu[j]
        s_u = su[j]
        towards = c_u * cb - s_u * sb, s_u * cb + c_u * sb
        step, by_heading, by_u, _ = derivatives(motion, c, s, *towards, robot, t)
        x[i, j], y[i, j], _ = step
        east_h[i, j], north_h[i, j], keep[i, j] = by_heading
        east_u[i, j], north_u[i, j], _ = by_u


@compiled(**INLINE_FAST)
def backward(gradients, i, signal, east, north, row):
    """Add to row (L,) the derivative by u of east * x + north * y of robot i after a signal.

    `by_heading` is the derivative by the heading before signal j + 1. The heading before signal j
    moves step j, and with KEEP all later ones; signal j moves step j, and with 1 - KEEP all later
    ones.
    """
    by_heading = 0.0
    for j in range(signal, -1, -1):
        keep = gradients[KEEP, i, j]
        step_by_u = east * gradients[EAST_U, i, j] + north * gradients[NORTH_U, i, j]
        step_by_heading = east * gradients[EAST_H, i, j] + north * gradients[NORTH_H, i, j]
        row[j] += step_by_u + by_heading * (1 - keep)
        by_heading = step_by_heading + by_heading * keep
