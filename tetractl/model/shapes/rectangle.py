"""Axis-aligned rectangles."""

from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.experiment.base import Finite, Positive
from tetractl.experiment.shape_section import ShapeSection


class PackedRectangles(NamedTuple):
    """Rectangles in the form used by kernels; see `tetractl.model.shapes.shape.PackedShapes`."""

    rows: Floats  # (M, 4): left, bottom, right, top
    size = 4

    @staticmethod
    def gap(x: float, y: float, p: Any) -> float:
        """Return the largest signed distance beyond a side, along the side's normal."""
        left, bottom, right, top = p
        return max(max(left - x, x - right), max(bottom - y, y - top))

    @staticmethod
    def gap_between(x0: float, y0: float, x1: float, y1: float, p: Any) -> float:
        """Return the largest gap along one of three axes: x, y and the segment's normal."""
        left, bottom, right, top = p
        hx, hy, dx, dy = (right - left) / 2.0, (top - bottom) / 2.0, x1 - x0, y1 - y0
        mx, my = x0 + dx / 2.0 - (left + right) / 2.0, y0 + dy / 2.0 - (bottom + top) / 2.0
        beside = max(abs(mx) - (hx + abs(dx) / 2.0), abs(my) - (hy + abs(dy) / 2.0))
        return max(beside, abs(dx * my - dy * mx) - (hx * abs(dy) + hy * abs(dx)))

    @staticmethod
    def depth(x: float, y: float, p: Any) -> float:
        """Return the distance to the nearest side, positive inside."""
        left, bottom, right, top = p
        return -max(max(left - x, x - right), max(bottom - y, y - top))

    @staticmethod
    def outward(x: float, y: float, p: Any) -> tuple[float, float]:
        """Return the normal of the nearest side."""
        left, bottom, right, top = p
        if max(left - x, x - right) > max(bottom - y, y - top):
            return (-1.0 if left - x > x - right else 1.0), 0.0
        return 0.0, (-1.0 if bottom - y > y - top else 1.0)


class Rectangle(ShapeSection):
    """An axis-aligned rectangle, defined as in the paper by left, bottom, width and height."""

    type: Literal["rectangle"]
    left: Finite
    """Least x [length unit]."""
    bottom: Finite
    """Least y [length unit]."""
    width: Positive
    """Extent in x [length unit]."""
    height: Positive
    """Extent in y [length unit]."""

    packed: ClassVar[Any] = PackedRectangles

    def row(self) -> tuple[float, float, float, float]:
        """Return left, bottom, right and top after growth, which keeps corners sharp."""
        left, bottom, margin = self.left, self.bottom, self.margin  # attribute access is slow
        right, top = left + self.width, bottom + self.height
        return left - margin, bottom - margin, right + margin, top + margin

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point lies between the sides."""
        left, bottom, right, top = self.row()
        return (left <= x) & (x <= right) & (bottom <= y) & (y <= top)

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether no axis (x, y or the segment's normal) separates segment and box."""
        left, bottom, right, top = self.row()
        dx, dy = x1 - x0, y1 - y0
        center_x, center_y = (left + right) / 2, (bottom + top) / 2
        half_x, half_y = (right - left) / 2, (top - bottom) / 2
        mid_x, mid_y = x0 + dx / 2 - center_x, y0 + dy / 2 - center_y
        across = np.abs(dx * mid_y - dy * mid_x) <= half_x * np.abs(dy) + half_y * np.abs(dx)
        overlap_x = np.abs(mid_x) <= half_x + np.abs(dx) / 2
        return overlap_x & (np.abs(mid_y) <= half_y + np.abs(dy) / 2) & across

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the signed distance to the nearest side or corner."""
        left, bottom, right, top = self.row()
        gap_x = np.maximum(left - x, x - right)
        gap_y = np.maximum(bottom - y, y - top)
        outside = np.hypot(np.maximum(gap_x, 0.0), np.maximum(gap_y, 0.0))
        return outside + np.minimum(np.maximum(gap_x, gap_y), 0.0)

    def outline(self) -> Floats:
        """Return the four corners."""
        right, top = self.left + self.width, self.bottom + self.height
        corners = [(self.left, self.bottom), (right, self.bottom), (right, top), (self.left, top)]
        return np.array(corners)
