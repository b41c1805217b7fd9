"""The obstacle region O of (13): a union of shapes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Bounds, Shape
from tetractl.model.shapes.circle import PackedCircles
from tetractl.model.shapes.half_plane import HalfPlane
from tetractl.model.shapes.rectangle import PackedRectangles


@dataclass(frozen=True)
class Obstacles:
    """A union of shapes, edges included. Lengths in the spec's unit."""

    shapes: tuple[Shape, ...]

    @classmethod
    def of(cls, shapes: Sequence[Shape], margin: float = 0.0, walls: Bounds | None = None) -> Self:
        """Return the union of shapes, each grown by `margin` [length unit].

        With `walls`, the union includes everything outside that arena, as four half-planes.
        """
        every = [*shapes, *(_walls(walls) if walls else ())]
        return cls(tuple(shape.grown(margin) for shape in every))

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point is in an obstacle, p(s) of (13); x, y broadcast."""
        inside = np.zeros(np.broadcast(x, y).shape, dtype=np.bool_)
        for shape in self.shapes:
            inside |= shape.contain(x, y)
        return inside

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether each straight segment from (x0, y0) to (x1, y1) touches an obstacle."""
        touched = np.zeros(np.broadcast(x0, y0, x1, y1).shape, dtype=np.bool_)
        for shape in self.shapes:
            touched |= shape.cross(x0, y0, x1, y1)
        return touched

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance to the nearest obstacle, negative inside; inf if there is none."""
        nearest = np.full(np.broadcast(x, y).shape, np.inf)
        for shape in self.shapes:
            nearest = np.minimum(nearest, shape.distance(x, y))
        return nearest

    def packed(self) -> tuple[Any, ...]:
        """Return the shapes for the kernels, one `PackedShapes` per kind.

        Rectangles and circles are always included, even if there are none, so that most experiments
        share one compiled kernel, and those with walls another one. Every call returns the same
        arrays, which must not be changed.
        """
        return self._packed

    @cached_property
    def _packed(self) -> tuple[Any, ...]:
        rows: dict[type[Any], list[tuple[float, ...]]] = {PackedRectangles: [], PackedCircles: []}
        for shape in self.shapes:
            rows.setdefault(shape.packed, []).append(shape.row())
        return tuple(kind(_table(kind.size or 0, found)) for kind, found in rows.items())


def _table(width: int, rows: list[tuple[float, ...]]) -> Floats:
    """Return rows as an array, padded with zeros at the end to the longest."""
    table = np.zeros((len(rows), max(map(len, rows), default=width)))
    for i, row in enumerate(rows):
        table[i, : len(row)] = row
    return table


def _walls(arena: Bounds) -> list[HalfPlane]:
    """Return the half-plane beyond each side of an arena."""
    return [
        HalfPlane((1.0, 0.0), arena.left),
        HalfPlane((-1.0, 0.0), -arena.right),
        HalfPlane((0.0, 1.0), arena.bottom),
        HalfPlane((0.0, -1.0), -arena.top),
    ]
