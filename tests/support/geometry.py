"""Rectangles and circles by textbook geometry, one point or segment at a time."""

import math

from tetractl.experiment.experiment import Circle, Rectangle


def gap(thing: Rectangle | Circle, x: float, y: float) -> float:
    """Signed distance from a point to an obstacle, negative inside."""
    if isinstance(thing, Circle):
        return math.dist((x, y), thing.center) - thing.radius
    right, top = thing.left + thing.width, thing.bottom + thing.height
    if thing.left <= x <= right and thing.bottom <= y <= top:
        return -min(x - thing.left, right - x, y - thing.bottom, top - y)
    return math.dist((x, y), (min(max(x, thing.left), right), min(max(y, thing.bottom), top)))


def meets(thing: Rectangle | Circle, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a segment meets an obstacle: by the foot of the normal, or Liang and Barsky."""
    if isinstance(thing, Circle):
        cx, cy = thing.center
        length2 = (x1 - x0) ** 2 + (y1 - y0) ** 2
        t = ((cx - x0) * (x1 - x0) + (cy - y0) * (y1 - y0)) / length2 if length2 else 0
        t = min(max(t, 0), 1)
        return math.dist((x0 + t * (x1 - x0), y0 + t * (y1 - y0)), (cx, cy)) <= thing.radius
    enter, leave = 0.0, 1.0
    for start, step, low, high in (
        (x0, x1 - x0, thing.left, thing.left + thing.width),
        (y0, y1 - y0, thing.bottom, thing.bottom + thing.height),
    ):
        if step == 0:
            if not low <= start <= high:
                return False
            continue
        first, last = sorted(((low - start) / step, (high - start) / step))
        enter, leave = max(enter, first), min(leave, last)
    return enter <= leave
