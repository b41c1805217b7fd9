"""The recommended optimiser: Levenberg-Marquardt polishes the best of many random starts.

A particle swarm needs some ten thousand rollouts because it uses only the cost of a rollout. The
cost, equation (8) of the paper, is smooth, its gradient costs about as much as a rollout, and there
are far fewer misses (two coordinates per robot) than signals: Levenberg-Marquardt
(`tetractl.control.kernels.levenberg`) reaches the targets from about every third smooth random
sequence, in a few dozen steps. Global decisions, such as the side on which to pass an obstacle, are
made by random starts and selection: each round draws many smooth sequences, evaluates them in one
vectorised rollout and polishes only the best.
"""

import math
from threading import get_ident
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.control.cost import require_finite
from tetractl.control.search_progress import Progress
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats
from tetractl.experiment.base import Positive
from tetractl.experiment.controller import OptimizerSection

ENDED = (None, StopReason.TARGET, StopReason.EVALUATIONS, None)
"""Why a search ended, by what its kernel returns; None if all rounds are done."""


class Multistart(OptimizerSection):
    """Many random starts, the best polished by Levenberg-Marquardt; see docs/explanation/solver.md.

    Each round scatters `particles` smooth random sequences, evaluates them in one rollout, and
    polishes the best `polished` of them until one has a cost of at most `tolerance`.
    """

    type: Literal["multistart"] = "multistart"
    particles: int = Field(default=128, ge=1, le=1_000_000)
    """Number of sequences scattered in each round."""
    knots: int = Field(default=12, ge=2, le=1000)
    """Number of random directions that each scattered sequence passes through, evenly spread over
    its length.
    """
    polished: int = Field(default=4, ge=1, le=10_000)
    """Number of sequences polished in each round, the best of the scattered ones."""
    rounds: int = Field(default=10, ge=1, le=10_000)
    """Number of rounds of a search without a warm start. With a warm start there is one round, and
    only if polishing the start fails.
    """
    grows: bool = True
    """Whether `knots` and the iterations that polish a start are multiplied by (N / 3)^2 if there
    are more than three robots."""
    tolerance: Positive = 0.001
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    slack: ClassVar[float] = 0.01
    """Clearance of a path pushed out of an obstacle, per step of the fastest robot."""
    steps: ClassVar[int] = 40
    """Most Levenberg-Marquardt iterations of a start."""
    patience: ClassVar[int] = 6
    """A polish ends if so many iterations bring no fall by a fifth."""

    @property
    def iterations_max(self) -> int:
        """Largest number of Levenberg-Marquardt iterations for one start."""
        return self.steps

    @property
    def evaluations_min(self) -> int:
        """Least number of cost evaluations of a search: one round and a warm start."""
        return self.particles + 1

    @property
    def good_enough(self) -> float:
        """The cost J at which a sequence is good enough: `tolerance`."""
        return self.tolerance

    def growth(self, problem: Problem) -> float:
        """Return the factor by which `knots`, `steps` and `patience` are multiplied."""
        return max(1.0, (len(problem.a) / 3) ** 2) if self.grows else 1.0

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals, from `warm` or from random starts.

        A warm start is polished first; if that fails, one round is scattered, half of it around the
        warm start. The history holds J before and after each polish and, in between, the merit of
        its steps: f of the paper's equation (8) plus the depths inside obstacles.
        """
        progress = _PolishedProgress(self, problem, length, warm, limits)
        progress.run(key, self._rounds(problem, length) if warm is None else 1)
        return progress.search()

    def _rounds(self, problem: Problem, length: int) -> int:
        """Return `rounds`, but 1 if the targets are out of reach even along straight lines."""
        gaps = problem.poses.distances(problem.targets)
        beyond = float(np.maximum(gaps - problem.speed * problem.seconds(length), 0.0).sum())
        return 1 if beyond > self.tolerance else self.rounds


class _PolishedProgress(Progress):
    """The progress of a search that polishes, with the workspace of the kernels."""

    def __init__(
        self,
        section: Multistart,
        problem: Problem,
        length: int,
        warm: Floats | None,
        limits: Limits,
    ) -> None:
        from tetractl.control.kernels import levenberg, multistart, rollout

        super().__init__(length, limits)
        self.section, self.problem, self.warm, self.kernels = section, problem, warm, multistart
        self.step = float(problem.speed.max()) * problem.period  # of the fastest robot
        growth = section.growth(problem)
        self.patience = round(section.patience * growth)
        steps = round(section.steps * growth)
        count, particles = min(section.polished, section.particles), section.particles
        knots = min(round(section.knots * growth), length)
        self.laid = levenberg.lay_out_polish(problem, length), rollout.lay_out(problem, particles)
        self.work = multistart.workspace(
            get_ident(), count, particles, knots, length, steps, section.rounds
        )
        self.work.begin(np.empty((0, length)) if warm is None else warm[None])
        # iterations between two looks at the deadline
        each = len(self.laid[0].room.residual) * len(problem.a) * length
        self.look = max(1, multistart.BETWEEN_LOOKS // each) if limits.timed else 0

    def run(self, key: int, rounds: int) -> None:
        """Polish the starts with which `work` begins, and those of `rounds` that are scattered."""
        kernels, section, limits, work = self.kernels, self.section, self.limits, self.work
        warm = np.empty(0) if self.warm is None else self.warm
        search = section.tolerance, section.slack * self.step, self.patience
        most = 2**62 if limits.evaluations is None else limits.evaluations
        # a look is given the evaluations with which the search would end then, so that a rerun of
        # the search can end at the same look
        least = self.evaluations + (1 if len(warm) else 2 + section.particles * (rounds > 0))
        look = -1 if limits.timed and limits.expired(least) else self.look
        while True:
            how = kernels.search(
                *self.laid, np.uint64(key), warm, rounds, *search, most, look, work
            )
            if not math.isfinite(work.costs[1]):
                require_finite(work.costs[1:])
            self.history += work.history[: work.at[kernels.KEPT]].tolist()
            work.at[kernels.KEPT] = 0
            self.evaluations, begun = int(work.at[kernels.EVALUATIONS]), int(work.at[kernels.BEGUN])
            if look >= 0 and how != kernels.UNDER_WAY:
                self.ended = ENDED[how]
                break
            if look >= 0 and not limits.expired(self.evaluations + begun + bool(begun)):
                continue
            self.ended = StopReason.DEADLINE  # even if what is ended early is good enough
            if look < 0 or not begun:
                break
            look = -1  # ends the polish under way
        self.best, self.cost = work.best.copy(), float(work.costs[0])
