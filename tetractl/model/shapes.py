"""The kinds of obstacles in a spec: rectangles, circles and polygons.

Each kind is a section of the spec, a `ShapeSection`. Its method `shape()` returns the `Shape` that
is used for all computations. To add a kind, write another such class and name it in
`core.registries`.
"""

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tetractl.core.poses import Floats
from tetractl.core.shape import Shape, segments_meet, signed_double_area
from tetractl.spec.base import Finite, Point, Positive, inconsistent
from tetractl.spec.experiment import ShapeSection


class Rectangle(ShapeSection):
    """An axis-aligned rectangle, defined as in the paper by left, bottom, width and height."""

    type: Literal["rectangle"]
    left: Finite
    """x of the left edge [length unit]."""
    bottom: Finite
    """y of the lower edge [length unit]."""
    width: Positive
    """Extent in x [length unit]."""
    height: Positive
    """Extent in y [length unit]."""

    def shape(self) -> Shape:
        """Return the rectangle as a polygon with four corners, anticlockwise."""
        right = self.left + self.width
        top = self.bottom + self.height
        corners = [(self.left, self.bottom), (right, self.bottom), (right, top), (self.left, top)]
        return Shape(np.array(corners))


class Circle(ShapeSection):
    """A round obstacle, given by its centre and radius."""

    type: Literal["circle"]
    center: Point
    """Coordinates of the centre, [x, y] [length unit]."""
    radius: Positive
    """Radius [length unit]."""

    def shape(self) -> Shape:
        """Return the circle as a polygon with one corner, its centre, and a radius."""
        return Shape(np.array([self.center], dtype=np.float64), self.radius)


class Polygon(ShapeSection):
    """A polygon with edges that do not cross each other. It may be concave."""

    type: Literal["polygon"]
    vertices: tuple[Point, ...] = Field(min_length=3, max_length=200)
    """Corners [x, y] in order around the polygon, clockwise or anticlockwise [length unit].

    An edge joins the last corner to the first.
    """

    @model_validator(mode="after")
    def _is_simple(self) -> Self:
        """Reject a polygon with repeated corners, with edges that meet, or without an area."""
        n_corners = len(self.vertices)
        edges = [(*self.vertices[i - 1], *self.vertices[i]) for i in range(n_corners)]
        edge_columns = np.array(edges).T
        for i, (ax, ay, bx, by) in enumerate(edges):
            if (ax, ay) == (bx, by):
                message = (
                    f"has the corner {_format_point(self.vertices[i])} twice in a row; "
                    "remove one of them"
                )
                raise inconsistent("vertices", message)
        for i, (ax, ay, bx, by) in enumerate(edges):
            cx, cy = self.vertices[(i + 1) % n_corners]
            turns_back = (bx - ax) * (cx - bx) + (by - ay) * (cy - by) < 0
            if turns_back and signed_double_area(ax, ay, bx, by, cx, cy) == 0:
                message = (
                    f"turns back on itself at {_format_point(self.vertices[i])}; the shape "
                    "must have an area"
                )
                raise inconsistent("vertices", message)
            # compare with the edges after the next edge; the last edge is a neighbour of the first
            end_edge = n_corners - 1 if i == 0 else n_corners
            with np.errstate(all="ignore"):
                crossed_edges = np.flatnonzero(
                    segments_meet(ax, ay, bx, by, *edge_columns[:, i + 2 : end_edge])
                )
            if crossed_edges.size:
                message = (
                    "crosses or touches itself: the edge that ends in "
                    f"{_format_point(self.vertices[i])} meets the edge that ends in "
                    f"{_format_point(self.vertices[i + 2 + crossed_edges[0]])}; "
                    "list the corners in order around the polygon"
                )
                raise inconsistent("vertices", message)
        if not 0 < abs(_doubled_area(np.array(self.vertices))) < np.inf:
            raise inconsistent(
                "vertices",
                "has an area that is too large or too small to compute; use another length unit",
            )
        return self

    def shape(self) -> Shape:
        """Return the polygon with its corners in anticlockwise order."""
        vertices = np.array(self.vertices, dtype=np.float64)
        return Shape(vertices if _doubled_area(vertices) > 0 else vertices[::-1])


def _doubled_area(vertices: Floats) -> float:
    """Compute twice the area of a polygon (M, 2), positive if its corners are anticlockwise."""
    x, y = (vertices - vertices[0]).T
    with np.errstate(over="ignore", invalid="ignore"):  # the caller rejects non-finite areas
        x_next = np.roll(x, -1)
        y_next = np.roll(y, -1)
        return float(np.sum(x * y_next - x_next * y))


def _format_point(point: Point) -> str:
    """Format the coordinates of a point for a message."""
    return f"[{point[0]:g}, {point[1]:g}]"
