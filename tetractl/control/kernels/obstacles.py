"""Obstacles against positions: the twins of `Obstacles.contain` and `Obstacles.cross`.

Each test returns a gap: a number that is at most 0 exactly where it meets the obstacle. Comparing a
difference with 0 is the same as comparing its terms, and faster in vector code.
"""

from numba import njit

from tetractl.control.kernels.math import INLINE, PART


@njit(**INLINE)
def in_rectangle(x, y, left, bottom, right, top):
    """Whether (x, y) is in the rectangle."""
    return max(max(left - x, x - right), max(bottom - y, y - top))


@njit(**INLINE)
def in_circle(x, y, cx, cy, radius):
    """Whether (x, y) is in the disc."""
    dx, dy = x - cx, y - cy
    return dx * dx + dy * dy - radius * radius


@njit(**INLINE)
def through_rectangle(x0, y0, x1, y1, left, bottom, right, top):
    """Whether the segment from (x0, y0) to (x1, y1) meets the rectangle (separating axes)."""
    hx, hy, dx, dy = (right - left) / 2, (top - bottom) / 2, x1 - x0, y1 - y0
    mx, my = x0 + dx / 2 - (left + right) / 2, y0 + dy / 2 - (bottom + top) / 2
    beside = max(abs(mx) - (hx + abs(dx) / 2), abs(my) - (hy + abs(dy) / 2))
    return max(beside, abs(dx * my - dy * mx) - (hx * abs(dy) + hy * abs(dx)))


@njit(**INLINE)
def through_circle(x0, y0, x1, y1, cx, cy, radius):
    """Whether the segment from (x0, y0) to (x1, y1) meets the disc."""
    dx, dy = x1 - x0, y1 - y0
    length2 = dx * dx + dy * dy
    along = (cx - x0) * dx + (cy - y0) * dy
    nearest = max(0.0, min(along / (length2 if length2 > 0 else 1.0), 1.0))
    gx, gy = x0 + nearest * dx - cx, y0 + nearest * dy - cy
    return gx * gx + gy * gy - radius * radius


@njit(**PART)
def count_one(x0, y0, x, y, i, boxes, swept, count):
    """Do as `count_hits` where there is one rectangle and nothing else."""
    left, bottom, right, top = boxes[0, 0], boxes[0, 1], boxes[0, 2], boxes[0, 3]
    if swept:
        for n in range(x0.size):
            gap = through_rectangle(x0[n], y0[n], x[i, n], y[i, n], left, bottom, right, top)
            count[i, n] += 1.0 if gap <= 0 else 0.0
    else:
        for n in range(x0.size):
            gap = in_rectangle(x[i, n], y[i, n], left, bottom, right, top)
            count[i, n] += 1.0 if gap <= 0 else 0.0


@njit(**PART)
def count_hits(x0, y0, x, y, i, boxes, discs, swept, gap, count):
    """Add 1 to count[i, n] where robot i is in (or, if swept, came through) any obstacle.

    It came from x0, y0 (P,) to x, y (N, P); boxes (R, 4) hold left, bottom, right, top; discs
    (C, 3) x, y, radius. gap (P,) is the least gap so far, 1 before and after.
    """
    for o in range(boxes.shape[0]):
        left, bottom, right, top = boxes[o, 0], boxes[o, 1], boxes[o, 2], boxes[o, 3]
        if swept:
            for n in range(gap.size):
                new = through_rectangle(x0[n], y0[n], x[i, n], y[i, n], left, bottom, right, top)
                gap[n] = min(gap[n], new)
        else:
            for n in range(gap.size):
                gap[n] = min(gap[n], in_rectangle(x[i, n], y[i, n], left, bottom, right, top))
    for o in range(discs.shape[0]):
        cx, cy, radius = discs[o, 0], discs[o, 1], discs[o, 2]
        if swept:
            for n in range(gap.size):
                new = through_circle(x0[n], y0[n], x[i, n], y[i, n], cx, cy, radius)
                gap[n] = min(gap[n], new)
        else:
            for n in range(gap.size):
                gap[n] = min(gap[n], in_circle(x[i, n], y[i, n], cx, cy, radius))
    for n in range(gap.size):
        count[i, n] += 1.0 if gap[n] <= 0 else 0.0
        gap[n] = 1.0
