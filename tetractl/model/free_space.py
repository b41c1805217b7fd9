"""Check whether obstacles separate a robot's start from its target, for a robot of size zero.

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

CELLS_PER_SIDE = 200
"""Number of square cells along the longer side of the arena."""
CLOSED_GAP_FRACTION = 1e-6
"""Maximum width of a gap that counts as closed, as a fraction of a cell's side.

An obstacle that touches a wall therefore leaves no gap.
"""


def compute_clearances(setup: Setup, x: Floats, y: Floats, has_walls: bool) -> Floats:
    """Compute the distances of points to the nearest obstacle [length unit], negative inside.

    Args:
        setup: The constants of the experiment.
        x: x of the points.
        y: y of the points.
        has_walls: Whether everything outside the arena counts as an obstacle.
    """
    distances = Obstacles.from_shapes(setup.obstacles).distance(x, y)
    return np.minimum(distances, setup.arena.depth_inside(x, y)) if has_walls else distances


@np.errstate(all="ignore")
def blocked_target_distances(setup: Setup, margin: float, has_walls: bool) -> Floats:
    """Compute how near to its target each robot can come past the obstacles [length unit], (N,).

    The distance is 0 if there may be a path from start to target. It is also 0 if the start is
    nearer to an obstacle than the margin, because such a start is not in free space.

    Args:
        setup: The constants of the experiment.
        margin: Distance that robots keep from obstacles [length unit].
        has_walls: Whether robots must stay in the arena.
    """
    arena = setup.arena
    cell_size = max(arena.width, arena.height) / CELLS_PER_SIDE
    x = _compute_cell_centres(arena.left, arena.width, cell_size, has_walls)
    y = _compute_cell_centres(arena.bottom, arena.height, cell_size, has_walls)
    obstacle_depth = margin - compute_clearances(setup, x[None, :], y[:, None], has_walls)
    is_free = ~(
        obstacle_depth >= (0.5 - CLOSED_GAP_FRACTION) * cell_size
    )  # a NaN depth blocks nothing
    if not has_walls:  # the outside counts as one free region
        is_free[[0, -1], :] = is_free[:, [0, -1]] = True

    def cells_around(point: Floats) -> Bools:
        """Return the 3 x 3 cells around a point (2,)."""
        row = np.abs(y - point[1]).argmin()
        column = np.abs(x - point[0]).argmin()
        cells = np.zeros_like(is_free)
        cells[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
        return cells

    min_target_distances = np.zeros(len(setup.targets))
    for i, (start_xy, target_xy) in enumerate(zip(setup.starts.xy, setup.targets, strict=True)):
        is_reached = find_connected_cells(cells_around(start_xy), is_free)
        if is_reached.any() and not (is_reached & cells_around(target_xy)).any():
            rows, columns = np.nonzero(is_reached)
            nearest = elementwise.hypot(x[columns] - target_xy[0], y[rows] - target_xy[1]).min()
            min_target_distances[i] = max(nearest - cell_size / math.sqrt(2), 0.0)
    return min_target_distances


def _compute_cell_centres(
    arena_start: float, extent: float, cell_size: float, has_walls: bool
) -> Floats:
    """Compute the coordinates of the cells' centres along an axis, in ascending order.

    Args:
        arena_start: Coordinate at which the arena starts [length unit].
        extent: Extent of the arena along this axis [length unit].
        cell_size: Side of a cell [length unit].
        has_walls: Whether robots must stay in the arena. If not, two cells outside of the arena are
            added at each end.
    """
    cells_outside = 0 if has_walls else 2
    n_cells = max(math.ceil(extent / cell_size - 1e-9), 1)  # at least one cell
    cell_indices = np.arange(-cells_outside, n_cells + cells_outside, dtype=np.float64)
    return arena_start + (cell_indices + 0.5) * cell_size


def find_connected_cells(is_seed: Bools, is_free: Bools) -> Bools:
    """Find the free cells that are connected with a seed cell.

    Starting with the free seed cells, the search adds all free neighbours, and the free runs of the
    rows and columns that contain reached cells, until there is nothing more to add. (SciPy's
    `ndimage.label` would take 0.15 s to import.)

    Args:
        is_seed: Whether each cell of the grid is a seed.
        is_free: Whether each cell of the grid is free.

    Returns:
        Whether each cell of the grid is free and connected with a seed.
    """
    is_reached = is_seed & is_free
    run_labels = (_label_runs(is_free), _label_runs(is_free.T).T)
    while True:
        grown_vertically = is_reached.copy()
        grown_vertically[1:] |= is_reached[:-1]
        grown_vertically[:-1] |= is_reached[1:]
        grown = grown_vertically.copy()
        grown[:, 1:] |= grown_vertically[:, :-1]
        grown[:, :-1] |= grown_vertically[:, 1:]
        grown &= is_free
        if (grown == is_reached).all():
            return is_reached
        for labels in run_labels:
            is_run_reached = np.zeros(is_free.size + len(labels) + len(labels.T), np.bool_)
            is_run_reached[labels[grown]] = True
            grown = is_run_reached[labels] & is_free
        is_reached = grown


def _label_runs(is_free: Bools) -> NDArray[np.int64]:
    """Compute, for each cell, the index of the run of free cells to which it belongs.

    A run consists of neighbouring free cells in a row. The values of other cells have no meaning.
    """
    is_run_end = np.pad(~is_free, ((0, 0), (0, 1)), constant_values=True)
    return np.cumsum(is_run_end, dtype=np.int64).reshape(is_run_end.shape)[:, :-1]
