"""Test whether obstacles separate a robot's start from its target, for a robot without extent.

The arena is covered with square cells. A cell is free unless its centre is deeper inside an
obstacle than half a side. Cells that share a corner are also neighbours. If two points are not
connected in this grid, no path connects them. Proof: inscribe a circle in each cell. A path passes
from disc to disc where two touch, or through the gap between four discs, and all of these are
neighbours. A disc with a free point has its centre no deeper than its radius, so its cell is free.
The reverse does not hold: a wall thinner than a cell may be missed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tetractl.core import elementwise
from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Setup

CELLS = 200
"""Number of square cells along the longer side of the arena."""
CLOSED_GAP = 1e-6
"""Width of the gaps that are closed, as a fraction of a cell's side.

Obstacles may therefore touch a wall without leaving a gap.
"""


def clearance(setup: Setup, x: Floats, y: Floats, walls: bool) -> Floats:
    """Compute the distance of points to the nearest obstacle [length unit], negative inside.

    Args:
        setup: The constants of the experiment.
        x: x of the points.
        y: y of the points.
        walls: Whether everything outside the arena counts as an obstacle.
    """
    nearest = Obstacles.from_shapes(setup.obstacles).distance(x, y)
    return np.minimum(nearest, setup.arena.depth_inside(x, y)) if walls else nearest


@np.errstate(all="ignore")
def blocked_target_distances(setup: Setup, margin: float, walls: bool) -> Floats:
    """Compute how near each robot can come to its target past obstacles [length unit], (N,).

    The distance is 0 if there may be a path from start to target. It is also 0 if the start is
    nearer to an obstacle than the margin, because such a start is not in free space.

    Args:
        setup: The constants of the experiment.
        margin: Distance that robots keep from obstacles [length unit].
        walls: Whether robots must stay in the arena.
    """
    arena = setup.arena
    cell_size = max(arena.width, arena.height) / CELLS
    x = _cell_centres(arena.left, arena.width, cell_size, walls)
    y = _cell_centres(arena.bottom, arena.height, cell_size, walls)
    depth = margin - clearance(setup, x[None, :], y[:, None], walls)
    is_free = ~(depth >= (0.5 - CLOSED_GAP) * cell_size)  # a NaN depth blocks nothing
    if not walls:  # the outside counts as one free region
        is_free[[0, -1], :] = is_free[:, [0, -1]] = True

    def cells_around(point: Floats) -> Bools:
        """Return the 3 x 3 cells around a point (2,)."""
        row = np.abs(y - point[1]).argmin()
        column = np.abs(x - point[0]).argmin()
        cells = np.zeros_like(is_free)
        cells[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
        return cells

    distances_left = np.zeros(len(setup.targets))
    for i, (start, target) in enumerate(zip(setup.starts.xy, setup.targets, strict=True)):
        is_reached = connected(cells_around(start), is_free)
        if is_reached.any() and not (is_reached & cells_around(target)).any():
            rows, columns = np.nonzero(is_reached)
            nearest = elementwise.hypot(x[columns] - target[0], y[rows] - target[1]).min()
            distances_left[i] = max(nearest - cell_size / math.sqrt(2), 0.0)
    return distances_left


def _cell_centres(start: float, extent: float, cell_size: float, walls: bool) -> Floats:
    """Compute the coordinates of the cells' centres along an axis, in ascending order.

    Args:
        start: Where the arena begins [length unit].
        extent: Extent of the arena along this axis [length unit].
        cell_size: Side of a cell [length unit].
        walls: Whether robots must stay in the arena. If not, two cells outside of the arena are
            added at each end.
    """
    cells_outside = 0 if walls else 2
    count = max(
        math.ceil(extent / cell_size - 1e-9), 1
    )  # a side far shorter than the other has one
    cells = np.arange(-cells_outside, count + cells_outside, dtype=np.float64)
    return start + (cells + 0.5) * cell_size


def connected(cells: Bools, free: Bools) -> Bools:
    """Find the free cells that are connected with any of `cells`.

    Free neighbours of the cells are added, and the free runs of rows and columns that the cells are
    in, until nothing more can be added. (SciPy's `ndimage.label` takes 0.15 s to import.)
    """
    reached = cells & free
    all_runs = (_label_runs(free), _label_runs(free.T).T)
    while True:
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown_both = grown.copy()
        grown_both[:, 1:] |= grown[:, :-1]
        grown_both[:, :-1] |= grown[:, 1:]
        grown_both &= free
        if (grown_both == reached).all():
            return reached
        for runs in all_runs:
            is_run_reached = np.zeros(free.size + len(runs) + len(runs.T), np.bool_)
            is_run_reached[runs[grown_both]] = True
            grown_both = is_run_reached[runs] & free
        reached = grown_both


def _label_runs(is_free: Bools) -> NDArray[np.int64]:
    """Compute, for each cell, the index of the run of free cells to which it belongs.

    A run consists of neighbouring free cells in a row. The values of other cells have no meaning.
    """
    run_ends = np.pad(~is_free, ((0, 0), (0, 1)), constant_values=True)
    return np.cumsum(run_ends, dtype=np.int64).reshape(run_ends.shape)[:, :-1]
