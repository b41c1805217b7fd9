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
UNLIMITED = 2**62
"""Number of evaluations that no search reaches."""


class Multistart(OptimizerSection):
    """Many random starts, the best polished by Levenberg-Marquardt.

    See docs/explanation/controller.md.

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
        reach = problem.speed * problem.seconds(length)
        beyond = float(np.maximum(gaps - reach, 0.0).sum())
        return 1 if beyond > self.tolerance else self.rounds


class _PolishedProgress(Progress):
    """The progress of a search that polishes; `workspace` are the arrays of its kernel.

    A kernel searches until it ends or, with a deadline, until the next look at the clock; then it
    is called again and goes on.
    """

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
        growth = section.growth(problem)
        self.section = section
        longest_step = float(problem.speed.max()) * problem.period
        self.slack = section.slack * longest_step
        self.patience = round(section.patience * growth)
        self.polish = levenberg.lay_out_polish(problem, length)
        self.rollout = rollout.lay_out(problem, section.particles)
        self.workspace = multistart.workspace(
            thread=get_ident(),
            count=min(section.polished, section.particles),
            particles=section.particles,
            knots=min(round(section.knots * growth), length),
            length=length,
            steps_max=round(section.steps * growth),
            rounds=section.rounds,
        )
        robot_steps = len(self.polish.room.residual) * len(problem.a) * length  # of an iteration
        self.iterations_between_looks = max(1, multistart.BETWEEN_LOOKS // robot_steps)
        self.warm = np.empty(0) if warm is None else warm
        self.workspace.begin(np.empty((0, length)) if warm is None else warm[None])

    def run(self, key: int, rounds: int) -> None:
        """Polish the starts with which the workspace begins, and those of so many rounds that are
        scattered."""
        least_evaluations = 1  # of a search that is cut short before it begins
        if not len(self.warm):
            least_evaluations = 2 + self.section.particles if rounds > 0 else 2
        if not self.limits.timed:
            how = self._call(key, rounds, look=0)
            self.ended = ENDED[how]
        elif self.limits.expired(least_evaluations):
            self._cut_short(key, rounds)
        else:
            self._run_to_deadline(key, rounds)
        self.best = self.workspace.best.copy()
        self.cost = float(self.workspace.costs[0])

    def _run_to_deadline(self, key: int, rounds: int) -> None:
        """Search, and look at the clock every few iterations, until the search or time ends."""
        from tetractl.control.kernels import multistart

        while True:
            how = self._call(key, rounds, look=self.iterations_between_looks)
            if how != multistart.UNDER_WAY:
                self.ended = ENDED[how]
                return
            begun_evaluations = int(self.workspace.counts[multistart.POLISH_EVALUATIONS])
            # the evaluations with which the search would end now, so that a rerun of the search can
            # end at the same look; a polish under way is evaluated once more
            if self.limits.expired(
                self.evaluations + begun_evaluations + 1 if begun_evaluations else self.evaluations
            ):
                break
        self.ended = StopReason.DEADLINE
        if begun_evaluations:
            self._cut_short(key, rounds)

    def _cut_short(self, key: int, rounds: int) -> None:
        """End the polish under way as it is, or the first one before it improves its start; the
        reason is the deadline, even if the result is good enough.
        """
        self._call(key, rounds, look=-1)
        self.ended = StopReason.DEADLINE

    def _call(self, key: int, rounds: int, look: int) -> int:
        """Search on by the kernel, take over its history and its evaluations, and return how it
        ended; for `look`, see `tetractl.control.kernels.multistart.search`.
        """
        from tetractl.control.kernels import multistart

        limit = self.limits.evaluations
        budget = UNLIMITED if limit is None else limit
        how = multistart.search(
            self.polish,
            self.rollout,
            np.uint64(key),
            self.warm,
            rounds,
            self.section.tolerance,
            self.slack,
            self.patience,
            budget,
            look,
            self.workspace,
        )
        if not math.isfinite(self.workspace.costs[1]):
            require_finite(self.workspace.costs[1:])
        entries = self.workspace.counts[multistart.HISTORY_ENTRIES]
        self.history += self.workspace.history[:entries].tolist()
        self.workspace.counts[multistart.HISTORY_ENTRIES] = 0
        self.evaluations = int(self.workspace.counts[multistart.EVALUATIONS])
        return how
