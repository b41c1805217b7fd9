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
TOUCHING = 1e-6
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
    return np.minimum(nearest, setup.arena.inside(x, y)) if walls else nearest


@np.errstate(all="ignore")
def shut_out(setup: Setup, margin: float, walls: bool) -> Floats:
    """Compute how near each robot can come to its target past obstacles, (N,) [length unit].

    The distance is 0 if there may be a path from start to target. It is also 0 if the start is
    nearer to an obstacle than the margin, because such a start is not in free space.

    Args:
        setup: The constants of the experiment.
        margin: Distance that robots keep from obstacles [length unit].
        walls: Whether robots must stay in the arena.
    """
    arena = setup.arena
    side = max(arena.width, arena.height) / CELLS
    x = _centres(arena.left, arena.width, side, walls)
    y = _centres(arena.bottom, arena.height, side, walls)
    depth = margin - clearance(setup, x[None, :], y[:, None], walls)
    free = ~(depth >= (0.5 - TOUCHING) * side)  # a NaN depth blocks nothing
    if not walls:  # the outside counts as one free region
        free[[0, -1], :] = free[:, [0, -1]] = True

    def around(point: Floats) -> Bools:
        """Return the 3 x 3 cells around a point (2,)."""
        row = np.abs(y - point[1]).argmin()
        column = np.abs(x - point[0]).argmin()
        cells = np.zeros_like(free)
        cells[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
        return cells

    least = np.zeros(len(setup.targets))
    for i, (start, target) in enumerate(zip(setup.starts.xy, setup.targets, strict=True)):
        reached = connected(around(start), free)
        if reached.any() and not (reached & around(target)).any():
            rows, columns = np.nonzero(reached)
            nearest = elementwise.hypot(x[columns] - target[0], y[rows] - target[1]).min()
            least[i] = max(nearest - side / math.sqrt(2), 0.0)
    return least


def _centres(begin: float, extent: float, side: float, walls: bool) -> Floats:
    """Return the coordinates of the cells' centres along an axis, in ascending order.

    Unless `walls` is true, two cells are added at each end, outside the arena.
    """
    beyond = 0 if walls else 2
    count = max(math.ceil(extent / side - 1e-9), 1)  # a side far shorter than the other has one
    cells = np.arange(-beyond, count + beyond, dtype=np.float64)
    return begin + (cells + 0.5) * side


def connected(cells: Bools, free: Bools) -> Bools:
    """Find the free cells that are connected with any of `cells`.

    The cells grow by their free neighbours, and by the free runs of rows and columns that they are
    in, until nothing is added. (SciPy's `ndimage.label` takes 0.15 s to import.)
    """
    reached = cells & free
    all_runs = (_runs(free), _runs(free.T).T)
    while True:
        tall = reached.copy()
        tall[1:] |= reached[:-1]
        tall[:-1] |= reached[1:]
        wide = tall.copy()
        wide[:, 1:] |= tall[:, :-1]
        wide[:, :-1] |= tall[:, 1:]
        wide &= free
        if (wide == reached).all():
            return reached
        for runs in all_runs:
            hit = np.zeros(free.size + len(runs) + len(runs.T), np.bool_)
            hit[runs[wide]] = True
            wide = hit[runs] & free
        reached = wide


def _runs(free: Bools) -> NDArray[np.int64]:
    """Return for each cell the index of the run of free cells to which it belongs.

    A run consists of neighbouring free cells in a row. The values of other cells have no meaning.
    """
    ends = np.pad(~free, ((0, 0), (0, 1)), constant_values=True)
    return np.cumsum(ends, dtype=np.int64).reshape(ends.shape)[:, :-1]
