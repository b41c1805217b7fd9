"""The progress of an optimiser's search: best sequence, history and evaluations spent."""

import numpy as np

from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Floats


class Progress:
    """The best sequence found so far, and the number of evaluations used.

    `history` holds the lowest cost after each iteration, shape (z + 1,). `ended` is the reason why
    the search ended, None while it continues.
    """

    def __init__(self, length: int, limits: Limits) -> None:
        self.length = length
        self.limits = limits
        self.best = np.zeros(length)
        self.cost = np.inf
        self.history: list[float] = []
        self.evaluations = 0
        self.ended: StopReason | None = None

    def limit_before(self, evaluations: int) -> StopReason | None:
        """Return the limit that forbids this many more evaluations. None if no limit does."""
        if not self.limits.allow(self.evaluations + evaluations):
            return StopReason.EVALUATIONS
        if self.limits.expired(self.evaluations):
            return StopReason.DEADLINE
        return None

    def add(self, signals: Floats, costs: Floats) -> None:
        """Add an iteration that has evaluated the costs (P,) of sequences (length, P)."""
        leader = int(np.argmin(costs))
        self.add_best(signals[:, leader], float(costs[leader]), costs.size)

    def add_best(self, signals: Floats, cost: float, evaluations: int) -> None:
        """Add an iteration.

        Args:
            signals: Its best sequence [rad], shape (length,).
            cost: The cost of that sequence.
            evaluations: Number of evaluations in the iteration.
        """
        self.evaluations += evaluations
        self.keep(signals, cost)

    def keep(self, signals: Floats, cost: float) -> None:
        """Add an entry to the history; keep the sequence (length,) if it is the best."""
        if cost < self.cost or not self.history:
            self.best = signals.copy()
            self.cost = cost
        self.history.append(self.cost)

    def search(self) -> Search:
        """Return the record of the search. If `ended` is None, all iterations were done."""
        return Search(
            length=self.length,
            signals=self.best,
            cost=self.cost,
            history=np.minimum.accumulate(np.array(self.history)),
            evaluations=self.evaluations,
            stopped=self.ended or StopReason.ITERATIONS,
        )
