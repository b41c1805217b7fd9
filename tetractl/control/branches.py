"""A tree of directions held for some signals, of which a beam search keeps the best nodes."""

import numpy as np
from numpy.typing import NDArray

from tetractl.control.evaluate import compiled_branches
from tetractl.control.rng import uniform
from tetractl.core.plan import Problem
from tetractl.core.poses import Bools, Floats, wrap

DIRECTIONS = 16  # directions tried at each node
PARTS = 2  # number of moments of a signal at which robots must keep clear

Integers = NDArray[np.int64]


class Tree:
    """The nodes kept of each level, from the poses of a problem on. Each branch is one direction,
    held for `held` signals; `key` seeds the first direction of each level. Nodes are alike if their
    robots end in the same squares, of a side `alike` in units of the largest v / a.
    """

    def __init__(self, problem: Problem, key: int, held: int, alike: float) -> None:
        count = len(problem.a)
        self.levels = list[tuple[Integers, Floats]]()  # whence each node came, and its direction
        self._problem, self._key, self._held = problem, key, held
        self._times = np.zeros(PARTS * held), problem.period / PARTS
        self._side = alike * float((problem.speed / problem.a).max())
        self._factors = (uniform(key, 0, 2 * count) * 2.0**62).astype(np.int64) | 1
        self._one, self._other = np.triu_indices(count, 1)
        self._nodes, self._known = problem.poses.array()[None], np.empty(0, dtype=np.int64)
        self._ends, self._towards = self._nodes, np.empty(0)  # of the branches grown last
        self._alike = self._known

    def grow(self) -> Floats:
        """Return the poses (T, B, N, 3) along the branches of all nodes of the last level."""
        count = len(self._problem.a)
        first = uniform(self._key, 2 * count + len(self.levels), 1)
        around = wrap(2 * np.pi / DIRECTIONS * (np.arange(DIRECTIONS) + first))
        starts = self._nodes.repeat(DIRECTIONS, axis=0)
        self._towards = np.tile(around, len(self._nodes))
        path = compiled_branches(self._problem, starts, self._towards, *self._times)[1:]
        self._ends = path[-1]
        squares = np.floor(self._ends[..., :2].reshape(-1, 2 * count) / self._side)
        self._alike = (squares.astype(np.int64) * self._factors).sum(axis=1)
        return path

    def unlike(self, order: Integers) -> Integers:
        """Return of branches, best first, those that are like none before and no node known."""
        first = np.sort(np.unique(self._alike[order], return_index=True)[1])
        return order[first][~np.isin(self._alike[order[first]], self._known)]

    def apart(self, x: Floats, y: Floats) -> Bools:
        """Return along which branches robots at (T, B, N) keep their separation."""
        one, other = self._one, self._other
        gaps = np.hypot(x[..., one] - x[..., other], y[..., one] - y[..., other])
        return np.asarray((gaps > self._problem.separation).all(axis=(0, 2)))

    def keep(self, best: Integers) -> None:
        """Add the ends of branches as the nodes of the next level."""
        self._known = np.append(self._known, self._alike[best])
        self._nodes = self._ends[best]
        self.levels.append((best // DIRECTIONS, self._towards[best]))

    def sequence(self, node: int, levels: int | None = None) -> Floats:
        """Return the signals (L,) that lead to a node of the last of so many levels, or of all."""
        parts = []
        for whence, towards in reversed(self.levels[:levels]):
            parts.append(towards[node])
            node = int(whence[node])
        return np.repeat(parts[::-1], self._held)
