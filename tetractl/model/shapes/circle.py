"""Circular obstacles."""

import math
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.experiment.base import Point, Positive
from tetractl.experiment.shape_section import ShapeSection

CORNERS = 64  # number of corners of the polygon that draws a disc


class PackedCircles(NamedTuple):
    """Discs in the form used by kernels; see `tetractl.model.shapes.shape.PackedShapes`."""

    rows: Floats  # (M, 3): centre x, y, radius
    size = 3

    @staticmethod
    def gap(x: float, y: float, p: Any) -> float:
        """Return the squared distance to the centre over the squared radius."""
        cx, cy, radius = p
        dx, dy = x - cx, y - cy
        return dx * dx + dy * dy - radius * radius

    @staticmethod
    def gap_between(x0: float, y0: float, x1: float, y1: float, p: Any) -> float:
        """Return the gap at the segment's point nearest to the centre."""
        cx, cy, radius = p
        dx, dy = x1 - x0, y1 - y0
        length2 = dx * dx + dy * dy
        along = (cx - x0) * dx + (cy - y0) * dy
        nearest = max(0.0, min(along / (length2 if length2 > 0 else 1.0), 1.0))
        gx, gy = x0 + nearest * dx - cx, y0 + nearest * dy - cy
        return gx * gx + gy * gy - radius * radius

    @staticmethod
    def depth(x: float, y: float, p: Any) -> float:
        """Return the radius minus the distance to the centre."""
        cx, cy, radius = p
        dx, dy = x - cx, y - cy
        return radius - math.sqrt(dx * dx + dy * dy)

    @staticmethod
    def outward(x: float, y: float, p: Any) -> tuple[float, float]:
        """Return the direction away from the centre; at the centre itself, the +x direction."""
        dx, dy = x - p[0], y - p[1]
        away = math.sqrt(dx * dx + dy * dy)
        if away < 1e-300:
            return 1.0, 0.0
        return dx / away, dy / away


class Circle(ShapeSection):
    """A round obstacle."""

    type: Literal["circle"]
    center: Point
    """Centre [x, y]."""
    radius: Positive
    """Radius [length unit]."""

    packed: ClassVar[Any] = PackedCircles

    def row(self) -> tuple[float, float, float]:
        """Return centre x, y and the radius with its margin."""
        return *self.center, self.radius + self.margin

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point is within the radius of the centre."""
        cx, cy, radius = self.row()
        return (x - cx) ** 2 + (y - cy) ** 2 <= radius**2

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether the point of each segment nearest to the centre is within the radius."""
        cx, cy, radius = self.row()
        dx, dy = x1 - x0, y1 - y0
        length2 = dx * dx + dy * dy
        along = (cx - x0) * dx + (cy - y0) * dy
        nearest = np.clip(along / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
        gap2 = (x0 + nearest * dx - cx) ** 2 + (y0 + nearest * dy - cy) ** 2
        return gap2 <= radius**2

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance to the centre minus the radius."""
        cx, cy, radius = self.row()
        return np.hypot(x - cx, y - cy) - radius

    def outline(self) -> Floats:
        """Return the corners of a regular polygon whose corners are on the circle."""
        angle = np.linspace(0.0, 2 * np.pi, CORNERS, endpoint=False)
        return self.center + self.radius * np.column_stack([np.cos(angle), np.sin(angle)])
