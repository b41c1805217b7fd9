"""Searches directions that keep robots near their targets if they cannot stand still.

A field that rotates at W, below the robots' least turning rate a, keeps each robot on a circle of
radius v / W; a field turned by pi makes robots drive back. The search minimises the time that
robots spend farther than `Problem.within` from their targets. It tries rotations first, and then
adds random normal changes to the best sequence so far: half of the changes are independent from
signal to signal, half accumulate along the sequence. Each round's changes are smaller.
"""

import math
from typing import Literal

import numpy as np

from tetractl.control.cost import evaluate
from tetractl.control.rng import normal
from tetractl.control.search_progress import Progress
from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats, wrap
from tetractl.experiment.controller import OptimizerSection

AHEAD_S = 4.0  # duration of the plan: one or two circles
PHASES = np.linspace(-np.pi, np.pi, 16, endpoint=False)  # first directions of rotations [rad]
# angular velocities of rotations, in units of the least a
RATES = np.array([-1.25, -0.95, -0.75, 0.75, 0.95, 1.25])
SAMPLES, ROUNDS = 128, 6
SPREAD, SHRINK = 0.6, 0.8  # initial deviation of a step [rad], and its ratio from round to round
ADDING = 0.4  # spread of cumulative steps relative to independent ones


class CircleSearch(OptimizerSection):
    """Finds the directions that keep robots within a radius of their targets for as long as
    possible."""

    type: Literal["circle"] = "circle"

    @property
    def iterations_max(self) -> int:
        """Number of rounds of samples in one search."""
        return ROUNDS

    @property
    def evaluations_min(self) -> int:
        """Least number of cost evaluations of a search: those of all rotations, of the
        previous plan and of one round."""
        return len(PHASES) * len(RATES) + 1 + SAMPLES

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals; the previous plan `warm` is extended to that
        length by repeating its last change of direction."""
        progress, times = Progress(length, limits), problem.period * np.arange(length)
        rates = RATES * float(problem.a.min())
        known = (PHASES[:, None, None] + rates[:, None] * times).reshape(-1, length)
        if warm is not None and len(warm):
            turn = float(warm[-1] - warm[-2]) if len(warm) > 1 else 0.0
            further = warm[-1] + turn * np.arange(1, length + 1)
            known = np.vstack([np.append(warm, further)[:length], known])
        known = wrap(known)
        progress.add(known.T, evaluate(problem, known).total)
        for z in range(ROUNDS):
            if not progress.affords(SAMPLES):
                break
            steps = normal(key, z * length * SAMPLES, length * SAMPLES).reshape(SAMPLES, length)
            steps[::2] = np.cumsum(ADDING * steps[::2], axis=1)
            tried = wrap(progress.best + SPREAD * SHRINK**z * steps)
            progress.add(tried.T, evaluate(problem, tried).total)
        return progress.search()


def signals_ahead(period: float) -> int:
    """Return the number of signals of a plan, each held for `period` [s]."""
    return max(2, math.ceil(AHEAD_S / period))
