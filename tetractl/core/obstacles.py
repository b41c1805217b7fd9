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
    """The union of O obstacles, including their edges.

    The first M obstacles are shapes. If there are walls, the left, bottom, right and top wall
    follow. A shape consists of all points within a radius of a polygon; see `Shape`. Lengths are in
    the spec's unit.
    """

    corners: Floats
    """x, y of the corners of each polygon, shape (M, K, 2), padded with zeros."""
    corner_counts: Integers
    """Number of corners of each polygon, shape (M,)."""
    radii: Floats
    """Radius of each shape, by which its polygon is enlarged [length unit], shape (M,)."""
    corners_min: Floats
    """Minimum x, y of the corners of each polygon, shape (M, 2)."""
    corners_max: Floats
    """Maximum x, y of the corners of each polygon, shape (M, 2)."""
    walls: Floats
    """Positions of the walls in the order LEFT, BOTTOM, RIGHT, TOP, shape (4,).

    The shape is (0,) if there are no walls.
    """

    @classmethod
    def from_shapes(
        cls, shapes: Sequence[Shape] = (), margin: float = 0.0, walls: Bounds | None = None
    ) -> Self:
        """Combine shapes and the walls of an arena, all enlarged on every side by a margin.

        Args:
            shapes: The obstacles.
            margin: How far to grow each shape and wall [length unit].
            walls: Bounds of the arena. None if its walls are no obstacles.
        """
        corner_count_max = max((len(shape.corners) for shape in shapes), default=0)
        corners = np.zeros((len(shapes), corner_count_max, 2))
        corners_min = np.zeros((len(shapes), 2))
        corners_max = np.zeros((len(shapes), 2))
        for i, shape in enumerate(shapes):
            corners[i, : len(shape.corners)] = shape.corners
            corners_min[i] = shape.corners.min(axis=0)
            corners_max[i] = shape.corners.max(axis=0)
        wall_positions = () if walls is None else (walls.left, walls.bottom, walls.right, walls.top)
        ungrown = cls(
            corners=corners,
            corner_counts=np.array([len(shape.corners) for shape in shapes], dtype=np.int64),
            radii=np.array([shape.radius for shape in shapes], dtype=np.float64),
            corners_min=corners_min,
            corners_max=corners_max,
            walls=np.array(wall_positions, dtype=np.float64),
        )
        return ungrown.grown(np.full(ungrown.count, margin))

    @property
    def count(self) -> int:
        """The number O of obstacles. If there are walls, they count as four obstacles."""
        return len(self.radii) + self.walls.size

    def grown(self, margins: Floats) -> Self:
        """Return a copy of the obstacles, each grown on all sides by its own margin.

        Args:
            margins: The margin of each shape and wall [length unit], shape (O,).
        """
        shape_count = len(self.radii)
        walls = self.walls.copy()
        if walls.size:
            wall_margins = margins[shape_count:]
            walls[LEFT] += wall_margins[LEFT]
            walls[BOTTOM] += wall_margins[BOTTOM]
            walls[RIGHT] -= wall_margins[RIGHT]
            walls[TOP] -= wall_margins[TOP]
        return replace(self, radii=self.radii + margins[:shape_count], walls=walls)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """The obstacles other than walls, as `Shape` objects."""
        outlines = zip(self.corners, self.corner_counts, self.radii, strict=True)
        return tuple(Shape(corners[:count], radius) for corners, count, radius in outlines)

    @property
    def inner_bounds(self) -> Bounds | None:
        """The rectangle between the walls. None if there are no walls."""
        if not self.walls.size:
            return None
        left, bottom, right, top = self.walls.tolist()
        return Bounds(left=left, bottom=bottom, right=right, top=top)

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Compute the distance of each point to each obstacle and wall, shape (O, ...).

        The distance is negative inside an obstacle and beyond a wall. The arrays x and y broadcast.
        """
        x, y = np.broadcast_arrays(x, y)
        distances = [shape.distance(x, y) for shape in self.shapes]
        arena = self.inner_bounds
        if arena is not None:
            distances += [x - arena.left, y - arena.bottom, arena.right - x, arena.top - y]
        return np.stack(distances) if distances else np.empty((0, *x.shape))

    def contains(self, x: Floats, y: Floats) -> Bools:
        """Check which points are in an obstacle, on its edge, or not between the walls.

        This is p(s) of the paper's equation (13). The arrays x and y broadcast.
        """
        return self.distance(x, y) <= 0

    def meets_segments(self, x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Bools:
        """Check which straight segments touch any obstacle or wall, or lie in an obstacle.

        Args:
            x0: x of the start of each segment.
            y0: y of the start of each segment.
            x1: x of the end of each segment.
            y1: y of the end of each segment.
        """
        touched = np.zeros(np.broadcast(x0, y0, x1, y1).shape, dtype=np.bool_)
        for shape in self.shapes:
            touched |= shape.meets_segments(x0, y0, x1, y1)
        arena = self.inner_bounds
        if arena is not None:
            touched |= (arena.depth_inside(x0, y0) <= 0) | (arena.depth_inside(x1, y1) <= 0)
        return touched

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Compute the distance of each point to the nearest obstacle or wall [length unit].

        The distance is negative inside an obstacle or beyond a wall, and inf if there is no
        obstacle.
        """
        return self.distances(x, y).min(axis=0, initial=np.inf)

    def distance_lower_bound(self, x: Floats, y: Floats) -> Floats:
        """Compute quickly a lower bound of each point's `distance` to the obstacles [length unit].

        The arrays x and y must have the same shape. The bound is the distance to the nearest wall
        or bounding box of a shape: 0 inside a box, negative beyond a wall, and inf if there is no
        obstacle.
        """
        smallest_squared = np.full(x.shape, np.inf)
        lower_corners = (self.corners_min - self.radii[:, None]).tolist()
        upper_corners = (self.corners_max + self.radii[:, None]).tolist()
        for (left, bottom), (right, top) in zip(lower_corners, upper_corners, strict=True):
            gap_x = np.maximum(np.maximum(left - x, x - right), 0.0)
            gap_y = np.maximum(np.maximum(bottom - y, y - top), 0.0)
            smallest_squared = np.minimum(smallest_squared, gap_x * gap_x + gap_y * gap_y)
        smallest = np.sqrt(smallest_squared)
        return (
            smallest
            if self.inner_bounds is None
            else np.minimum(smallest, self.inner_bounds.depth_inside(x, y))
        )
