"""Ways through passages that are too narrow for all robots abreast.

A common direction moves all robots nearly alike, so that robots pass a gap one after the other, and
hardly any random sequence of directions leads all of them through. `ways` searches a tree: each
branch holds a direction, or lets it rotate, for a while. Of each level only the best nodes are kept
(beam search; Lowerre, The HARPY speech recognition system, 1976), which are those with the least
sum of the robots' ways to their targets round the obstacles. Of nodes with all robots at nearly the
same places only the first is kept, so that the few that are kept differ. An optimiser can begin
with the signals of a node at which all robots are near their targets.

Such a plan is long, and small errors of the model at its beginning are large at its end. Robots
that follow it therefore search only the next AHEAD signals again, with the places where the plan
leads them as targets.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tetractl.control.evaluate import compiled_branches
from tetractl.control.kernels import clearance
from tetractl.control.margins import Margins
from tetractl.control.rng import uniform
from tetractl.core.plan import Problem
from tetractl.core.poses import Bools, Floats, wrap
from tetractl.core.setup import Bounds
from tetractl.model.free_space import connected

Integers = NDArray[np.int64]

CELLS = 90  # number of cells along the longer side of the arena
DIRECTIONS = 24  # directions tried at each node
RATES = np.array([0.0, -1.0, 1.0])  # of their rotation, in units of the least turning rate
HELD = 2.4  # time for which a branch is held, in units of 1 / the least turning rate
PARTS = 2  # number of moments of a signal at which robots must be in free cells
KEPT = 300  # number of nodes kept of each level
ALIKE = 1.2  # nodes in the same squares are alike; their side in units of the largest v / a
NEAR = 2.3  # sum of the ways left from which an optimiser begins, in units of the sum of all v / a
TRIED = 6  # number of nodes of a level from which an optimiser begins
TRIED_IN_ALL = 100  # number of nodes from which an optimiser begins, after which the search ends
AHEAD = 20  # number of signals that are searched again
LOST = 4.0  # miss after them with which robots rest for a new plan, in units of `accept_error`
TRUSTED_S = 1.0  # least time that a plan is driven before


class Squares:
    """The square cells of an arena, as rows and columns."""

    def __init__(self, arena: Bounds) -> None:
        self.side = max(arena.width, arena.height) / CELLS
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

    def ways(self, free: Bools, target: Floats) -> Floats:
        """Return the length of a way through free cells (C,) from each to a target (2,), inf if
        there is none; it leads from each cell to one of its eight neighbours."""
        rows, columns = self.shape
        found = np.full((rows + 2, columns + 2), np.inf)
        inner = found[1:-1, 1:-1]
        inner.flat[self.cells(target)] = 0.0
        blocked, steps = ~free.reshape(self.shape), (self.side, np.sqrt(2) * self.side)
        while True:
            before, far = inner.copy(), found.copy()
            for y, x in np.ndindex(3, 3):
                near = far[y : y + rows, x : x + columns] + steps[abs((y - 1) * (x - 1))]
                np.minimum(inner, near, out=inner)
            inner[blocked] = np.inf
            if (inner == before).all():
                return inner.ravel().copy()


def narrow(problem: Problem, margins: Margins, arena: Bounds) -> bool:
    """Return whether any robot has to pass a place on every way to its target that has no room for
    all robots side by side, at the separation that the problem asks for."""
    if not len(problem.obstacles.rows):
        return False
    grid, row = Squares(arena), (len(problem.a) - 1) / 2 * problem.separation
    room = margins.room(grid.centres[:, :1], grid.centres[:, 1:], 0.0)
    free: Bools = (room >= row).reshape(grid.shape)

    def around(point: Floats) -> Bools:
        """Return the cells to which a robot near an obstacle comes by moving away from it."""
        gap = np.hypot(*(grid.centres - point).T)
        lacks = max(0.0, row - float(room[grid.cells(point)]))
        return (gap <= 1.5 * (lacks + grid.side)).reshape(grid.shape)

    ends = zip(problem.poses.xy, problem.targets, strict=True)
    return any(not (connected(around(start), free) & around(end)).any() for start, end in ends)


def ways(problem: Problem, arena: Bounds, most: int, key: int) -> Iterator[Floats]:
    """Yield up to TRIED_IN_ALL sequences of up to `most` signals that lead all robots near their
    targets, about the shortest first. `key` seeds the first direction of each level."""
    grid, least = Squares(arena), float(problem.a.min())
    gaps, count = np.empty((problem.obstacles.count, len(grid.centres))), len(problem.a)
    x, y = grid.centres.T.copy()
    clearance.gaps(problem.obstacles.rows, problem.obstacles.walls, x, y, gaps)
    free = gaps.min(axis=0, initial=np.inf) > -grid.side / 2
    left = np.concatenate([grid.ways(free, target) for target in problem.targets])
    own = np.arange(count) * len(grid.centres)
    one, other = np.triu_indices(count, 1)
    side = ALIKE * float((problem.speed / problem.a).max())
    near = NEAR * float((problem.speed / problem.a).sum())
    factors = (uniform(key, 0, 2 * count) * 2.0**62).astype(np.int64) | 1
    held = max(1, round(HELD / (least * problem.period)))
    nodes, tree = problem.poses.array()[None], list[tuple[Integers, Floats]]()
    known, tried = np.empty(0, dtype=np.int64), 0
    for level in range(most // held):
        first = uniform(key, 2 * count + level, 1)
        towards = wrap(2 * np.pi / DIRECTIONS * (np.arange(DIRECTIONS) + first))
        found = []
        starts, towards = nodes.repeat(DIRECTIONS, axis=0), np.tile(towards, len(nodes))
        for rate in RATES * least:
            turns = problem.period * rate * np.arange(held)
            times = np.repeat(turns, PARTS), problem.period / PARTS
            path = compiled_branches(problem, starts, towards, *times)[1:]
            ways_left = left[grid.cells(path[..., :2]) + own]
            apart = np.hypot(*(path[:, :, one, :2] - path[:, :, other, :2]).transpose(3, 0, 1, 2))
            clear = np.isfinite(ways_left).all(axis=(0, 2))
            clear &= apart.min(axis=(0, 2), initial=np.inf) > problem.separation
            signals = wrap(towards[clear, None] + turns)
            whence = np.flatnonzero(clear) // DIRECTIONS
            found.append((path[-1, clear], signals, whence, ways_left[-1, clear].sum(axis=1)))
        ends, signals, whence, total = map(np.concatenate, zip(*found, strict=True))
        squares = np.floor(ends[..., :2].reshape(-1, 2 * count) / side).astype(np.int64)
        alike, order = (squares * factors).sum(axis=1), np.argsort(total, kind="stable")
        best = order[np.sort(np.unique(alike[order], return_index=True)[1])]
        best = best[~np.isin(alike[best], known)][:KEPT]
        if not len(best):
            return
        known = np.append(known, alike[best])
        nodes, total = ends[best], total[best]
        tree.append((whence[best], signals[best]))
        for node in range(min(int((total[:TRIED] < near).sum()), TRIED_IN_ALL - tried)):
            yield _sequence(tree, node)
            tried += 1
        if tried == TRIED_IN_ALL:
            return


def ahead(problem: Problem, way: Floats) -> Problem:
    """Return the problem whose targets are where a way (M, N, 3) leads after AHEAD signals."""
    return replace(problem, targets=np.ascontiguousarray(way[AHEAD, :, :2]))


def _sequence(tree: list[tuple[Integers, Floats]], node: int) -> Floats:
    """Return the signals that lead to a node of the last level."""
    parts = []
    for whence, signals in reversed(tree):
        parts.append(signals[node])
        node = int(whence[node])
    return np.concatenate(parts[::-1])
