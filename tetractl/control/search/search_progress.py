"""The progress of an optimiser's search: best sequence, history, and evaluations used."""

import numpy as np

from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Floats


class Progress:
    """The best sequence that a search has found so far, and the number of evaluations it has used.

    `history` holds the lowest cost after each iteration, shape (z + 1,). `ended` is the reason why
    the search ended. It is None while the search continues.
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
        """Find the limit that forbids a number of further evaluations.

        Returns:
            The reason to end the search: EVALUATIONS or DEADLINE. None if the search can go on.
        """
        if not self.limits.allow(self.evaluations + evaluations):
            return StopReason.EVALUATIONS
        if self.limits.expired(self.evaluations):
            return StopReason.DEADLINE
        return None

    def add(self, signals: Floats, costs: Floats) -> None:
        """Record an iteration that has computed the costs (P,) of sequences (length, P)."""
        leader = int(np.argmin(costs))
        self.add_best(signals[:, leader], float(costs[leader]), costs.size)

    def add_best(self, signals: Floats, cost: float, evaluations: int) -> None:
        """Record an iteration of which only the best sequence matters.

        Args:
            signals: Its best sequence [rad], shape (length,).
            cost: The cost of that sequence.
            evaluations: Number of evaluations in the iteration.
        """
        self.evaluations += evaluations
        self.keep(signals, cost)

    def keep(self, signals: Floats, cost: float) -> None:
        """Append the lowest cost so far to the history.

        The sequence `signals`, shape (length,), becomes the best one if it costs less than the
        best so far, or if it is the first.
        """
        if cost < self.cost or not self.history:
            self.best = signals.copy()
            self.cost = cost
        self.history.append(self.cost)

    def search(self) -> Search:
        """Return the record of the finished search.

        If `ended` is None, the reason for the end is that all iterations were done.
        """
        return Search(
            length=self.length,
            signals=self.best,
            cost=self.cost,
            history=np.minimum.accumulate(np.array(self.history)),
            evaluations=self.evaluations,
            stopped=self.ended or StopReason.ITERATIONS,
        )
