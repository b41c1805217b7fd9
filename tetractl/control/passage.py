"""Ways for many robots, or through passages that are too narrow for all robots abreast.

A common direction moves all robots nearly alike, so that robots pass a gap one after the other, and
hardly any random sequence of directions leads many robots, or several through a gap, to targets far
apart. `ways` searches a `Tree`: each branch holds a direction for HELD_S. Of each level only the
best nodes are kept (beam search; Lowerre, The HARPY speech recognition system, 1976), which are
those with the least sum of squares of the robots' ways to their targets round the obstacles. Of
nodes with all robots at nearly the same places only the first is kept, so that the few that are
kept differ. An optimiser can begin with the signals of a node at which all robots are near their
targets, or are nearest. Nothing depends on a clock, and the number of nodes bounds the time.

Such a plan is long, and small errors of the model at its beginning are large at its end. Robots
that follow it therefore search only the next AHEAD signals again, with the places where the plan
leads them as targets.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tetractl.control.evaluate import compiled_branches
from tetractl.control.kernels import clearance
from tetractl.control.rng import uniform
from tetractl.core.plan import Problem
from tetractl.core.poses import Bools, Floats, Integers, wrap
from tetractl.core.setup import Bounds

BRANCHES = 16
"""Directions tried at each node."""
PARTS = 2
"""Number of moments of a signal at which robots must keep clear."""
CELLS_ACROSS = 90
"""Number of cells along the longer side of the arena, for ways round obstacles."""
HELD_S = 0.4
"""Time for which a branch is held [s]."""
NODES_KEPT = 400
"""Number of nodes kept of each level, times that of the robots."""
NODES_COMPUTED = 4
"""Of so many times that number, the best, the bodies' distances are computed."""
SQUARE_SIDE = 1.2
"""Side of the squares, in units of the largest v / a: nodes in the same ones are alike."""
WAYS_LEFT = 2.3
"""Sum of the ways left from which an optimiser begins, in units of the sum of all v / a."""
STARTS_OF_LEVEL = 6
"""Number of nodes of a level from which an optimiser begins."""
STARTS_IN_ALL = 100
"""Number of nodes from which an optimiser begins, after which the search ends."""
AHEAD = 20
"""Number of signals that are searched again."""
MISS_MAX = 4.0
"""Miss after them with which robots rest for a new plan, in units of `accept_error`."""
MISS_OF_WAY = 0.05
"""Fraction of what they have to go then that is added to this miss."""
TRUSTED_S = 1.0
"""Least time that a plan is driven before [s]."""


class Level(NamedTuple):
    """The nodes kept of one level: the node of the level before from which each grew, and the
    direction of its branch [rad]."""

    parents: Integers
    directions: Floats


class Tree:
    """A tree of directions, of which the nodes of the last level can grow branches.

    A node is where robots are, poses (N, 3), after the signals that lead to it. A branch is one
    direction, held for `held` signals. Two nodes are alike if all their robots are in the same
    squares, of which the side is SQUARE_SIDE times the largest v / a. `key` seeds the first of the
    directions of each level.
    """

    def __init__(self, problem: Problem, key: int, held: int) -> None:
        count = len(problem.a)
        self.levels: list[Level] = []
        self._problem = problem
        self._key = key
        self._held = held
        self._side = SQUARE_SIDE * float((problem.speed / problem.a).max())
        self._factors = (uniform(key, 0, 2 * count) * 2.0**62).astype(np.int64) | 1
        self._one, self._other = np.triu_indices(count, 1)
        self._nodes: Floats = problem.poses.array()[None]
        self._taken = np.empty(0, dtype=np.int64)  # squares of all nodes kept
        # of the branches grown last (B, ...): their directions, and where and in which squares
        # robots are at their ends
        self._directions: Floats = np.empty(0)
        self._ends: Floats = self._nodes
        self._squares: Integers = self._taken

    def grow(self) -> Floats:
        """Grow BRANCHES of them from each node of the last level; return the poses
        (PARTS held, B, N, 3) along them."""
        count = len(self._problem.a)
        first = uniform(self._key, 2 * count + len(self.levels), 1)
        around = wrap(2 * np.pi / BRANCHES * (np.arange(BRANCHES) + first))
        starts = self._nodes.repeat(BRANCHES, axis=0)
        self._directions = np.tile(around, len(self._nodes))
        turns = np.zeros(PARTS * self._held)
        part = self._problem.period / PARTS
        path = compiled_branches(self._problem, starts, self._directions, turns, part)[1:]
        self._ends = path[-1]
        squares = np.floor(self._ends[..., :2].reshape(-1, 2 * count) / self._side)
        self._squares = (squares.astype(np.int64) * self._factors).sum(axis=1)
        return path

    def unlike(self, order: Integers) -> Integers:
        """Return those of the branches `order`, best first, whose ends are like neither a node nor
        the end of a better branch."""
        first = np.sort(np.unique(self._squares[order], return_index=True)[1])
        best = order[first]
        return best[~np.isin(self._squares[best], self._taken)]

    def apart(self, x: Floats, y: Floats) -> Bools:
        """Return along which branches robots at x, y (T, B, N) keep the separation."""
        one = self._one
        other = self._other
        gaps = np.hypot(x[..., one] - x[..., other], y[..., one] - y[..., other])
        return np.asarray((gaps > self._problem.separation).all(axis=(0, 2)))

    def keep(self, branches: Integers) -> None:
        """Make the ends of branches the nodes of the next level."""
        self._taken = np.append(self._taken, self._squares[branches])
        self._nodes = self._ends[branches]
        self.levels.append(Level(branches // BRANCHES, self._directions[branches]))

    def sequence(self, node: int, levels: int | None = None) -> Floats:
        """Return the signals (L,) that lead to a node of the last of so many levels, or of all."""
        directions = []
        for level in reversed(self.levels[:levels]):
            directions.append(level.directions[node])
            node = int(level.parents[node])
        return np.repeat(directions[::-1], self._held)


class Squares:
    """The square cells of an arena, as rows and columns."""

    def __init__(self, arena: Bounds) -> None:
        self.side = max(arena.width, arena.height) / CELLS_ACROSS
        self._low = np.array([arena.left, arena.bottom], dtype=np.float64)
        columns, rows = (max(1, round(one / self.side)) for one in (arena.width, arena.height))
        self.shape = rows, columns
        at = np.indices(self.shape)[::-1].reshape(2, -1).T
        self.centres: Floats = self._low + (at + 0.5) * self.side  # (C, 2)

    def cells(self, xy: Floats) -> Integers:
        """Return the numbers (...) of the cells that contain points (..., 2), or are nearest."""
        most = np.array(self.shape[::-1]) - 1
        at = np.clip(((xy - self._low) / self.side).astype(np.int64), 0, most)
        return at[..., 1] * self.shape[1] + at[..., 0]

    def ways(self, free: Bools, targets: Floats) -> Floats:
        """Return the lengths (N C,) of ways through free cells (C,) from each to each of the
        targets (N, 2), inf if there is none; they lead from a cell to one of its eight
        neighbours."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra  # slow to import, and seldom needed

        free[self.cells(targets)] = True
        n = np.arange(len(free)).reshape(self.shape)
        beside = [(n[:, 1:], n[:, :-1]), (n[1:], n[:-1])]
        across = [(n[1:, 1:], n[:-1, :-1]), (n[1:, :-1], n[:-1, 1:])]
        ends = zip(*beside, *across, strict=True)
        one, other = (np.concatenate([cells.ravel() for cells in end]) for end in ends)
        both = free[one] & free[other]
        one = one[both]
        other = other[both]
        length = np.hypot(*(self.centres[one] - self.centres[other]).T)
        graph = coo_array((length, (one, other)), shape=(len(free), len(free))).tocsr()
        return dijkstra(graph, directed=False, indices=self.cells(targets)).ravel()


def ways(problem: Problem, arena: Bounds, most: int, key: int) -> Iterator[Floats]:
    """Yield up to STARTS_IN_ALL sequences of up to `most` signals that lead all robots near their
    targets, about the shortest first, and at last the one that leads nearest. `key` seeds the first
    direction of each level."""
    grid = Squares(arena)
    count = len(problem.a)
    gaps = np.empty((problem.obstacles.count, len(grid.centres)))
    x, y = grid.centres.T.copy()
    clearance.gaps(problem.obstacles.rows, problem.obstacles.walls, x, y, gaps)
    free = gaps.min(axis=0, initial=np.inf) > -grid.side / 2
    left = grid.ways(free, problem.targets)
    own = np.arange(count) * len(grid.centres)
    near = WAYS_LEFT * float((problem.speed / problem.a).sum())
    held = max(1, round(HELD_S / problem.period))
    kept = max(1, NODES_KEPT // count)
    tree = Tree(problem, key, held)
    tried = 0
    nearest = (np.inf, 0)
    for level in range(most // held):
        path = tree.grow()
        ways_left = left[grid.cells(path[..., :2]) + own]
        total = (ways_left[-1] ** 2).sum(axis=1)
        order = np.argsort(total, kind="stable")
        order = order[np.isfinite(ways_left.sum(axis=(0, 2)))[order]]
        best = tree.unlike(order)[: NODES_COMPUTED * kept]
        x, y = np.moveaxis(path[:, best, :, :2], -1, 0).copy()
        clear = tree.apart(x, y)
        gaps = np.empty((problem.obstacles.count, x.size))
        clearance.gaps(problem.obstacles.rows, problem.obstacles.walls, x.ravel(), y.ravel(), gaps)
        clear &= (gaps > 0).all(axis=0).reshape(x.shape).all(axis=(0, 2))
        best = best[clear][:kept]
        if not len(best):
            break
        tree.keep(best)
        total = ways_left[-1, best].sum(axis=1)
        nearest = min(nearest, (float(total[0]), level))
        for node in range(min(int((total[:STARTS_OF_LEVEL] < near).sum()), STARTS_IN_ALL - tried)):
            yield tree.sequence(node)
            tried += 1
        if tried == STARTS_IN_ALL:
            return
    if tree.levels and not tried:
        yield tree.sequence(0, nearest[1] + 1)


def ahead(problem: Problem, way: Floats) -> Problem:
    """Return the problem whose targets are where a way (M, N, 3) leads after AHEAD signals."""
    return replace(problem, targets=np.ascontiguousarray(way[AHEAD, :, :2]))
