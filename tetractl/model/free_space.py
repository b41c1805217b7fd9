"""Whether obstacles wall a target off, for a robot taken as a point.

The arena is covered with a grid. A cell counts as free unless its centre is so deep in an obstacle
that no point of the cell can be free, and cells are neighbours across corners too. Every way of a
robot past the obstacles is thus a way from free cell to free cell, and what is not connected in the
grid is not connected at all. The reverse does not hold: a wall thinner than a cell is not seen.
"""

import math

import numpy as np

from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.model.obstacles import Obstacles

CELLS = 200
"""Cells along the longer side of the arena."""


def clearance(setup: Setup, x: Floats, y: Floats, walls: bool) -> Floats:
    """Return the distance of points to the nearest obstacle [length unit], negative inside.

    With `walls`, all outside the arena is an obstacle.
    """
    nearest = Obstacles.of(setup.obstacles).distance(x, y)
    if not walls:
        return nearest
    arena = setup.arena
    inside = np.minimum(
        np.minimum(x - arena.left, arena.right - x), np.minimum(y - arena.bottom, arena.top - y)
    )
    return np.minimum(nearest, inside)


def shut_out(setup: Setup, margin: float, walls: bool) -> Floats:
    """Return how far from its target each robot stays, at least, (N,) [length unit].

    0 where no wall is found between start and target. Robots keep `margin` from obstacles; with
    `walls` they stay in the arena, without they may go round through its outside.
    """
    from scipy.ndimage import label

    arena = setup.arena
    size = max(arena.width, arena.height) / CELLS
    pad = 0 if walls else 2
    columns, left = _cover(arena.left, arena.width, size, pad)
    rows, bottom = _cover(arena.bottom, arena.height, size, pad)
    x, y = left + (np.arange(columns) + 0.5) * size, bottom + (np.arange(rows) + 0.5) * size
    half = size / math.sqrt(2)
    with np.errstate(over="ignore", invalid="ignore"):
        deep = clearance(setup, x[None, :], y[:, None], walls) <= margin - half
    free = ~deep
    if not walls:  # the outside is one free region, whatever stands in it
        free[[0, -1], :] = free[:, [0, -1]] = True
    regions, _ = label(free, np.ones((3, 3)))

    def cell(point: Floats) -> tuple[int, int]:
        column, row = (point - (left, bottom)) // size
        return int(np.clip(row, 0, rows - 1)), int(np.clip(column, 0, columns - 1))

    found = np.zeros(len(setup.targets))
    for i, (start, target) in enumerate(zip(setup.starts.xy, setup.targets, strict=True)):
        region = regions[cell(start)]
        if region not in (0, regions[cell(target)]):
            at_row, at_column = np.nonzero(regions == region)
            centres = np.hypot(x[at_column] - target[0], y[at_row] - target[1])
            found[i] = max(centres.min() - half, 0.0)
    return found


def _cover(begin: float, extent: float, size: float, pad: int) -> tuple[int, float]:
    """Return how many cells cover an extent with `pad` more on either side, and their begin."""
    return max(math.ceil(extent / size - 1e-9), 1) + 2 * pad, begin - pad * size
