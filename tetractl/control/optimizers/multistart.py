"""The recommended optimiser: Levenberg-Marquardt polishes the best of many random starts.

A particle swarm needs some ten thousand rollouts because it uses only the cost of a rollout. The
cost, equation (8) of the paper, is smooth, its gradient costs about as much as a rollout, and there
are far fewer misses (two coordinates per robot) than signals: Levenberg-Marquardt
(`tetractl.control.kernels.levenberg`) reaches the targets from about every third smooth random
sequence, in a few dozen steps. Global decisions, such as the side on which to pass an obstacle, are
made by random starts and selection: each round draws many smooth sequences, evaluates them in one
vectorised rollout and polishes only the best.
"""

from threading import get_ident
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.control.cost import require_finite
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats
from tetractl.experiment.base import Positive
from tetractl.experiment.controller import OptimizerSection


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
        """Largest number of Levenberg-Marquardt iterations for one start, of up to three robots."""
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
        rounds = self._rounds(problem, length) if warm is None else 1
        polished = _PolishedSearch(self, problem, length, warm, key, rounds, limits)
        stopped = polished.run()
        return polished.found(stopped)

    def _rounds(self, problem: Problem, length: int) -> int:
        """Return `rounds`, but 1 if the targets are out of reach even along straight lines."""
        gaps = problem.poses.distances(problem.targets)
        reach = problem.speed * problem.seconds(length)
        beyond = float(np.maximum(gaps - reach, 0.0).sum())
        return 1 if beyond > self.tolerance else self.rounds


class _PolishedSearch:
    """One search, which the compiled `kernels.multistart.search` does.

    With a deadline it is called for a few iterations at a time, between looks at the clock. Its
    `rounds` are arrays that the next search of this thread uses again.
    """

    def __init__(
        self,
        section: Multistart,
        problem: Problem,
        length: int,
        warm: Floats | None,
        key: int,
        rounds_max: int,
        limits: Limits,
    ) -> None:
        from tetractl.control.kernels import levenberg, motion, multistart, rollout

        growth = section.growth(problem)
        longest_step = float(problem.speed.max()) * problem.period
        starts = np.empty((0, length)) if warm is None else warm[None]
        self.limits = limits
        self.rounds_max = rounds_max
        self.particles = section.particles
        self.problem = motion.flatten(problem)
        self.rollouts = rollout.rollouts_of(get_ident(), len(problem.a), section.particles)
        self.room = levenberg.room_for(problem, length)
        self.key = np.uint64(key)
        self.warm = np.empty(0) if warm is None else warm
        self.settings = levenberg.PolishSettings(
            tolerance=section.tolerance,
            slack=section.slack * longest_step,
            patience=round(section.patience * growth),
        )
        self.rounds = multistart.rounds_for(
            thread=get_ident(),
            count=min(section.polished, section.particles),
            particles=section.particles,
            knots=min(round(section.knots * growth), length),
            length=length,
            steps_max=round(section.steps * growth),
            rounds=section.rounds,
        )
        self.rounds.begin(starts)

    def run(self) -> StopReason:
        """Search until the search ends or time does; return why it ended."""
        from tetractl.control.kernels import multistart

        if not self.limits.timed:
            return self._reason(self._go_on(multistart.UNLIMITED))
        if self.limits.expired(self._least_evaluations()):
            return self._cut_short()
        robot_steps = len(self.room.residual) * self.rounds.signals.size * len(self.problem.robots)
        iterations = max(1, multistart.BETWEEN_LOOKS // robot_steps)
        while True:
            end = self._go_on(iterations)
            if end != multistart.PAUSED:
                return self._reason(end)
            # what the search would have spent if it ended now, so that a rerun of it can end at
            # the same look
            evaluations = int(self.rounds.state.evaluations)
            under_way = int(self.rounds.polish.evaluations)
            if under_way > 0:
                evaluations += under_way + 1  # its sequence is evaluated once more
            if self.limits.expired(evaluations):
                return self._cut_short() if under_way > 0 else StopReason.DEADLINE

    def found(self, stopped: StopReason) -> Search:
        """Return the record of the search, which stopped for this reason."""
        state = self.rounds.state
        history = self.rounds.history[: state.history_entries]
        return Search(
            length=self.rounds.best.size,
            signals=self.rounds.best.copy(),
            cost=float(state.best_cost),
            history=np.minimum.accumulate(history),
            evaluations=int(state.evaluations),
            stopped=stopped,
        )

    def _least_evaluations(self) -> int:
        """Return what a search spends that is cut short before it begins."""
        if self.warm.size > 0:
            return 1
        return 2 if self.rounds_max == 0 else self.particles + 2

    def _cut_short(self) -> StopReason:
        """End the polish under way as it is, or the first one before it improves its start. The
        reason is the deadline, even if the result is good enough."""
        from tetractl.control.kernels import multistart

        self._go_on(multistart.UNLIMITED, cut_short=True)
        return StopReason.DEADLINE

    def _reason(self, end: int) -> StopReason:
        """Return why the search stopped, given how the kernel says that it ended."""
        from tetractl.control.kernels import multistart

        if end == multistart.GOOD:
            return StopReason.TARGET
        if end == multistart.SPENT:
            return StopReason.EVALUATIONS
        return StopReason.ITERATIONS  # all rounds are done

    def _go_on(self, iterations: int, cut_short: bool = False) -> int:
        """Search for about so many iterations; return how the search ended, if it did."""
        from tetractl.control.kernels import multistart

        limit = self.limits.evaluations
        end = multistart.search(
            self.problem,
            self.rollouts,
            self.room,
            self.key,
            self.warm,
            self.rounds_max,
            self.settings,
            multistart.UNLIMITED if limit is None else limit,
            iterations,
            cut_short,
            self.rounds,
        )
        if end == multistart.NOT_FINITE:
            require_finite(np.array([np.nan]))
        return end
