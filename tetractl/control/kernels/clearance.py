"""The clearance of robots from obstacles, walls and each other, which `tetractl.control.margins`
and `discs` ask at every control step. Obstacles are `rows` and `walls` of
`tetractl.core.obstacles`.
"""

import math

from tetractl.control.kernels.obstacles import (
    BOTTOM,
    CORNERS,
    FIRST,
    LEFT,
    RADIUS,
    RIGHT,
    TOP,
    touches,
)
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, INLINE_EXACT


@compiled(**INLINE_EXACT)
def _gap(rows, walls, o, x, y):
    """Return the distance of (x, y) to obstacle o, negative inside; bit by bit that of
    `tetractl.core.shape`."""
    if o >= rows.shape[0]:
        w = o - rows.shape[0]
        along = x if w % 2 == 0 else y
        return along - walls[w] if w < 2 else walls[w] - along
    row = rows[o]
    last = FIRST + 2 * int(row[CORNERS]) - 2
    inside = False
    least = math.inf
    ax = row[last]
    ay = row[last + 1]
    for k in range(FIRST, last + 1, 2):
        bx = row[k]
        by = row[k + 1]
        ex = bx - ax
        ey = by - ay
        if (ay > y) != (by > y) and (ex * (y - ay) - ey * (x - ax) > 0) == (by > ay):
            inside = not inside
        length2 = ex * ex + ey * ey
        along = ((x - ax) * ex + (y - ay) * ey) / (length2 if length2 > 0.0 else 1.0)
        along = max(0.0, min(along, 1.0))
        least = min(least, math.hypot(x - (ax + along * ex), y - (ay + along * ey)))
        ax = bx
        ay = by
    return (-least if inside else least) - row[RADIUS]


@compiled(**INLINE_EXACT)
def _least(rows, walls, x, y):
    """Return the distance of (x, y) to the nearest obstacle, inf if there is none."""
    least = math.inf
    for o in range(rows.shape[0] + walls.size):
        least = min(least, _gap(rows, walls, o, x, y))
    return least


@compiled(**INLINE_EXACT)
def crosses(rows, walls, x0, y0, x1, y1):
    """Return whether the segment from (x0, y0) to (x1, y1) touches an obstacle."""
    for w in range(walls.size):
        o = rows.shape[0] + w
        if _gap(rows, walls, o, x0, y0) <= 0 or _gap(rows, walls, o, x1, y1) <= 0:
            return True
    for o in range(rows.shape[0]):
        row = rows[o]
        if max(x0, x1) < row[LEFT] or min(x0, x1) > row[RIGHT]:
            continue
        if max(y0, y1) < row[BOTTOM] or min(y0, y1) > row[TOP]:
            continue
        if touches(row, x0, y0, x1, y1):
            return True
    return False


@compiled(**ENTRY)
def gaps(rows, walls, x, y, distances):
    """Write the distance of each point x, y (P,) to each obstacle to distances (O, P)."""
    for o in range(distances.shape[0]):
        for n in range(x.size):
            distances[o, n] = _gap(rows, walls, o, x[n], y[n])


@compiled(**ENTRY)
def least_apart(x, y):
    """Return the least distance between two of N points x, y (N,), inf for a single point."""
    least = math.inf
    for i in range(x.size):
        for k in range(i):
            least = min(least, math.hypot(x[k] - x[i], y[k] - y[i]))
    return least


@compiled(**ENTRY)
def enters(rows, walls, body_rows, body_walls, radius, path):
    """Return whether a body would touch an obstacle or another body on the way along path
    (M, N, 3), or would go deeper if it touches one at the beginning.

    The obstacles are given bare and grown by the bodies' radius.
    """
    for i in range(path.shape[1]):
        crossed = deeper = False
        first = _least(rows, walls, path[0, i, 0], path[0, i, 1])
        for m in range(1, path.shape[0]):
            ends = path[m - 1, i, 0], path[m - 1, i, 1], path[m, i, 0], path[m, i, 1]
            crossed |= crosses(body_rows, body_walls, *ends)
            deeper |= _least(rows, walls, path[m, i, 0], path[m, i, 1]) < first
            for k in range(i):
                before = math.hypot(path[0, k, 0] - path[0, i, 0], path[0, k, 1] - path[0, i, 1])
                apart = math.hypot(path[m, k, 0] - path[m, i, 0], path[m, k, 1] - path[m, i, 1])
                if apart < min(2 * radius, before):
                    return True
        if crossed and (deeper or _least(body_rows, body_walls, path[0, i, 0], path[0, i, 1]) > 0):
            return True
    return False
