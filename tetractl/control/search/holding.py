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
from tetractl.control.search.search_progress import Progress
from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats, wrap
from tetractl.spec.controller import OptimizerSection

PHASES = np.linspace(-np.pi, np.pi, 16, endpoint=False)  # first directions of rotations [rad]
RATES = np.array([-1.25, -0.95, -0.75, 0.75, 0.95, 1.25])  # W of rotations, in units of the least a


class CircleSearch(OptimizerSection):
    """A search for directions that keep robots near their targets for as long as possible."""

    type: Literal["circle"] = "circle"
    ahead_s: ClassVar[float] = 4.0
    """Duration of the plan [s]: long enough for one or two circles."""
    samples: ClassVar[int] = 128
    """Number of randomly changed sequences in each round."""
    rounds: ClassVar[int] = 6
    """Number of rounds in one search."""
    spread: ClassVar[float] = 0.6
    """Standard deviation of the random changes of a direction in the first round [rad]."""
    shrink: ClassVar[float] = 0.8
    """Factor by which this standard deviation changes from round to round."""
    adding: ClassVar[float] = 0.4
    """Size of the accumulating changes of each signal, relative to the independent ones."""

    @property
    def iterations_max(self) -> int:
        """Number of rounds in one search.

        Each tries random changes of the best sequence so far.
        """
        return self.rounds

    @property
    def evaluations_min(self) -> int:
        """Number of sequences whose costs a search computes if it ends after one round.

        They are all rotations, the previous plan and the sequences of one round.
        """
        return len(PHASES) * len(RATES) + 1 + self.samples

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search from rotations and the previous plan `warm`; see `Optimizer.search`.

        If there is no previous plan, `warm` is None or empty. If the limits expire, the search
        ends with the best sequence so far.
        """
        progress = Progress(length, limits)
        times = problem.period * np.arange(length)
        angles = np.outer(RATES * problem.a.min(), times)
        sequences = np.add.outer(PHASES, angles).reshape(-1, length)
        if warm is not None and len(warm):
            sequences = np.vstack([_extended(warm, length), sequences])
        sequences = wrap(sequences)
        progress.add(sequences.T, evaluate(problem, sequences).total)
        spread = self.spread
        for z in range(self.rounds):
            progress.ended = progress.limit_before(self.samples)
            if progress.ended is not None:
                break
            sequences = wrap(progress.best + self._changes(key, z, length, spread))
            spread *= self.shrink
            progress.add(sequences.T, evaluate(problem, sequences).total)
        return progress.search()

    def _changes(self, key: int, z: int, length: int, spread: float) -> Floats:
        """Generate one round's random changes of the best sequence [rad], (samples, length).

        `z` is the index of the round. `spread` is the standard deviation of the changes [rad]. In
        every other sequence, the changes accumulate from signal to signal.
        """
        draws = self.samples * length
        changes = normal(key, z * draws, draws).reshape(-1, length)
        accumulating = changes[::2]  # every other sequence
        np.cumsum(self.adding * accumulating, axis=1, out=accumulating)
        return spread * changes


def _extended(plan: Floats, length: int) -> Floats:
    """Return a plan [rad] with exactly `length` signals.

    A shorter plan goes on with its last change of direction, or with a constant direction if it
    has only one signal. A longer plan is cut.
    """
    turn = plan[-1] - plan[-2] if len(plan) > 1 else 0.0
    further = plan[-1] + turn * np.arange(1, length + 1)
    return np.append(plan, further)[:length]
