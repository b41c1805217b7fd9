"""The shape of an obstacle: a polygon, with its outline moved outwards by a radius.

A shape consists of all points within the radius of a polygon. A polygon with one corner gives a
disc, with two corners a capsule, and with four corners for example a rectangle. The polygon may be
concave, but its edges do not cross. A shape grown by a margin has a larger radius. If the margin is
the radius of a round robot, the edge is where the robot's centre is when it touches the obstacle.

The functions of segments below are the geometry of all obstacles. Their arguments are arrays that
broadcast, or single numbers: kernels (`tetractl.control.search.kernels.obstacles`) compile the same
functions.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tetractl.core import elementwise
from tetractl.core.poses import Bools, Floats

EDGES_AT_A_TIME = 8
"""Number of edges that are compared with all points at once, which limits the memory used."""


@dataclass(frozen=True, eq=False)
class Shape:
    """An obstacle in the plane, including its edge; lengths are in the spec's unit."""

    corners: Floats
    """Corners of the polygon, anticlockwise, shape (K, 2).

    It is convex if the radius is positive.
    """
    radius: float = 0.0

    def grown(self, margin: float) -> "Shape":
        """Return the shape enlarged on all sides by a margin [length unit]."""
        return replace(self, radius=self.radius + margin)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """The smallest axis-aligned rectangle around the shape: left, bottom, right, top."""
        lower = self.corners.min(axis=0)
        upper = self.corners.max(axis=0)
        return *(lower - self.radius).tolist(), *(upper + self.radius).tolist()

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Check which points are in the shape or on its edge: p(s) of the paper's (13)."""
        return self.distance(x, y) <= 0

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the signed distance of each point to the edge, negative inside.

        A point is inside the polygon if a ray from it crosses an odd number of edges.
        """
        shape = np.broadcast(x, y).shape
        x, y = (coordinates.ravel() for coordinates in np.broadcast_arrays(x, y))
        inside = np.zeros(x.shape, dtype=np.bool_)
        nearest2 = np.full(x.shape, np.inf)
        for ax, ay, bx, by in self._edges():
            inside ^= np.logical_xor.reduce(ray_crosses(x, y, ax, ay, bx, by), axis=0)
            nearest2 = np.minimum(nearest2, gap2(x, y, ax, ay, bx, by).min(axis=0))
        nearest = np.sqrt(nearest2)
        return (np.where(inside, -nearest, nearest) - self.radius).reshape(shape)

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Check which straight segments touch the shape.

        Args:
            x0: x of the start of each segment.
            y0: y of the start of each segment.
            x1: x of the end of each segment.
            y1: y of the end of each segment.
        """
        x0, y0, x1, y1 = np.broadcast_arrays(x0, y0, x1, y1)
        left, bottom, right, top = self.box
        may_touch = np.asarray((np.maximum(x0, x1) >= left) & (np.minimum(x0, x1) <= right))
        may_touch &= (np.maximum(y0, y1) >= bottom) & (np.minimum(y0, y1) <= top)
        if may_touch.any():
            may_touch[may_touch] = self._find_touching(
                x0[may_touch], y0[may_touch], x1[may_touch], y1[may_touch]
            )
        return may_touch

    def _find_touching(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Check which segments (M,) begin inside, or come nearer to an edge than the radius."""
        touches = np.zeros(x0.shape, dtype=np.bool_)
        inside = np.zeros(x0.shape, dtype=np.bool_)
        for ax, ay, bx, by in self._edges():
            distance2 = segments_gap2(x0, y0, x1, y1, ax, ay, bx, by)
            touches |= (distance2 <= self.radius * self.radius).any(axis=0)
            inside ^= np.logical_xor.reduce(ray_crosses(x0, y0, ax, ay, bx, by), axis=0)
        return touches | inside

    def outline(self) -> Floats:
        """Return a polygon for drawing the shape: corners in anticlockwise order, shape (M, 2)."""
        if self.radius == 0:
            return self.corners
        angles = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        directions = np.column_stack([elementwise.cos(angles), elementwise.sin(angles)])
        furthest = np.einsum("ak,ck->ac", directions, self.corners).argmax(axis=1)
        return self.corners[furthest] + self.radius * directions

    def _edges(self) -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
        """Yield the edges of the polygon in groups of up to EDGES_AT_A_TIME.

        Each group contains x and y of the starts and x and y of the ends, shape (edges, 1) each.
        """
        starts = np.concatenate([self.corners[-1:], self.corners[:-1]])
        edges = np.hstack([starts, self.corners])
        for start in range(0, len(edges), EDGES_AT_A_TIME):
            ax, ay, bx, by = edges[start : start + EDGES_AT_A_TIME].T[..., None]
            yield ax, ay, bx, by


def turn(ax: Any, ay: Any, bx: Any, by: Any, cx: Any, cy: Any) -> Any:
    """Compute twice the signed area of the triangle a, b, c. It is positive if a, b, c turn left.

    Args:
        ax: x of corner a.
        ay: y of corner a.
        bx: x of corner b.
        by: y of corner b.
        cx: x of corner c.
        cy: y of corner c.
    """
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def meet(x0: Any, y0: Any, x1: Any, y1: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Check whether two segments have a point in common. Their ends belong to them.

    Args:
        x0: x of the start of the first segment.
        y0: y of the start of the first segment.
        x1: x of the end of the first segment.
        y1: y of the end of the first segment.
        ax: x of the start of the second segment.
        ay: y of the start of the second segment.
        bx: x of the end of the second segment.
        by: y of the end of the second segment.
    """
    a = turn(x0, y0, x1, y1, ax, ay)
    b = turn(x0, y0, x1, y1, bx, by)
    c = turn(ax, ay, bx, by, x0, y0)
    d = turn(ax, ay, bx, by, x1, y1)
    overlaps = np.maximum(x0, x1) >= np.minimum(ax, bx)
    overlaps = overlaps & (np.maximum(ax, bx) >= np.minimum(x0, x1))
    overlaps = overlaps & (np.maximum(y0, y1) >= np.minimum(ay, by))
    overlaps = overlaps & (np.maximum(ay, by) >= np.minimum(y0, y1))
    # not both ends on the same side of the other segment
    across_one = ((a <= 0) | (b <= 0)) & ((a >= 0) | (b >= 0))
    across_other = ((c <= 0) | (d <= 0)) & ((c >= 0) | (d >= 0))
    return overlaps & across_one & across_other


def offset(x: Any, y: Any, ax: Any, ay: Any, bx: Any, by: Any) -> tuple[Any, Any]:
    """Compute the vector from the nearest point of a segment to a point, as x and y.

    Args:
        x: x of the point.
        y: y of the point.
        ax: x of the segment's start.
        ay: y of the segment's start.
        bx: x of the segment's end.
        by: y of the segment's end.
    """
    ex = bx - ax
    ey = by - ay
    px = x - ax
    py = y - ay
    length2 = ex * ex + ey * ey
    along = (px * ex + py * ey) / (length2 + (length2 == 0))
    along = np.maximum(0.0, np.minimum(along, 1.0))
    return px - along * ex, py - along * ey


def gap2(x: Any, y: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Compute the squared distance between a point and a segment.

    Args:
        x: x of the point.
        y: y of the point.
        ax: x of the segment's start.
        ay: y of the segment's start.
        bx: x of the segment's end.
        by: y of the segment's end.
    """
    off_x, off_y = offset(x, y, ax, ay, bx, by)
    return off_x * off_x + off_y * off_y


def segments_gap2(x0: Any, y0: Any, x1: Any, y1: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Compute the squared distance between two segments. It is 0 if they meet.

    Args:
        x0: x of the start of the first segment.
        y0: y of the start of the first segment.
        x1: x of the end of the first segment.
        y1: y of the end of the first segment.
        ax: x of the start of the second segment.
        ay: y of the start of the second segment.
        bx: x of the end of the second segment.
        by: y of the end of the second segment.
    """
    ends2 = np.minimum(gap2(x0, y0, ax, ay, bx, by), gap2(x1, y1, ax, ay, bx, by))
    corners2 = np.minimum(gap2(ax, ay, x0, y0, x1, y1), gap2(bx, by, x0, y0, x1, y1))
    are_apart = np.logical_not(meet(x0, y0, x1, y1, ax, ay, bx, by))
    return np.minimum(ends2, corners2) * are_apart


def ray_crosses(x: Any, y: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Check whether the ray from a point in the direction +x crosses an edge of a polygon.

    A point is inside the polygon if its ray crosses an odd number of edges.

    Args:
        x: x of the point.
        y: y of the point.
        ax: x of the edge's start.
        ay: y of the edge's start.
        bx: x of the edge's end.
        by: y of the edge's end.
    """
    return ((ay > y) != (by > y)) & ((turn(ax, ay, bx, by, x, y) > 0) == (by > ay))
