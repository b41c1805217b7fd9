"""Search for directions that keep robots near their targets when robots cannot stand still.

This optimiser is for robots that always move, such as cells. If their common field rotates at a
rate W that is lower than the robots' lowest rate of turning a, each robot stays on a circle of
radius v / W, with v its speed. If the field is reversed, robots drive back. The search minimises
the time that robots spend further than `Problem.within` from their targets. It first tries
rotations of the field. Then, in rounds, it adds random normal changes to the best sequence so far:
half of the changes are independent from signal to signal, and half accumulate along the sequence.
The changes become smaller from round to round.

Rotations slightly faster than a are also tried, because a robot then falls behind the field and
turns in jerks.
"""

from typing import ClassVar, Literal

import numpy as np

from tetractl.control.search.cost import evaluate
from tetractl.control.search.rng import normal
from tetractl.control.search.search_progress import SearchProgress
from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats, wrap
from tetractl.spec.controller import OptimizerSection

START_DIRECTIONS = np.linspace(-np.pi, np.pi, 16, endpoint=False)
"""First directions of the rotations that are tried [rad]."""
RELATIVE_RATES = np.array([-1.25, -0.95, -0.75, 0.75, 0.95, 1.25])
"""Rates W of the rotations that are tried, in units of the lowest turning rate a."""


class CircleSearch(OptimizerSection):
    """A search for directions that keep robots near their targets for as long as possible."""

    type: Literal["circle"] = "circle"
    ahead_s: ClassVar[float] = 4.0
    """Duration of the plan [s]: long enough for one or two circles."""
    samples: ClassVar[int] = 128
    """Number of randomly changed sequences in each round."""
    rounds: ClassVar[int] = 6
    """Number of rounds in one search."""
    first_std: ClassVar[float] = 0.6
    """Standard deviation of the random changes of a direction in the first round [rad]."""
    std_factor: ClassVar[float] = 0.8
    """Factor by which the standard deviation changes from round to round."""
    accumulation: ClassVar[float] = 0.4
    """Size of the accumulating changes of each signal, relative to the independent ones."""

    @property
    def iterations_max(self) -> int:
        """Number of rounds in one search: each tries random changes of the best sequence so far."""
        return self.rounds

    @property
    def evaluations_min(self) -> int:
        """Number of cost evaluations of a search that ends after one round.

        The search evaluates all rotations, the previous plan and the sequences of one round.
        """
        return len(START_DIRECTIONS) * len(RELATIVE_RATES) + 1 + self.samples

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search from rotations and the previous plan `warm`; see `Optimizer.search`.

        If there is no previous plan, `warm` is None or empty. If the limits expire, the search
        ends with the best sequence so far.
        """
        progress = SearchProgress(length, limits)
        times = problem.period * np.arange(length)
        angles = np.outer(RELATIVE_RATES * problem.a.min(), times)
        sequences = np.add.outer(START_DIRECTIONS, angles).reshape(-1, length)
        if warm is not None and len(warm):
            sequences = np.vstack([_fit_length(warm, length), sequences])
        sequences = wrap(sequences)
        progress.add_iteration(sequences.T, evaluate(problem, sequences).total)
        std = self.first_std
        for z in range(self.rounds):
            progress.stop_reason = progress.find_limit(self.samples)
            if progress.stop_reason is not None:
                break
            sequences = wrap(progress.best_signals + self._changes(key, z, length, std))
            std *= self.std_factor
            progress.add_iteration(sequences.T, evaluate(problem, sequences).total)
        return progress.to_search()

    def _changes(self, key: int, z: int, length: int, std: float) -> Floats:
        """Generate one round's random changes of the best sequence [rad], (samples, length).

        In every other sequence, the changes accumulate from signal to signal.

        Args:
            key: Determines all random numbers of the search.
            z: Index of the round.
            length: Number of signals in a sequence.
            std: Standard deviation of the changes [rad].
        """
        n_draws = self.samples * length
        changes = normal(key, z * n_draws, n_draws).reshape(-1, length)
        accumulating = changes[::2]  # every other sequence
        np.cumsum(self.accumulation * accumulating, axis=1, out=accumulating)
        return std * changes


def _fit_length(plan: Floats, length: int) -> Floats:
    """Extend or cut a plan [rad] to exactly `length` signals.

    A shorter plan continues with its last change of direction, or with a constant direction if
    it has only one signal. A longer plan is cut.
    """
    last_change = plan[-1] - plan[-2] if len(plan) > 1 else 0.0
    continuation = plan[-1] + last_change * np.arange(1, length + 1)
    return np.append(plan, continuation)[:length]
