"""`optimizer: {type: random-search}`: random steps from the best sequence so far."""

from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.control.search.evaluate import compiled_costs
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats, wrap
from tetractl.spec.base import Positive
from tetractl.spec.controller import OptimizerSection


class RandomSearch(OptimizerSection):
    """Random search: each iteration tries normal steps from the best sequence and keeps the best.

    The docstrings of the class and of its fields are what `tetractl schema` says of them.
    """

    type: Literal["random-search"]
    samples: int = Field(default=200, ge=1, le=100_000)
    """Sequences tried in each iteration."""
    iterations: int = Field(default=60, ge=1, le=100_000)
    """Iterations of one search."""
    step: Positive = 0.4
    """Standard deviation of each signal's step [rad]."""

    @property
    def iterations_max(self) -> int:
        """Iterations of one search."""
        return self.iterations

    @property
    def evaluations_min(self) -> int:
        """Those of one iteration."""
        return self.samples

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Return the best of all sequences tried, the warm start among them."""
        costs = compiled_costs(problem, self.samples)
        rng = np.random.default_rng(key)  # no other source of chance: logs are verified by it
        best, cost = (np.zeros(length) if warm is None else warm), np.inf
        history: list[float] = []
        stopped = StopReason.ITERATIONS
        while len(history) < self.iterations:
            if history and not limits.allow((len(history) + 1) * self.samples):
                stopped = StopReason.EVALUATIONS
                break
            if history and limits.expired(len(history) * self.samples):
                stopped = StopReason.DEADLINE
                break
            step = self.step if history or warm is not None else np.pi
            steps = rng.normal(0.0, step, (length, self.samples))
            steps[:, 0] = 0.0  # the best itself, so that the history never rises
            signals = wrap(best[:, None] + steps)
            found = costs(signals)
            leader = int(np.argmin(found))
            if found[leader] < cost:
                best, cost = signals[:, leader].copy(), float(found[leader])
            history.append(cost)
        spent = len(history) * self.samples
        return Search(length, best, cost, np.array(history), spent, stopped)
