"""The obstacles: point test (13), swept test, and distance, for rectangles and circles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats
from tetractl.core.setup import Bounds, Shape
from tetractl.experiment.experiment import Circle, Rectangle

Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Obstacles:
    """The obstacle region O of (13), a union of rectangles and circles.

    `rectangles` (R, 4) holds left, bottom, right, top; `circles` (C, 3) holds x, y, radius; both
    in the spec's length unit. Edges belong to the obstacle.
    """

    rectangles: Floats
    circles: Floats

    @classmethod
    def of(
        cls,
        obstacles: Sequence[Shape],
        margin: float = 0.0,
        walls: Bounds | None = None,
    ) -> Self:
        """Take obstacles from a spec, each side and radius grown by `margin` [length unit].

        With `walls`, everything outside that arena belongs to O too, as four broad rectangles.
        """
        rectangles = [
            (
                o.left - margin,
                o.bottom - margin,
                o.left + o.width + margin,
                o.bottom + o.height + margin,
            )
            for o in obstacles
            if isinstance(o, Rectangle)
        ]
        circles = [(*o.center, o.radius + margin) for o in obstacles if isinstance(o, Circle)]
        if walls is not None:
            rectangles += _walls(walls, margin)
        return cls(
            np.array(rectangles, dtype=np.float64).reshape(-1, 4),
            np.array(circles, dtype=np.float64).reshape(-1, 3),
        )

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Whether each point is in an obstacle, p(s) of (13); x, y broadcast to the result."""
        inside = np.zeros(np.broadcast(x, y).shape, dtype=np.bool_)
        for left, bottom, right, top in self.rectangles:
            inside |= (left <= x) & (x <= right) & (bottom <= y) & (y <= top)
        for cx, cy, radius in self.circles:
            inside |= (x - cx) ** 2 + (y - cy) ** 2 <= radius**2
        return inside

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Whether each straight segment from (x0, y0) to (x1, y1) touches an obstacle."""
        dx, dy = x1 - x0, y1 - y0
        touched = np.zeros(np.broadcast(x0, y0, x1, y1).shape, dtype=np.bool_)
        for left, bottom, right, top in self.rectangles:
            touched |= _crosses_rectangle(x0, y0, dx, dy, left, bottom, right, top)
        for cx, cy, radius in self.circles:
            length2 = dx * dx + dy * dy
            along = (cx - x0) * dx + (cy - y0) * dy
            nearest = np.clip(along / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
            gap2 = (x0 + nearest * dx - cx) ** 2 + (y0 + nearest * dy - cy) ** 2
            touched |= gap2 <= radius**2
        return touched

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Distance to the nearest obstacle [length unit], negative inside; inf if there is none."""
        nearest = np.full(np.broadcast(x, y).shape, np.inf)
        for left, bottom, right, top in self.rectangles:
            gap_x = np.maximum(left - x, x - right)
            gap_y = np.maximum(bottom - y, y - top)
            outside = np.hypot(np.maximum(gap_x, 0.0), np.maximum(gap_y, 0.0))
            nearest = np.minimum(nearest, outside + np.minimum(np.maximum(gap_x, gap_y), 0.0))
        for cx, cy, radius in self.circles:
            nearest = np.minimum(nearest, np.hypot(x - cx, y - cy) - radius)
        return nearest


def _crosses_rectangle(
    x0: Floats,
    y0: Floats,
    dx: Floats,
    dy: Floats,
    left: float,
    bottom: float,
    right: float,
    top: float,
) -> Bools:
    """Segment against rectangle by the separating axis theorem: two box axes and the normal."""
    center_x, center_y = (left + right) / 2, (bottom + top) / 2
    half_x, half_y = (right - left) / 2, (top - bottom) / 2
    mid_x, mid_y = x0 + dx / 2 - center_x, y0 + dy / 2 - center_y
    across = np.abs(dx * mid_y - dy * mid_x) <= half_x * np.abs(dy) + half_y * np.abs(dx)
    overlap_x = np.abs(mid_x) <= half_x + np.abs(dx) / 2
    return overlap_x & (np.abs(mid_y) <= half_y + np.abs(dy) / 2) & across


def _walls(arena: Bounds, margin: float) -> list[tuple[float, float, float, float]]:
    """Four rectangles round an arena, as broad as three arenas: no robot crosses them in a step."""
    broad = 3 * max(arena.width, arena.height)
    left, bottom = arena.left + margin, arena.bottom + margin
    right, top = arena.right - margin, arena.top - margin
    return [
        (left - broad, bottom - broad, left, top + broad),
        (right, bottom - broad, right + broad, top + broad),
        (left - broad, bottom - broad, right + broad, bottom),
        (left - broad, top, right + broad, top + broad),
    ]
