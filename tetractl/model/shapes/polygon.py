"""Simple polygons, which may be concave, such as walls and channels of micro-arenas.

A polygon is grown by subtracting the margin from its signed distance. This rounds its corners: the
edge of the grown polygon is where the centre of a touching round robot is.
"""

import math
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.poses import Bools, Floats
from tetractl.experiment.base import Point, inconsistent
from tetractl.experiment.shape_section import ShapeSection

HEAD = 6  # number of values in a row before the vertices


def nearest_on_edge(
    x: float, y: float, ax: float, ay: float, bx: float, by: float
) -> tuple[float, float]:
    """Return the point of the edge from (ax, ay) to (bx, by) that is nearest to (x, y)."""
    ex, ey = bx - ax, by - ay
    length2 = ex * ex + ey * ey
    along = ((x - ax) * ex + (y - ay) * ey) / (length2 if length2 > 0.0 else 1.0)
    along = max(0.0, min(along, 1.0))
    return ax + along * ex, ay + along * ey


def squared_to_edge(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the squared distance of (x, y) to the edge from (ax, ay) to (bx, by)."""
    qx, qy = nearest_on_edge(x, y, ax, ay, bx, by)
    return (x - qx) * (x - qx) + (y - qy) * (y - qy)


def passes_right(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> bool:
    """Return whether an edge crosses the ray that leaves (x, y) eastwards."""
    if (ay > y) == (by > y):
        return False
    return x < (bx - ax) * (y - ay) / (by - ay) + ax


def turn(ax: Any, ay: Any, bx: Any, by: Any, cx: Any, cy: Any) -> Any:
    """Return twice the signed area of a triangle, positive if it turns anticlockwise."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def meet(
    x0: float, y0: float, x1: float, y1: float, ax: float, ay: float, bx: float, by: float
) -> bool:
    """Return whether two segments have a point in common, ends included."""
    if max(x0, x1) < min(ax, bx) or max(ax, bx) < min(x0, x1):
        return False
    if max(y0, y1) < min(ay, by) or max(ay, by) < min(y0, y1):
        return False
    a, b = turn(x0, y0, x1, y1, ax, ay), turn(x0, y0, x1, y1, bx, by)
    c, d = turn(ax, ay, bx, by, x0, y0), turn(ax, ay, bx, by, x1, y1)
    return not ((a > 0 and b > 0) or (a < 0 and b < 0) or (c > 0 and d > 0) or (c < 0 and d < 0))


def nearest_edge(x: float, y: float, p: Any) -> tuple[float, float, float, int]:
    """Return signed distance without margin, x and y of the nearest edge point, edge's number."""
    count = int(p[1])
    inside, least, near_x, near_y, edge = False, math.inf, 0.0, 0.0, 0
    ax, ay = p[HEAD + 2 * count - 2], p[HEAD + 2 * count - 1]
    for i in range(count):
        bx, by = p[HEAD + 2 * i], p[HEAD + 2 * i + 1]
        if passes_right(x, y, ax, ay, bx, by):
            inside = not inside
        qx, qy = nearest_on_edge(x, y, ax, ay, bx, by)
        gap2 = (x - qx) * (x - qx) + (y - qy) * (y - qy)
        if gap2 < least:
            least, near_x, near_y, edge = gap2, qx, qy, i
        ax, ay = bx, by
    return (-math.sqrt(least) if inside else math.sqrt(least)), near_x, near_y, edge


class PackedPolygons(NamedTuple):
    """Polygons in the form used by kernels; see `tetractl.model.shapes.shape.PackedShapes`."""

    rows: Floats
    """(M, 6 + 2 V): margin, number of vertices, the box around the grown polygon (left, bottom,
    right, top), then x, y of each vertex, anticlockwise."""
    size = None

    @staticmethod
    def gap(x: float, y: float, p: Any) -> float:
        """Return the gap to the bounding box if positive, otherwise the gap to the polygon."""
        box = max(max(p[2] - x, x - p[4]), max(p[3] - y, y - p[5]))
        if box > 0.0:
            return box
        return nearest_edge(x, y, p)[0] - p[0]

    @staticmethod
    def gap_between(x0: float, y0: float, x1: float, y1: float, p: Any) -> float:
        """Return the gap to the bounding box if positive, otherwise distance minus margin."""
        beside = max(p[2] - max(x0, x1), min(x0, x1) - p[4])
        box = max(beside, max(p[3] - max(y0, y1), min(y0, y1) - p[5]))
        if box > 0.0:
            return box
        count, inside, least = int(p[1]), False, math.inf
        ax, ay = p[HEAD + 2 * count - 2], p[HEAD + 2 * count - 1]
        for i in range(count):
            bx, by = p[HEAD + 2 * i], p[HEAD + 2 * i + 1]
            if meet(x0, y0, x1, y1, ax, ay, bx, by):
                return -1.0
            if passes_right(x0, y0, ax, ay, bx, by):
                inside = not inside
            least = min(least, squared_to_edge(x0, y0, ax, ay, bx, by))
            least = min(least, squared_to_edge(x1, y1, ax, ay, bx, by))
            least = min(least, squared_to_edge(ax, ay, x0, y0, x1, y1))
            ax, ay = bx, by
        return -1.0 if inside else math.sqrt(least) - p[0]

    @staticmethod
    def depth(x: float, y: float, p: Any) -> float:
        """Return the margin minus the signed distance."""
        return p[0] - nearest_edge(x, y, p)[0]

    @staticmethod
    def outward(x: float, y: float, p: Any) -> tuple[float, float]:
        """Return the direction along which the signed distance grows; on the edge, its normal."""
        signed, near_x, near_y, edge = nearest_edge(x, y, p)
        if abs(signed) > 1e-9 * (abs(near_x) + abs(near_y)):
            return (x - near_x) / signed, (y - near_y) / signed
        before = edge - 1 if edge > 0 else int(p[1]) - 1
        ex = p[HEAD + 2 * edge] - p[HEAD + 2 * before]
        ey = p[HEAD + 2 * edge + 1] - p[HEAD + 2 * before + 1]
        length = math.sqrt(ex * ex + ey * ey)
        return ey / length, -ex / length


class Polygon(ShapeSection):
    """A polygon whose edges do not cross each other; it may be concave."""

    type: Literal["polygon"]
    vertices: tuple[Point, ...] = Field(min_length=3, max_length=200)
    """Corners [x, y] in order round the polygon, in either sense [length unit]; an edge joins the
    last to the first.
    """

    packed: ClassVar[Any] = PackedPolygons

    @model_validator(mode="after")
    def _is_simple(self) -> Self:
        count = len(self.vertices)
        edges = [(*self.vertices[i - 1], *self.vertices[i]) for i in range(count)]
        for i, (ax, ay, bx, by) in enumerate(edges):
            if (ax, ay) == (bx, by):
                message = f"has the corner {_text(self.vertices[i])} twice in a row; leave one out"
                raise inconsistent("vertices", message)
        for i, (ax, ay, bx, by) in enumerate(edges):
            cx, cy = self.vertices[(i + 1) % count]
            back = (bx - ax) * (cx - bx) + (by - ay) * (cy - by) < 0
            if back and turn(ax, ay, bx, by, cx, cy) == 0:
                message = f"turns back on itself at {_text(self.vertices[i])}; it must have area"
                raise inconsistent("vertices", message)
            for j in range(i + 2, count - (i == 0)):
                if meet(ax, ay, bx, by, *edges[j]):
                    message = (
                        f"crosses or touches itself: the edge that ends in "
                        f"{_text(self.vertices[i])} meets the one that ends in "
                        f"{_text(self.vertices[j])}; list the corners in order round the polygon"
                    )
                    raise inconsistent("vertices", message)
        if _doubled_area(np.array(self.vertices)) == 0:
            raise inconsistent(
                "vertices", "has an area too large or too small to compute; use another length unit"
            )
        return self

    def row(self) -> tuple[float, ...]:
        """Return margin, number of vertices, box and vertices."""
        vertices = self.outline()
        low, high = vertices.min(axis=0) - self.margin, vertices.max(axis=0) + self.margin
        head = (self.margin, float(len(vertices)), *low.tolist(), *high.tolist())
        return *head, *vertices.ravel().tolist()

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point is inside, on the edge, or within the margin of the edge."""
        return self.distance(x, y) <= 0

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether a segment starts inside, meets an edge, or comes within the margin."""
        shape = np.broadcast(x0, y0, x1, y1).shape
        inside, met, least = np.zeros(shape, bool), np.zeros(shape, bool), np.full(shape, np.inf)
        for ax, ay, bx, by in self._edges():
            a, b = turn(x0, y0, x1, y1, ax, ay), turn(x0, y0, x1, y1, bx, by)
            c, d = turn(ax, ay, bx, by, x0, y0), turn(ax, ay, bx, by, x1, y1)
            apart = (np.maximum(x0, x1) < min(ax, bx)) | (max(ax, bx) < np.minimum(x0, x1))
            apart |= (np.maximum(y0, y1) < min(ay, by)) | (max(ay, by) < np.minimum(y0, y1))
            # both ends on the same side of the other segment
            apart |= ((a > 0) & (b > 0)) | ((a < 0) & (b < 0))
            apart |= ((c > 0) & (d > 0)) | ((c < 0) & (d < 0))
            met |= ~apart
            inside ^= _passes_right(x0, y0, ax, ay, bx, by)
            for gap in (
                _to_segment(x0, y0, ax, ay, bx, by),
                _to_segment(x1, y1, ax, ay, bx, by),
                _to_segment(ax, ay, x0, y0, x1, y1),
            ):
                least = np.minimum(least, gap)
        return inside | met | (least <= self.margin)

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance to the nearest edge, negative inside, minus the margin.

        A point is inside if a ray from it crosses an odd number of edges.
        """
        shape = np.broadcast(x, y).shape
        inside, least = np.zeros(shape, bool), np.full(shape, np.inf)
        for ax, ay, bx, by in self._edges():
            inside ^= _passes_right(x, y, ax, ay, bx, by)
            least = np.minimum(least, _to_segment(x, y, ax, ay, bx, by))
        return np.where(inside, -least, least) - self.margin

    def outline(self) -> Floats:
        """Return the vertices, anticlockwise."""
        vertices = np.array(self.vertices, dtype=np.float64)
        return vertices if _doubled_area(vertices) > 0 else vertices[::-1]

    def _edges(self) -> list[tuple[float, ...]]:
        """Return x, y of the start and end of each edge."""
        vertices = self.outline()
        return [tuple(edge) for edge in np.hstack([np.roll(vertices, 1, 0), vertices]).tolist()]


def _passes_right(x: Floats, y: Floats, ax: float, ay: float, bx: float, by: float) -> Bools:
    """Return whether an edge crosses the ray that leaves each point eastwards."""
    if ay == by:
        return np.zeros(np.broadcast(x, y).shape, bool)
    return ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)


def _to_segment(x: Any, y: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Floats:
    """Return the distance of points to segments from (ax, ay) to (bx, by); arguments broadcast."""
    ex, ey = bx - ax, by - ay
    length2 = ex * ex + ey * ey
    along = ((x - ax) * ex + (y - ay) * ey) / np.where(length2 > 0, length2, 1.0)
    along = np.clip(along, 0.0, 1.0)
    return np.hypot(x - (ax + along * ex), y - (ay + along * ey))


def _doubled_area(vertices: Floats) -> float:
    """Return twice the signed area of a polygon (M, 2), positive if it is anticlockwise."""
    x, y = (vertices - vertices[0]).T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _text(point: Point) -> str:
    return f"[{point[0]:g}, {point[1]:g}]"
