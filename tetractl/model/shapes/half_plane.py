"""Half-planes, which describe the outside of an arena's walls; they have no section in a spec."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from tetractl.core.poses import Bools, Floats


class PackedHalfPlanes(NamedTuple):
    """Half-planes in the form used by kernels; see `tetractl.model.shapes.shape.PackedShapes`."""

    rows: Floats  # (M, 3): the normal's x and y, and the edge's offset along it
    size = 3

    @staticmethod
    def gap(x: float, y: float, p: Any) -> float:
        """Return the distance to the edge, negative beyond it."""
        nx, ny, offset = p
        return nx * x + ny * y - offset

    @staticmethod
    def gap_between(x0: float, y0: float, x1: float, y1: float, p: Any) -> float:
        """Return the smaller of the gaps at the segment's two ends."""
        nx, ny, offset = p
        return min(nx * x0 + ny * y0, nx * x1 + ny * y1) - offset

    @staticmethod
    def depth(x: float, y: float, p: Any) -> float:
        """Return the distance beyond the edge."""
        nx, ny, offset = p
        return offset - (nx * x + ny * y)

    @staticmethod
    def outward(x: float, y: float, p: Any) -> tuple[float, float]:
        """Return the normal."""
        return p[0], p[1]


@dataclass(frozen=True)
class HalfPlane:
    """The points (x, y) with n . (x, y) <= offset, where n is the outward unit normal."""

    normal: tuple[float, float]
    offset: float
    """Offset of the edge along the normal [length unit]."""

    type: ClassVar[str] = "half-plane"
    packed: ClassVar[Any] = PackedHalfPlanes

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point lies at the edge or beyond."""
        return self.distance(x, y) <= 0

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether either end of each segment lies at the edge or beyond."""
        return self.contain(x0, y0) | self.contain(x1, y1)

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance to the edge, negative beyond it."""
        return self.normal[0] * x + self.normal[1] * y - self.offset

    def grown(self, margin: float) -> "HalfPlane":
        """Return the half-plane with its edge moved out."""
        return replace(self, offset=self.offset + margin)

    def outline(self) -> Floats:
        """Return no corners (0, 2): a half-plane is not drawn."""
        return np.empty((0, 2))

    def row(self) -> tuple[float, float, float]:
        """Return the normal and the offset."""
        return *self.normal, self.offset
