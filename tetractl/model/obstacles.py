"""The obstacle region O of (13): a union of shapes, and what lies outside the walls of an arena."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Self

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape

OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])
"""Sign of the way out through the left, bottom, right and top wall of an arena."""


@dataclass(frozen=True)
class Obstacles:
    """A union of O obstacles, edges included: shapes, then the left, bottom, right and top wall.

    `inside` is the region between the walls, None for no walls. Lengths in the spec's unit.
    """

    shapes: tuple[Shape, ...]
    inside: Bounds | None = None

    @classmethod
    def of(cls, shapes: Sequence[Shape], margin: float = 0.0, walls: Bounds | None = None) -> Self:
        """Return the union of shapes and of the walls of an arena, all grown by a margin."""
        bare = cls(tuple(shapes), walls)
        return bare.grown(np.full(bare.count, margin)) if margin else bare

    @property
    def count(self) -> int:
        """The number O of obstacles; each wall counts."""
        return len(self.shapes) + self.walls.size

    def grown(self, margins: Floats) -> Self:
        """Return the obstacles, each grown by its own margin, (O,)."""
        shapes = zip(self.shapes, margins.tolist(), strict=False)
        inside = self.inside and Bounds(*(self.walls - OUTWARD * margins[-4:]).tolist())
        return type(self)(tuple(shape.grown(margin) for shape, margin in shapes), inside)

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Return the distance of each point to each obstacle (O, ...), negative inside."""
        x, y = np.broadcast_arrays(x, y)
        found = [shape.distance(x, y) for shape in self.shapes]
        if (at := self.inside) is not None:
            found += [x - at.left, y - at.bottom, at.right - x, at.top - y]
        return np.stack(found) if found else np.empty((0, *x.shape))

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point is in an obstacle, p(s) of (13); x, y broadcast."""
        return self.distance(x, y) <= 0

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether each straight segment from (x0, y0) to (x1, y1) touches an obstacle."""
        touched = np.zeros(np.broadcast(x0, y0, x1, y1).shape, dtype=np.bool_)
        for shape in self.shapes:
            touched |= shape.cross(x0, y0, x1, y1)
        if self.inside is not None:
            touched |= (self.inside.inside(x0, y0) <= 0) | (self.inside.inside(x1, y1) <= 0)
        return touched

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance to the nearest obstacle, negative inside; inf if there is none."""
        return self.distances(x, y).min(axis=0, initial=np.inf)

    @cached_property
    def walls(self) -> Floats:
        """Left, bottom, right and top of the region between the walls (4,), or (0,) for none."""
        return np.array([] if self.inside is None else astuple(self.inside), dtype=np.float64)

    @cached_property
    def rows(self) -> Floats:
        """The shapes for the kernels, (M, 6 + 2 K) padded with zeros: radius, number of corners,
        left, bottom, right and top of the shape, then x, y of each corner."""
        most = max((len(shape.corners) for shape in self.shapes), default=0)
        table = np.zeros((len(self.shapes), 6 + 2 * most))
        for row, shape in zip(table, self.shapes, strict=True):
            row[:6] = shape.radius, len(shape.corners), *shape.box
            row[6 : 6 + shape.corners.size] = shape.corners.ravel()
        return table
