"""The obstacle region O of (13): a union of shapes, and what lies outside the walls of an arena."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape

OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])
"""Sign of the way out through the left, bottom, right and top wall of an arena."""


@dataclass(frozen=True, eq=False)
class Obstacles:
    """A union of O obstacles, edges included: shapes, then the left, bottom, right and top wall.

    Obstacles are numbers, which the kernels read: `rows` (M, 6 + 2 K), padded with zeros, has for
    each shape its radius, number of corners, left, bottom, right and top, then x, y of each corner;
    `walls` (4,) are left, bottom, right and top of the region between the walls, or (0,) for none;
    `boxes` (M, 4) the sides of each polygon without its radius. Lengths in the spec's unit.
    """

    rows: Floats
    walls: Floats
    boxes: Floats

    @classmethod
    def of(
        cls, shapes: Sequence[Shape] = (), margin: float = 0.0, walls: Bounds | None = None
    ) -> Self:
        """Return the union of shapes and of the walls of an arena, all grown by a margin."""
        corners_max = max((len(shape.corners) for shape in shapes), default=0)
        rows = np.zeros((len(shapes), 6 + 2 * corners_max))
        boxes = np.zeros((len(shapes), 4))
        for i, shape in enumerate(shapes):
            rows[i, 0] = shape.radius
            rows[i, 1] = len(shape.corners)
            rows[i, 6 : 6 + shape.corners.size] = shape.corners.ravel()
            boxes[i] = replace(shape, radius=0.0).box
        edges = () if walls is None else astuple(walls)
        bare = cls(rows, np.array(edges, dtype=np.float64), boxes)
        return bare.grown(np.full(bare.count, margin))

    @property
    def count(self) -> int:
        """The number O of obstacles; each wall counts."""
        return len(self.rows) + self.walls.size

    def grown(self, margins: Floats) -> Self:
        """Return the obstacles, each grown by its own margin, (O,)."""
        rows = self.rows.copy()
        walls = self.walls
        rows[:, 0] += margins[: len(rows)]
        rows[:, 2:6] = self.boxes + OUTWARD * rows[:, :1]
        if walls.size:
            walls = walls - OUTWARD * margins[-4:]
        return type(self)(rows, walls, self.boxes)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes, as the readable functions below use them."""
        corners = [row[6 : 6 + 2 * int(row[1])].reshape(-1, 2) for row in self.rows]
        radii = self.rows[:, 0]
        return tuple(Shape(*shape) for shape in zip(corners, radii, strict=True))

    @property
    def inside(self) -> Bounds | None:
        """The region between the walls, None for no walls."""
        return Bounds(*self.walls.tolist()) if self.walls.size else None

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Return the distance of each point to each obstacle (O, ...), negative inside."""
        x, y = np.broadcast_arrays(x, y)
        distances = [shape.distance(x, y) for shape in self.shapes]
        arena = self.inside
        if arena is not None:
            distances += [x - arena.left, y - arena.bottom, arena.right - x, arena.top - y]
        return np.stack(distances) if distances else np.empty((0, *x.shape))

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Return whether each point is in an obstacle, p(s) of (13); x, y broadcast."""
        return self.distance(x, y) <= 0

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Return whether each straight segment from (x0, y0) to (x1, y1) touches an obstacle."""
        touched = np.zeros(np.broadcast(x0, y0, x1, y1).shape, dtype=np.bool_)
        for shape in self.shapes:
            touched |= shape.cross(x0, y0, x1, y1)
        arena = self.inside
        if arena is not None:
            touched |= (arena.inside(x0, y0) <= 0) | (arena.inside(x1, y1) <= 0)
        return touched

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance to the nearest obstacle, negative inside; inf if there is none."""
        return self.distances(x, y).min(axis=0, initial=np.inf)

    def at_least(self, x: Floats, y: Floats) -> Floats:
        """Return a lower bound of `distance`, or of 0 inside, that is quick to compute: the
        distance to the nearest box of a shape, or wall; inf if there is no obstacle."""
        least_squared = np.full(x.shape, np.inf)
        for left, bottom, right, top in self.rows[:, 2:6].tolist():
            east = np.maximum(np.maximum(left - x, x - right), 0.0)
            north = np.maximum(np.maximum(bottom - y, y - top), 0.0)
            least_squared = np.minimum(least_squared, east * east + north * north)
        least = np.sqrt(least_squared)
        return least if self.inside is None else np.minimum(least, self.inside.inside(x, y))
