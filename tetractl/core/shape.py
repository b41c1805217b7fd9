"""The shape of an obstacle: a polygon, with its outline moved outwards by a radius.

A shape consists of all points within the radius of a polygon. A polygon with one corner gives a
disc, with two corners a capsule, and with four corners for example a rectangle. The polygon may be
concave, but its edges do not cross. A shape grown by a margin has a larger radius. If the margin is
the radius of a round robot, the grown shape contains the centre of every robot that touches the
obstacle.

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

EDGES_PER_GROUP = 8
"""Maximum number of edges that are compared with all points at once, to limit the memory used."""


@dataclass(frozen=True, eq=False)
class Shape:
    """The shape of an obstacle in the plane, including its edge.

    Lengths are in the spec's unit.
    """

    corners: Floats
    """Corners of the polygon, anticlockwise, shape (K, 2) [length unit].

    The polygon must be convex if the radius is positive.
    """
    radius: float = 0.0
    """Distance by which the polygon's outline is moved outwards [length unit]."""

    def grown(self, margin: float) -> "Shape":
        """Return the shape enlarged on all sides by a margin [length unit]."""
        return replace(self, radius=self.radius + margin)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """The smallest axis-aligned rectangle around the shape: left, bottom, right, top."""
        lower = self.corners.min(axis=0)
        upper = self.corners.max(axis=0)
        return *(lower - self.radius).tolist(), *(upper + self.radius).tolist()

    def contains(self, x: Floats, y: Floats) -> Bools:
        """Check which points are in the shape or on its edge.

        This is p(s) of the paper's equation (13).
        """
        return self.distance(x, y) <= 0

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Compute the distance of each point to the shape's edge, negative inside [length unit].

        A point is inside the polygon if a ray from it crosses an odd number of edges.
        """
        shape = np.broadcast(x, y).shape
        x, y = (coordinates.ravel() for coordinates in np.broadcast_arrays(x, y))
        is_inside = np.zeros(x.shape, dtype=np.bool_)
        nearest_squared = np.full(x.shape, np.inf)
        for ax, ay, bx, by in self._edges():
            is_inside ^= np.logical_xor.reduce(ray_crosses(x, y, ax, ay, bx, by), axis=0)
            nearest_squared = np.minimum(
                nearest_squared, squared_distance_to_segment(x, y, ax, ay, bx, by).min(axis=0)
            )
        nearest = np.sqrt(nearest_squared)
        return (np.where(is_inside, -nearest, nearest) - self.radius).reshape(shape)

    def meets_segments(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Check which straight segments touch the shape or lie in it.

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
            may_touch[may_touch] = self._meets_segments(
                x0[may_touch], y0[may_touch], x1[may_touch], y1[may_touch]
            )
        return may_touch

    def _meets_segments(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Check which segments (M,) start inside, or come as near to an edge as the radius."""
        touches = np.zeros(x0.shape, dtype=np.bool_)
        starts_inside = np.zeros(x0.shape, dtype=np.bool_)
        for ax, ay, bx, by in self._edges():
            distance_squared = squared_distance_of_segments(x0, y0, x1, y1, ax, ay, bx, by)
            touches |= (distance_squared <= self.radius * self.radius).any(axis=0)
            starts_inside ^= np.logical_xor.reduce(ray_crosses(x0, y0, ax, ay, bx, by), axis=0)
        return touches | starts_inside

    def outline(self) -> Floats:
        """Return a polygon for drawing the shape: corners in anticlockwise order, shape (M, 2)."""
        if self.radius == 0:
            return self.corners
        angles = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        directions = np.column_stack([elementwise.cos(angles), elementwise.sin(angles)])
        furthest = np.einsum("ak,ck->ac", directions, self.corners).argmax(axis=1)
        return self.corners[furthest] + self.radius * directions

    def _edges(self) -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
        """Yield the edges of the polygon in groups of up to EDGES_PER_GROUP.

        Each group contains x and y of the starts and x and y of the ends, shape (edges, 1) each.
        """
        starts = np.concatenate([self.corners[-1:], self.corners[:-1]])
        edges = np.hstack([starts, self.corners])
        for group_start in range(0, len(edges), EDGES_PER_GROUP):
            ax, ay, bx, by = edges[group_start : group_start + EDGES_PER_GROUP].T[..., None]
            yield ax, ay, bx, by


def signed_double_area(ax: Any, ay: Any, bx: Any, by: Any, cx: Any, cy: Any) -> Any:
    """Compute twice the area of the triangle a, b, c, with a sign.

    The result is positive if the corners are anticlockwise, and negative if they are clockwise.

    Args:
        ax: x of corner a.
        ay: y of corner a.
        bx: x of corner b.
        by: y of corner b.
        cx: x of corner c.
        cy: y of corner c.
    """
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def segments_meet(x0: Any, y0: Any, x1: Any, y1: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Check whether two segments have a point in common. The ends belong to the segments.

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
    side_of_a = signed_double_area(x0, y0, x1, y1, ax, ay)
    side_of_b = signed_double_area(x0, y0, x1, y1, bx, by)
    side_of_start = signed_double_area(ax, ay, bx, by, x0, y0)
    side_of_end = signed_double_area(ax, ay, bx, by, x1, y1)
    overlaps = np.maximum(x0, x1) >= np.minimum(ax, bx)
    overlaps = overlaps & (np.maximum(ax, bx) >= np.minimum(x0, x1))
    overlaps = overlaps & (np.maximum(y0, y1) >= np.minimum(ay, by))
    overlaps = overlaps & (np.maximum(ay, by) >= np.minimum(y0, y1))
    # a segment crosses another one's line unless both its ends are on the same side of that line
    second_crosses_first = ((side_of_a <= 0) | (side_of_b <= 0)) & (
        (side_of_a >= 0) | (side_of_b >= 0)
    )
    first_crosses_second = ((side_of_start <= 0) | (side_of_end <= 0)) & (
        (side_of_start >= 0) | (side_of_end >= 0)
    )
    return overlaps & second_crosses_first & first_crosses_second


def offset_from_segment(x: Any, y: Any, ax: Any, ay: Any, bx: Any, by: Any) -> tuple[Any, Any]:
    """Compute the vector from the nearest point of a segment to a point, as x and y.

    Args:
        x: x of the point.
        y: y of the point.
        ax: x of the segment's start.
        ay: y of the segment's start.
        bx: x of the segment's end.
        by: y of the segment's end.
    """
    edge_x = bx - ax
    edge_y = by - ay
    from_start_x = x - ax
    from_start_y = y - ay
    length_squared = edge_x * edge_x + edge_y * edge_y
    fraction = (from_start_x * edge_x + from_start_y * edge_y) / (
        length_squared + (length_squared == 0)
    )
    fraction = np.maximum(0.0, np.minimum(fraction, 1.0))
    return from_start_x - fraction * edge_x, from_start_y - fraction * edge_y


def squared_distance_to_segment(x: Any, y: Any, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Compute the squared distance between a point and a segment.

    Args:
        x: x of the point.
        y: y of the point.
        ax: x of the segment's start.
        ay: y of the segment's start.
        bx: x of the segment's end.
        by: y of the segment's end.
    """
    offset_x, offset_y = offset_from_segment(x, y, ax, ay, bx, by)
    return offset_x * offset_x + offset_y * offset_y


def squared_distance_of_segments(
    x0: Any, y0: Any, x1: Any, y1: Any, ax: Any, ay: Any, bx: Any, by: Any
) -> Any:
    """Compute the squared distance between two segments. The result is 0 if they meet.

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
    first_ends_squared = np.minimum(
        squared_distance_to_segment(x0, y0, ax, ay, bx, by),
        squared_distance_to_segment(x1, y1, ax, ay, bx, by),
    )
    second_ends_squared = np.minimum(
        squared_distance_to_segment(ax, ay, x0, y0, x1, y1),
        squared_distance_to_segment(bx, by, x0, y0, x1, y1),
    )
    are_apart = np.logical_not(segments_meet(x0, y0, x1, y1, ax, ay, bx, by))
    return np.minimum(first_ends_squared, second_ends_squared) * are_apart


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
    return ((ay > y) != (by > y)) & ((signed_double_area(ax, ay, bx, by, x, y) > 0) == (by > ay))
