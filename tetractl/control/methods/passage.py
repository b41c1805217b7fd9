"""Find plans for many robots, or through gaps that are too narrow for all robots side by side.

A common direction moves all robots in nearly the same way, so robots pass a gap one after another.
Hardly any random sequence of directions leads many robots to targets far apart, or several robots
through a gap. `find_sequences` finds sequences that do, as starts for an optimiser.

It grows a `Tree`. A *node* is where all robots are after some signals. A *branch* grows from it
with one direction, held for BRANCH_S, and its end may be a node of the next *level*. For each level

    _grid_distances
                    computes how far each robot still has to go to its target, around obstacles
    _best_branches  keeps the branches with the smallest sum of squares of these distances (beam
                    search; Lowerre, The HARPY speech recognition system, 1976), if bodies keep
                    clear

The signals to nodes where all robots are near their targets are yielded, and finally those to the
nearest node. Nothing depends on a clock: the number of nodes limits the time.

Such a plan is long, and small errors of the model at its beginning become large at its end. Robots
that follow it therefore search only the next SIGNALS_AHEAD signals again. Their targets are then
the positions to which the plan leads.

Shapes: N robots, T moments along a branch, B branches of a level, C cells of the arena, O obstacles
and walls. Lengths are in the spec's length unit.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from tetractl.control.search.discs import distances_to_obstacles
from tetractl.control.search.evaluate import compiled_branch_paths
from tetractl.control.search.rng import uniform
from tetractl.core import elementwise
from tetractl.core.plan import Problem
from tetractl.core.poses import Bools, Floats, Integers, wrap
from tetractl.core.setup import Bounds

BRANCHES = 16
"""Number of directions tried at each node, spread evenly around the circle."""
MOMENTS_PER_SIGNAL = 2
"""Number of moments during each signal at which the clearance of bodies is tested."""
CELLS_ACROSS = 90
"""Number of square cells along the longer side of the arena, for paths around obstacles."""
BRANCH_S = 0.4
"""Time for which the direction of a branch is held [s]."""
NODES_KEPT = 400
"""Number of nodes kept in each level, multiplied by the number of robots."""
NODES_COMPUTED = 4
"""Number of branches whose clearance is tested, as a multiple of the nodes that are kept.

Only the best branches are tested, because this takes time.
"""
DISTANCE_LEFT = 2.3
"""Sum of remaining distances below which a node counts as near the targets.

The unit is the sum of the robots' turning radii v / a.
"""
STARTS_OF_LEVEL = 6
"""Maximum number of nodes of one level whose sequences are yielded as starts for the optimiser."""
STARTS_IN_ALL = 100
"""Number of yielded sequences after which the search of the tree ends."""
SIGNALS_AHEAD = 20
"""Number of signals of a long plan that are searched again in each step."""
MISS_MAX = 4.0
"""Maximum distance by which robots may miss a long plan, in units of `accept_error`.

The miss is measured after the next SIGNALS_AHEAD signals. If it is larger, the robots pause for a
new plan.
"""
MISS_FRACTION = 0.05
"""Fraction of the remaining distance that is added to the maximum miss."""
FOLLOWED_MIN_S = 1.0
"""Minimum time for which a long plan is followed before robots pause for a new one [s]."""


class Nodes(NamedTuple):
    """K nodes of one level of a tree of directions, or branches that may become nodes.

    A node is a predicted situation: the poses of all robots after some signals.
    """

    parents: Integers
    """For each node, the index of its parent in the previous level, shape (K,)."""
    directions: Floats
    """For each node, the direction that leads to it from its parent [rad], shape (K,)."""
    poses: Floats
    """The poses of all robots at each node, shape (K, N, 3): x, y [length unit], heading [rad]."""

    def select(self, chosen: Integers) -> Self:
        """Return the nodes with the given indices, in that order."""
        return self._make(column[chosen] for column in self)


class Tree:
    """A tree of directions. The nodes of its last level can grow branches.

    A node holds the robots' poses (N, 3) after the signals that lead to it. A branch is one
    direction that is held for several signals.

    Args:
        problem: The robots, targets and obstacles.
        key: Seed of the first direction of each level.
        held: Number of signals for which a branch is held.
    """

    def __init__(self, problem: Problem, key: int, held_signals: int) -> None:
        self.levels: list[Nodes] = []
        self._problem = problem
        self._key = key
        self._held_signals = held_signals
        root_poses = problem.poses.array()[None]
        self._candidates = Nodes(np.zeros(1, dtype=np.int64), np.zeros(1), root_poses)
        """Nodes that may form the next level: the root, or the ends of the branches grown last."""

    def grow(self) -> Floats:
        """Grow BRANCHES branches from each node of the last level.

        Returns:
            The poses along all branches, shape (T, B, N, 3), with T = MOMENTS_PER_SIGNAL
            held_signals.
        """
        phase = uniform(self._key, len(self.levels), 1)
        around = wrap(2 * np.pi / BRANCHES * (np.arange(BRANCHES) + phase))
        nodes = self.levels[-1] if self.levels else self._candidates
        parents = np.arange(len(nodes.poses)).repeat(BRANCHES)
        directions = np.tile(around, len(nodes.poses))
        no_turns = np.zeros(MOMENTS_PER_SIGNAL * self._held_signals)
        moment_s = self._problem.period / MOMENTS_PER_SIGNAL
        starts = nodes.poses[parents]
        path = compiled_branch_paths(self._problem, starts, directions, no_turns, moment_s)[1:]
        self._candidates = Nodes(parents, directions, path[-1])
        return path

    def add_level(self, branches: Integers) -> None:
        """Add a level whose nodes are the ends of the grown branches with the given indices."""
        self.levels.append(self._candidates.select(branches))

    def sequence(self, node: int, levels: int | None = None) -> Floats:
        """Return the signals (L,) [rad] that lead from the root to a node.

        Args:
            node: Index of the node in its level.
            levels: Number of levels from the root to the node. None for the last level.
        """
        directions = []
        for level in reversed(self.levels[:levels]):
            directions.append(level.directions[node])
            node = int(level.parents[node])
        return np.repeat(directions[::-1], self._held_signals)


class CellGrid:
    """A grid of square cells that covers the arena, numbered row by row."""

    def __init__(self, arena: Bounds) -> None:
        self.cell_side = max(arena.width, arena.height) / CELLS_ACROSS
        self._corner = np.array([arena.left, arena.bottom], dtype=np.float64)
        columns = max(1, round(arena.width / self.cell_side))
        rows = max(1, round(arena.height / self.cell_side))
        self.shape = rows, columns
        columns_and_rows = np.indices(self.shape)[::-1].reshape(2, -1).T  # (C, 2)
        self.centres: Floats = self._corner + (columns_and_rows + 0.5) * self.cell_side
        """The centres of the C cells [length unit], shape (C, 2)."""

    def cell_indices(self, points: Floats) -> Integers:
        """Return the index of the cell that contains each point.

        The cell of a point outside the arena is the nearest one. The points have shape (..., 2),
        and the indices have shape (...).
        """
        rows, columns = self.shape
        last_cell = np.array([columns - 1, rows - 1])
        column_and_row = np.clip(
            ((points - self._corner) / self.cell_side).astype(np.int64), 0, last_cell
        )
        return column_and_row[..., 1] * columns + column_and_row[..., 0]

    def path_lengths(self, is_free: Bools, targets: Floats) -> Floats:
        """Compute the lengths of the shortest paths from each cell to each target, shape (N C,).

        Paths lead through free cells, from a cell to one of its eight neighbours.

        Args:
            is_free: Whether each cell is free, shape (C,).
            targets: The targets, shape (N, 2).

        Returns:
            The lengths [length unit], inf where there is no path.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra  # slow to import, and seldom needed

        is_free[self.cell_indices(targets)] = True
        numbers = np.arange(len(is_free)).reshape(self.shape)
        neighbours = (
            (numbers[:, 1:], numbers[:, :-1]),  # in a row
            (numbers[1:], numbers[:-1]),  # in a column
            (numbers[1:, 1:], numbers[:-1, :-1]),  # along a diagonal
            (numbers[1:, :-1], numbers[:-1, 1:]),  # along the other
        )
        starts = np.concatenate([cells.ravel() for cells, _ in neighbours])
        ends = np.concatenate([cells.ravel() for _, cells in neighbours])
        passable = is_free[starts] & is_free[ends]
        starts = starts[passable]
        ends = ends[passable]
        length = elementwise.hypot(*(self.centres[starts] - self.centres[ends]).T)
        n_cells = len(is_free)
        graph = coo_array((length, (starts, ends)), shape=(n_cells, n_cells)).tocsr()
        return dijkstra(graph, directed=False, indices=self.cell_indices(targets)).ravel()


def find_sequences(problem: Problem, arena: Bounds, length_max: int, key: int) -> Iterator[Floats]:
    """Find sequences that lead all robots near their targets, roughly the shortest first.

    Args:
        problem: The problem of the control step.
        arena: The arena.
        length_max: Maximum length of a sequence [signals].
        key: Seed of the first direction in each level.

    Yields:
        Up to STARTS_IN_ALL sequences [rad], and finally the one that leads nearest to the targets.
    """
    n_robots = len(problem.a)
    held_signals = max(1, round(BRANCH_S / problem.period))
    nodes_max = max(1, NODES_KEPT // n_robots)
    near_sum = DISTANCE_LEFT * float((problem.speed / problem.a).sum())
    grid = CellGrid(arena)
    grid_distances = _grid_distances(problem, grid)
    cell_offsets = np.arange(n_robots) * len(grid.centres)  # of each robot in these
    tree = Tree(problem, key, held_signals)
    n_yielded = 0
    sum_min = np.inf
    nearest_level = 0
    for level in range(length_max // held_signals):
        path = tree.grow()
        distances_left = grid_distances[
            grid.cell_indices(path[..., :2]) + cell_offsets
        ]  # (T, B, N)
        branches = _best_branches(problem, path, distances_left, nodes_max)
        if len(branches) == 0:
            break
        tree.add_level(branches)
        sums_left = distances_left[-1, branches].sum(axis=1)  # over the robots, at each node
        if sums_left[0] < sum_min:
            sum_min = float(sums_left[0])
            nearest_level = level
        n_near = int((sums_left[:STARTS_OF_LEVEL] < near_sum).sum())
        for node in range(min(n_near, STARTS_IN_ALL - n_yielded)):
            yield tree.sequence(node)
            n_yielded += 1
        if n_yielded == STARTS_IN_ALL:
            return
    if tree.levels and n_yielded == 0:
        yield tree.sequence(0, nearest_level + 1)


def _grid_distances(problem: Problem, grid: CellGrid) -> Floats:
    """Compute the shortest path of each robot from each cell to its target, shape (N C,).

    The result is a length, inf if obstacles block all paths. A cell is passable if its centre is
    free, or inside an obstacle by less than half a cell.
    """
    x = grid.centres[:, 0].copy()
    y = grid.centres[:, 1].copy()
    is_free = (
        distances_to_obstacles(problem.obstacles, x, y).min(axis=0, initial=np.inf)
        > -grid.cell_side / 2
    )
    return grid.path_lengths(is_free, problem.targets)


def _best_branches(
    problem: Problem, path: Floats, distances_left: Floats, nodes_max: int
) -> Integers:
    """Select the branches whose ends become the nodes of the next level, the best first.

    Clearances take time, so they are computed only for the best branches.

    Args:
        problem: The problem of the control step.
        path: The poses along the branches, shape (T, B, N, 3).
        distances_left: The remaining distance of each robot along each branch.
        nodes_max: Maximum number of nodes.
    """
    squares = np.square(distances_left[-1]).sum(axis=1)
    order = np.argsort(squares, kind="stable")
    # no robot is cut off from its target
    are_connected = np.isfinite(distances_left.sum(axis=(0, 2)))
    best = order[are_connected[order]][: NODES_COMPUTED * nodes_max]
    are_clear = _find_clear(problem, path[:, best, :, :2])
    return best[are_clear][:nodes_max]


def _find_clear(problem: Problem, positions: Floats) -> Bools:
    """Check for each branch whether robots keep their distance from each other and obstacles.

    `positions` contains the positions along the branches, shape (T, B, N, 2). The result has shape
    (B,).
    """
    x = positions[..., 0].copy()
    y = positions[..., 1].copy()
    i, k = np.triu_indices(positions.shape[2], 1)  # the pairs of robots
    pair_distances = elementwise.hypot(x[..., i] - x[..., k], y[..., i] - y[..., k])
    are_apart = (pair_distances > problem.separation).all(axis=-1)  # (T, B)
    to_obstacles = distances_to_obstacles(problem.obstacles, x.ravel(), y.ravel())
    are_outside = (to_obstacles > 0).all(axis=0)
    all_outside = are_outside.reshape(x.shape).all(axis=-1)
    return np.asarray((are_apart & all_outside).all(axis=0))


def with_targets_ahead(problem: Problem, path: Floats) -> Problem:
    """Return the problem with a path's positions after SIGNALS_AHEAD signals as its targets.

    Args:
        problem: The problem of the control step.
        path: Poses along the path, shape (M, N, 3).
    """
    return replace(problem, targets=np.ascontiguousarray(path[SIGNALS_AHEAD, :, :2]))
