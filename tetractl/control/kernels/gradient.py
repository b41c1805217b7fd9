"""One sequence, its predicted path, and how each step depends on heading and signal.

With phi = u - heading, a step moves a robot by d(heading, u) and turns it; `trace` stores, for each
robot and signal, the partial derivatives of d and of the next heading g:

    EAST_H, NORTH_H = dd/dheading;  EAST_U, NORTH_U = dd/du;  KEEP = dg/dheading = 1 - dg/du

(the turn depends on phi alone). The derivative of a later position by an earlier signal follows by
the chain rule backwards in time, in `backward`.
"""

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.motion import derivatives
from tetractl.control.kernels.options import PIECE

EAST_H, NORTH_H, EAST_U, NORTH_U, KEEP = range(5)


@compiled(**PIECE)
def trace(u, start, a, v, first_period, period, motion, headings, path, gradients):
    """Predict under signals u (L,): path (N, L, 2) of positions, gradients (N, L, 5).

    headings (N,) are left as they are after the last signal. The class of `motion`, constants of a
    motion, decides how the robots move. Robots take turns: each step waits for the heading before
    it, and the processor works on the others meanwhile; a signal's sine and cosine serve them all.
    """
    for j in range(u.size):
        t, towards = first_period if j == 0 else period, u[j]
        for i in range(a.size):
            if j == 0:
                x, y, heading = start[i, 0], start[i, 1], start[i, 2]
            else:
                x, y, heading = path[i, j - 1, 0], path[i, j - 1, 1], headings[i]
            step = derivatives(motion, heading, towards, a[i], v[i], t)
            path[i, j, 0], path[i, j, 1], headings[i] = x + step[0], y + step[1], heading + step[2]
            for k in range(5):
                gradients[i, j, k] = step[3 + k]


@compiled(**PIECE)
def backward(gradients, i, last, east, north, row):
    """Write to row (L,) how east * x + north * y of robot i after signal `last` depends on u."""
    by_heading = 0.0
    for j in range(row.size - 1, last, -1):
        row[j] = 0.0
    for j in range(last, -1, -1):
        keep = gradients[i, j, KEEP]
        by_u = east * gradients[i, j, EAST_U] + north * gradients[i, j, NORTH_U]
        row[j] = by_u + by_heading * (1 - keep)
        by_h = east * gradients[i, j, EAST_H] + north * gradients[i, j, NORTH_H]
        by_heading = by_h + by_heading * keep
