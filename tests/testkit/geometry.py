"""Distances to shapes by textbook geometry, one point or segment at a time."""

import itertools
import math
from typing import assert_never

from tetractl.model.shapes import Circle, Polygon, Rectangle

Thing = Rectangle | Circle | Polygon


def gap(thing: Thing, x: float, y: float) -> float:
    """Signed distance from a point to an obstacle, negative inside."""
    match thing:
        case Circle():
            return math.dist((x, y), thing.center) - thing.radius
        case Rectangle():
            right = thing.left + thing.width
            top = thing.bottom + thing.height
            if thing.left <= x <= right and thing.bottom <= y <= top:
                return -min(x - thing.left, right - x, y - thing.bottom, top - y)
            nearest_x = min(max(x, thing.left), right)
            nearest_y = min(max(y, thing.bottom), top)
            return math.dist((x, y), (nearest_x, nearest_y))
        case Polygon():
            to_edge = min(to_segment(x, y, *start, *end) for start, end in edges(thing))
            return -to_edge if winds(thing, x, y) else to_edge
        case _:
            assert_never(thing)


def meets(thing: Thing, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a segment meets an obstacle: by the foot of the normal, or by clipping."""
    match thing:
        case Circle():
            return to_segment(*thing.center, x0, y0, x1, y1) <= thing.radius
        case Rectangle():
            return clips(thing, x0, y0, x1, y1)
        case Polygon():
            return cuts(thing, x0, y0, x1, y1)
        case _:
            assert_never(thing)


def to_segment(x: float, y: float, x0: float, y0: float, x1: float, y1: float) -> float:
    """Distance from a point to a segment."""
    length2 = (x1 - x0) ** 2 + (y1 - y0) ** 2
    t = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length2 if length2 else 0
    t = min(max(t, 0), 1)
    return math.dist((x0 + t * (x1 - x0), y0 + t * (y1 - y0)), (x, y))


def clips(box: Rectangle, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a segment meets a rectangle, as Liang and Barsky clip it."""
    enter = 0.0
    leave = 1.0
    for start, step, low, high in (
        (x0, x1 - x0, box.left, box.left + box.width),
        (y0, y1 - y0, box.bottom, box.bottom + box.height),
    ):
        if step == 0:
            if not low <= start <= high:
                return False
            continue
        first, last = sorted(((low - start) / step, (high - start) / step))
        enter = max(enter, first)
        leave = min(leave, last)
    return enter <= leave


def edges(polygon: Polygon) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    corners = polygon.vertices
    return list(zip(corners, (*corners[1:], corners[0]), strict=True))


def winds(polygon: Polygon, x: float, y: float) -> bool:
    """Whether a polygon winds round a point that is not on its edge: by the angles it turns."""
    total = 0.0
    for (ax, ay), (bx, by) in edges(polygon):
        begin = math.atan2(ay - y, ax - x)
        end = math.atan2(by - y, bx - x)
        total += math.remainder(end - begin, 2 * math.pi)
    return abs(total) > math.pi


def cuts(polygon: Polygon, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a segment meets a polygon: it is cut by all edges, and each piece's middle tested."""
    cut = [0.0, 1.0]
    for (ax, ay), (bx, by) in edges(polygon):
        normal_x = by - ay
        normal_y = ax - bx
        begin = (x0 - ax) * normal_x + (y0 - ay) * normal_y  # distances from the edge's line
        end = (x1 - ax) * normal_x + (y1 - ay) * normal_y
        if begin != end:
            cut.append(begin / (begin - end))
    cut = sorted(t for t in cut if 0 <= t <= 1)
    tests = cut + [(s + t) / 2 for s, t in itertools.pairwise(cut)]
    points = [(x0 + t * (x1 - x0), y0 + t * (y1 - y0)) for t in tests]
    corner = any(to_segment(*corner, x0, y0, x1, y1) <= 1e-12 for corner in polygon.vertices)
    return corner or any(gap(polygon, x, y) <= 1e-12 for x, y in points)
