"""Obstacles against lanes: the twins of `Obstacles.contain` and `Obstacles.cross`.

Each function lowers gap[n] to a number that is at most 0 exactly where the lane meets the obstacle.
Comparing a difference with 0 is the same as comparing its terms, and faster in vector code.
"""

from numba import njit

from tetractl.control.kernels.numeric import PART


@njit(**PART)
def in_rectangle(x, y, left, bottom, right, top, gap):
    """Whether (x[n], y[n]) is in the rectangle."""
    for n in range(x.size):
        gap_x, gap_y = max(left - x[n], x[n] - right), max(bottom - y[n], y[n] - top)
        gap[n] = min(gap[n], max(gap_x, gap_y))


@njit(**PART)
def in_circle(x, y, cx, cy, radius, gap):
    """Whether (x[n], y[n]) is in the disc."""
    r2 = radius * radius
    for n in range(x.size):
        dx, dy = x[n] - cx, y[n] - cy
        gap[n] = min(gap[n], dx * dx + dy * dy - r2)


@njit(**PART)
def through_rectangle(x0, y0, x1, y1, left, bottom, right, top, gap):
    """Whether the segment from (x0[n], y0[n]) to (x1[n], y1[n]) meets it (separating axes)."""
    cx, cy, hx, hy = (left + right) / 2, (bottom + top) / 2, (right - left) / 2, (top - bottom) / 2
    for n in range(x0.size):
        dx, dy = x1[n] - x0[n], y1[n] - y0[n]
        mx, my = x0[n] + dx / 2 - cx, y0[n] + dy / 2 - cy
        beside = max(abs(mx) - (hx + abs(dx) / 2), abs(my) - (hy + abs(dy) / 2))
        across = abs(dx * my - dy * mx) - (hx * abs(dy) + hy * abs(dx))
        gap[n] = min(gap[n], max(beside, across))


@njit(**PART)
def through_circle(x0, y0, x1, y1, cx, cy, radius, gap):
    """Whether the segment from (x0[n], y0[n]) to (x1[n], y1[n]) meets the disc."""
    r2 = radius * radius
    for n in range(x0.size):
        dx, dy = x1[n] - x0[n], y1[n] - y0[n]
        length2 = dx * dx + dy * dy
        along = (cx - x0[n]) * dx + (cy - y0[n]) * dy
        nearest = max(0.0, min(along / (length2 if length2 > 0 else 1.0), 1.0))
        gx, gy = x0[n] + nearest * dx - cx, y0[n] + nearest * dy - cy
        gap[n] = min(gap[n], gx * gx + gy * gy - r2)


@njit(**PART)
def count_hits(x0, y0, x, y, boxes, discs, swept, gap, count):
    """Add 1 to count[n] where a lane is in (or, if swept, came through) any obstacle.

    boxes (R, 4) hold left, bottom, right, top; discs (C, 3) x, y, radius; gap is 1 before and
    after.
    """
    for o in range(boxes.shape[0]):
        left, bottom, right, top = boxes[o, 0], boxes[o, 1], boxes[o, 2], boxes[o, 3]
        if swept:
            through_rectangle(x0, y0, x, y, left, bottom, right, top, gap)
        else:
            in_rectangle(x, y, left, bottom, right, top, gap)
    for o in range(discs.shape[0]):
        cx, cy, radius = discs[o, 0], discs[o, 1], discs[o, 2]
        if swept:
            through_circle(x0, y0, x, y, cx, cy, radius, gap)
        else:
            in_circle(x, y, cx, cy, radius, gap)
    for n in range(gap.size):
        count[n] += 1.0 if gap[n] <= 0 else 0.0
        gap[n] = 1.0
