"""The shape of an obstacle as data: the corners of a polygon, and the radius that rounds it.

A shape is every point within the radius of a polygon: one corner is a disc, two are a capsule, four
may be a rectangle. The polygon may be concave, but its edges do not cross. A shape grown by a
margin has a larger radius: its edge is where the centre of a touching round robot is. The compiled
twin of this geometry is `tetractl.control.kernels.obstacles`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tetractl.core import elementwise
from tetractl.core.poses import Bools, Floats

EDGES_AT_A_TIME = 8
"""Number of edges that are compared with all points at a time, to bound the memory."""


@dataclass(frozen=True, eq=False)
class Shape:
    """An obstacle in the plane, including its edge; lengths are in the spec's unit."""

    corners: Floats
    """Corners (K, 2) of the polygon, anticlockwise; if the radius is positive, convex."""
    radius: float = 0.0

    def grown(self, margin: float) -> "Shape":
        """Return the shape that contains every point within the margin of this one."""
        return replace(self, radius=self.radius + margin)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """The least and the greatest coordinates: left, bottom, right, top."""
        low = self.corners.min(axis=0)
        high = self.corners.max(axis=0)
        return *(low - self.radius).tolist(), *(high + self.radius).tolist()

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point lies in the shape, p(s) of the paper's equation (13)."""
        return self.distance(x, y) <= 0

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the signed distance of each point to the edge, negative inside.

        A point is inside the polygon if a ray from it crosses an odd number of edges.
        """
        shape = np.broadcast(x, y).shape
        x, y = (a.ravel() for a in np.broadcast_arrays(x, y))
        inside = np.zeros(x.shape, dtype=np.bool_)
        least = np.full(x.shape, np.inf)
        for ax, ay, bx, by in self._edges():
            eastwards = (turn(ax, ay, bx, by, x, y) > 0) == (by > ay)
            crosses = eastwards & ((ay > y) != (by > y))
            inside ^= np.logical_xor.reduce(crosses, axis=0)
            least = np.minimum(least, _to_segments(x, y, ax, ay, bx, by).min(axis=0))
        return (np.where(inside, -least, least) - self.radius).reshape(shape)

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether each straight segment from (x0, y0) to (x1, y1) touches the shape."""
        x0, y0, x1, y1 = np.broadcast_arrays(x0, y0, x1, y1)
        left, bottom, right, top = self.box
        near = np.asarray((np.maximum(x0, x1) >= left) & (np.minimum(x0, x1) <= right))
        near &= (np.maximum(y0, y1) >= bottom) & (np.minimum(y0, y1) <= top)
        if near.any():
            near[near] = self._touched(x0[near], y0[near], x1[near], y1[near])
        return near

    def _touched(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether segments (M,) have an end inside, meet an edge or pass near a corner."""
        touched = self.contain(x0, y0) | self.contain(x1, y1)
        for ax, ay, bx, by in self._edges():
            touched |= meet(x0, y0, x1, y1, ax, ay, bx, by).any(axis=0)
            touched |= (_to_segments(ax, ay, x0, y0, x1, y1) <= self.radius).any(axis=0)
        return touched

    def outline(self) -> Floats:
        """Return the corners (M, 2), anticlockwise, of a polygon with which to draw the shape."""
        if self.radius == 0:
            return self.corners
        angle = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        away = np.column_stack([elementwise.cos(angle), elementwise.sin(angle)])
        furthest = np.einsum("ak,ck->ac", away, self.corners).argmax(axis=1)
        return self.corners[furthest] + self.radius * away

    def _edges(self) -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
        """Yield x and y of starts and ends of up to EDGES_AT_A_TIME edges, (edges, 1) each."""
        starts = np.concatenate([self.corners[-1:], self.corners[:-1]])
        edges = np.hstack([starts, self.corners])
        for first in range(0, len(edges), EDGES_AT_A_TIME):
            ax, ay, bx, by = edges[first : first + EDGES_AT_A_TIME].T[..., None]
            yield ax, ay, bx, by


def turn(ax: Any, ay: Any, bx: Any, by: Any, cx: Any, cy: Any) -> Any:
    """Return twice the signed area of a triangle, positive if it turns anticlockwise."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def meet(x0: Any, y0: Any, x1: Any, y1: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Return whether two segments have a point in common, ends included; arguments broadcast."""
    a = turn(x0, y0, x1, y1, ax, ay)
    b = turn(x0, y0, x1, y1, bx, by)
    c = turn(ax, ay, bx, by, x0, y0)
    d = turn(ax, ay, bx, by, x1, y1)
    apart = np.maximum(x0, x1) < np.minimum(ax, bx)
    apart |= np.maximum(ax, bx) < np.minimum(x0, x1)
    apart |= np.maximum(y0, y1) < np.minimum(ay, by)
    apart |= np.maximum(ay, by) < np.minimum(y0, y1)
    # both ends on the same side of the other segment
    apart |= ((a > 0) & (b > 0)) | ((a < 0) & (b < 0)) | ((c > 0) & (d > 0)) | ((c < 0) & (d < 0))
    return ~apart


def _to_segments(x: Any, y: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Floats:
    """Return the distance of points to segments from (ax, ay) to (bx, by); arguments broadcast."""
    ex = bx - ax
    ey = by - ay
    length2 = ex * ex + ey * ey
    along = ((x - ax) * ex + (y - ay) * ey) / np.where(length2 > 0, length2, 1.0)
    along = np.clip(along, 0.0, 1.0)
    return elementwise.hypot(x - (ax + along * ex), y - (ay + along * ey))
