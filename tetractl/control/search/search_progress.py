"""The progress of an optimiser's search: best sequence, history, and evaluations used."""

import numpy as np

from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Floats


class SearchProgress:
    """The best sequence that a search has found so far, and the number of evaluations it has used.

    Attributes:
        length: Number of signals in a sequence.
        limits: The limits at which the search has to end early.
        best_signals: The best sequence so far [rad], shape (length,).
        best_cost: The cost J of the best sequence.
        history: The lowest cost after each iteration, shape (z + 1,).
        evaluations: Number of cost evaluations so far.
        stop_reason: Why the search ended. None while the search continues.
    """

    def __init__(self, length: int, limits: Limits) -> None:
        self.length = length
        self.limits = limits
        self.best_signals = np.zeros(length)
        self.best_cost = np.inf
        self.history: list[float] = []
        self.evaluations = 0
        self.stop_reason: StopReason | None = None

    def find_limit(self, evaluations: int) -> StopReason | None:
        """Find the limit that forbids a number of further evaluations.

        Returns:
            The reason to end the search: EVALUATIONS or DEADLINE. None if the search can go on.
        """
        if not self.limits.allow(self.evaluations + evaluations):
            return StopReason.EVALUATIONS
        if self.limits.expired(self.evaluations):
            return StopReason.DEADLINE
        return None

    def add_iteration(self, signals: Floats, costs: Floats) -> None:
        """Record an iteration with its sequences (length, P) and their costs (P,)."""
        best_index = int(np.argmin(costs))
        self.add_best(signals[:, best_index], float(costs[best_index]), costs.size)

    def add_best(self, signals: Floats, cost: float, evaluations: int) -> None:
        """Record an iteration by its best sequence and its number of evaluations.

        Args:
            signals: The best sequence of the iteration [rad], shape (length,).
            cost: The cost of this sequence.
            evaluations: Number of evaluations in the iteration.
        """
        self.evaluations += evaluations
        self.add_to_history(signals, cost)

    def add_to_history(self, signals: Floats, cost: float) -> None:
        """Append the lowest cost so far to the history, and update the best sequence.

        The given sequence becomes the best one if it costs less than the best so far, or if it is
        the first.

        Args:
            signals: A sequence [rad], shape (length,).
            cost: The cost of this sequence.
        """
        if cost < self.best_cost or not self.history:
            self.best_signals = signals.copy()
            self.best_cost = cost
        self.history.append(self.best_cost)

    def to_search(self) -> Search:
        """Return the record of the finished search.

        If `stop_reason` is None, the record says that all iterations were done.
        """
        return Search(
            length=self.length,
            signals=self.best_signals,
            cost=self.best_cost,
            history=np.minimum.accumulate(np.array(self.history)),
            evaluations=self.evaluations,
            stopped=self.stop_reason or StopReason.ITERATIONS,
        )
