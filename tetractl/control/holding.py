"""The search for directions that hold robots near their targets which cannot stand still.

A field that rotates at W, below the least a, holds every robot on a circle of radius v / W; one
that turns back lets it run back. Sequences of both kinds and of any other are searched for the
least time outside, `Problem.within`: rotations first, then normal steps about the best so far, half
of them independent and half of them adding up, that shrink from round to round.
"""

import math
from typing import Literal

import numpy as np

from tetractl.control.cost import evaluate
from tetractl.control.rng import normal
from tetractl.control.search_progress import Progress
from tetractl.core.plan import Limits, Search
from tetractl.core.poses import Floats, wrap
from tetractl.core.problem import Problem
from tetractl.experiment.controller import OptimizerSection

AHEAD_S = 4.0  # of the plan: one or two circles
PHASES = np.linspace(-np.pi, np.pi, 16, endpoint=False)  # of a rotation's first direction
RATES = np.array([-1.25, -0.95, -0.75, 0.75, 0.95, 1.25])  # of rotations [least a]
SAMPLES, ROUNDS = 128, 6
SPREAD, SHRINK = 0.6, 0.8  # rad, and from one round to the next
ADDING = 0.4  # ratio of the spread of steps that add up to that of independent ones


class CircleSearch(OptimizerSection):
    """Finds the directions that keep robots within a radius of their targets for as long as
    possible."""

    type: Literal["circle"] = "circle"

    @property
    def iterations_max(self) -> int:
        """Rounds of samples."""
        return ROUNDS

    @property
    def evaluations_min(self) -> int:
        """The rotations, the plan before and one round."""
        return len(PHASES) * len(RATES) + 1 + SAMPLES

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals; `warm` is continued as it turned last."""
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
    """Return how many signals a plan of the hold has, each held for the given number of seconds."""
    return max(2, math.ceil(AHEAD_S / period))
