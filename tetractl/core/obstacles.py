"""The region that robots must not enter: obstacles, and everything outside the arena's walls.

    obstacles = Obstacles.from_shapes(setup.obstacles, margin=40.0, walls=setup.arena)
    obstacles.distance(x, y)  # of each point to the nearest obstacle, negative inside

It is the region O in the paper's equation (13). `Obstacles` stores all shapes in a few arrays,
which compiled kernels read: see `tetractl.control.search.kernels.obstacles`. The geometry of both
is in `tetractl.core.shape`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from tetractl.core.poses import Bools, Floats, Integers
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape

# the entries of `Obstacles.walls`
LEFT = 0
"""Minimum x of the region between the walls [length unit]."""
BOTTOM = 1
"""Minimum y of the region between the walls [length unit]."""
RIGHT = 2
"""Maximum x of the region between the walls [length unit]."""
TOP = 3
"""Maximum y of the region between the walls [length unit]."""


@dataclass(frozen=True, eq=False)
class Obstacles:
    """A union of O obstacles, including their edges.

    The first M are shapes, followed by the left, bottom, right and top wall if there are walls.

    A shape is every point within a radius of a polygon, see `Shape`. Lengths in the spec's unit.
    """

    corners: Floats
    """x, y of the corners of each polygon, (M, K, 2), padded with zeros."""
    corner_counts: Integers
    """Number of corners of each polygon, (M,)."""
    radii: Floats
    """Radius of each shape, by which its polygon is enlarged [length unit], shape (M,)."""
    low: Floats
    """Minimum x, y of the corners of each polygon, (M, 2)."""
    high: Floats
    """Maximum x, y of the corners of each polygon, (M, 2)."""
    walls: Floats
    """The walls at LEFT, BOTTOM, RIGHT and TOP, shape (4,). Shape (0,) if there are no walls."""

    @classmethod
    def from_shapes(
        cls, shapes: Sequence[Shape] = (), margin: float = 0.0, walls: Bounds | None = None
    ) -> Self:
        """Combine shapes and the walls of an arena, all enlarged on every side by a margin.

        Args:
            shapes: The obstacles.
            margin: How far to grow each shape and wall [length unit].
            walls: The arena. None if its walls are no obstacles.
        """
        corners_max = max((len(shape.corners) for shape in shapes), default=0)
        corners = np.zeros((len(shapes), corners_max, 2))
        low = np.zeros((len(shapes), 2))
        high = np.zeros((len(shapes), 2))
        for i, shape in enumerate(shapes):
            corners[i, : len(shape.corners)] = shape.corners
            low[i] = shape.corners.min(axis=0)
            high[i] = shape.corners.max(axis=0)
        sides = () if walls is None else (walls.left, walls.bottom, walls.right, walls.top)
        bare = cls(
            corners=corners,
            corner_counts=np.array([len(shape.corners) for shape in shapes], dtype=np.int64),
            radii=np.array([shape.radius for shape in shapes], dtype=np.float64),
            low=low,
            high=high,
            walls=np.array(sides, dtype=np.float64),
        )
        return bare.grown(np.full(bare.count, margin))

    @property
    def count(self) -> int:
        """The number O of obstacles.

        Each of the four walls counts as one, if there are walls.
        """
        return len(self.radii) + self.walls.size

    def grown(self, margins: Floats) -> Self:
        """Return the obstacles, each grown on all sides by its own margin.

        Args:
            margins: The margin of each shape and wall [length unit], shape (O,).
        """
        shapes = len(self.radii)
        walls = self.walls.copy()
        if walls.size:
            of_walls = margins[shapes:]
            walls[LEFT] += of_walls[LEFT]
            walls[BOTTOM] += of_walls[BOTTOM]
            walls[RIGHT] -= of_walls[RIGHT]
            walls[TOP] -= of_walls[TOP]
        return replace(self, radii=self.radii + margins[:shapes], walls=walls)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes as objects, which the readable functions below use."""
        outlines = zip(self.corners, self.corner_counts, self.radii, strict=True)
        return tuple(Shape(corners[:count], radius) for corners, count, radius in outlines)

    @property
    def inside(self) -> Bounds | None:
        """The region between the walls. None if there are no walls."""
        if not self.walls.size:
            return None
        left, bottom, right, top = self.walls.tolist()
        return Bounds(left=left, bottom=bottom, right=right, top=top)

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Compute the distance of each point to each obstacle and wall, shape (O, ...).

        It is negative inside an obstacle and beyond a wall. The arrays x and y broadcast.
        """
        x, y = np.broadcast_arrays(x, y)
        distances = [shape.distance(x, y) for shape in self.shapes]
        arena = self.inside
        if arena is not None:
            distances += [x - arena.left, y - arena.bottom, arena.right - x, arena.top - y]
        return np.stack(distances) if distances else np.empty((0, *x.shape))

    def contain(self, x: Floats, y: Floats) -> Bools:
        """Check which points are in an obstacle, on its edge, or not between the walls.

        This is p(s) of the paper's equation (13). The arrays x and y broadcast.
        """
        return self.distance(x, y) <= 0

    def cross(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Check which straight segments touch any obstacle or wall.

        Args:
            x0: x of the start of each segment.
            y0: y of the start of each segment.
            x1: x of the end of each segment.
            y1: y of the end of each segment.
        """
        touched = np.zeros(np.broadcast(x0, y0, x1, y1).shape, dtype=np.bool_)
        for shape in self.shapes:
            touched |= shape.cross(x0, y0, x1, y1)
        arena = self.inside
        if arena is not None:
            touched |= (arena.inside(x0, y0) <= 0) | (arena.inside(x1, y1) <= 0)
        return touched

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Compute the distance of each point to the nearest obstacle or wall [length unit].

        It is negative inside an obstacle or beyond a wall, and inf if there is none.
        """
        return self.distances(x, y).min(axis=0, initial=np.inf)

    def at_least(self, x: Floats, y: Floats) -> Floats:
        """Compute a quick lower bound of `distance`, for arrays x and y of equal shape.

        It is the distance to the nearest wall or bounding box of a shape: 0 inside a box, negative
        beyond a wall, and inf if there is no obstacle.
        """
        least_squared = np.full(x.shape, np.inf)
        lows = (self.low - self.radii[:, None]).tolist()
        highs = (self.high + self.radii[:, None]).tolist()
        for (left, bottom), (right, top) in zip(lows, highs, strict=True):
            east = np.maximum(np.maximum(left - x, x - right), 0.0)
            north = np.maximum(np.maximum(bottom - y, y - top), 0.0)
            least_squared = np.minimum(least_squared, east * east + north * north)
        least = np.sqrt(least_squared)
        return least if self.inside is None else np.minimum(least, self.inside.inside(x, y))
