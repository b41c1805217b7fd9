"""Many starts, the best polished by Levenberg-Marquardt: the recommended optimiser.

A particle swarm needs some ten thousand rollouts because it learns nothing from a rollout but its
cost. The cost (8) is smooth, its gradient costs about as much as a rollout, and the number of
misses (two a robot) is small against the number of signals: Levenberg-Marquardt
(`tetractl.control.levenberg`) solves it in a few dozen steps from about every third smooth random
sequence. What remains global, the way round an obstacle, is left to chance and cheap selection:
each round scatters many smooth sequences, evaluates them in one vectorised rollout and polishes
only the most promising.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.control.curves import bearing, interpolate
from tetractl.control.evaluate import compiled_costs
from tetractl.control.progress import Progress
from tetractl.control.rng import mix, uniform
from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Floats, wrap
from tetractl.core.problem import Problem
from tetractl.experiment.base import Positive
from tetractl.experiment.controller import OptimizerSection

SLACK = 0.01  # share of the fastest robot's step by which a path is pushed clear of an obstacle
NO_LIMIT = 2**62


class Multistart(OptimizerSection):
    """Many starts, the best polished by Levenberg-Marquardt; see docs/explanation/solver.md.

    Each round scatters `particles` smooth random sequences, evaluates them as a swarm is, and
    polishes the best `polished` of them until one has a cost of at most `tolerance`.
    """

    type: Literal["multistart"] = "multistart"
    particles: int = Field(default=128, ge=1, le=1_000_000)
    """Sequences scattered in each round."""
    knots: int = Field(default=12, ge=2, le=1000)
    """Random directions that each of them passes through, evenly spread over its length."""
    polished: int = Field(default=4, ge=1, le=10_000)
    """The best of a round that are polished."""
    patience: int = Field(default=6, ge=1, le=10_000)
    """Iterations in which a start has to get nearer by a fifth, or is given up."""
    polish_steps: int = Field(default=40, ge=1, le=10_000)
    """Levenberg-Marquardt iterations spent on each at most."""
    rounds: int = Field(default=8, ge=1, le=10_000)
    """Rounds of one search without a warm start; with one that cannot be polished, a single one."""
    grows: bool = True
    """Whether `knots`, `patience` and `polish_steps` are those of three robots, and grow with the
    square of the number of robots."""
    tolerance: Positive = 0.001
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    @property
    def iterations_max(self) -> int:
        """Iterations spent on one start at most."""
        return self.polish_steps

    @property
    def evaluations_min(self) -> int:
        """One round and a warm start."""
        return self.particles + 1

    @property
    def good_enough(self) -> float:
        """The tolerance."""
        return self.tolerance

    def growth(self, problem: Problem) -> float:
        """Return how many times as many knots and iterations a problem needs as for 3 robots."""
        return max(1.0, (len(problem.a) / 3) ** 2) if self.grows else 1.0

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals, from `warm` or from nothing.

        A warm start is polished first; only where that fails is one round scattered, half of it
        around the warm start. The history holds J before and after each polish and, in between, the
        merit of its steps: (8) plus the depths inside obstacles.
        """
        progress = _PolishedProgress(self, problem, length, limits)
        if warm is not None:
            progress.try_one(warm)
            if progress.affords(2):
                progress.polish(warm)
        for number in range(self.rounds if warm is None else 1):
            if progress.ended or (number > 0 and self._out_of_reach(problem, length)):
                break
            if progress.history and not progress.affords(self.particles):
                break
            for start in progress.select(self._scatter(problem, length, warm, mix(key, number))):
                if not progress.affords(2):
                    break
                progress.polish(start)
        return progress.search()

    def _out_of_reach(self, problem: Problem, length: int) -> bool:
        """Whether even straight lines at full speed leave a cost above the tolerance."""
        seconds = problem.first_period + (length - 1) * problem.period
        gaps = problem.poses.distances(problem.targets)
        return float(np.maximum(gaps - problem.speed * seconds, 0.0).sum()) > self.tolerance

    def _scatter(self, problem: Problem, length: int, warm: Floats | None, key: int) -> Floats:
        """Draw smooth random sequences, shape (length, particles).

        Each is linear between `knots` directions drawn uniformly from the circle around the mean
        bearing of the targets; with a warm start, every other one is the warm start plus such a
        curve of up to half a radian.
        """
        knots = min(round(self.knots * self.growth(problem)), length)
        draws = uniform(key, 0, knots * self.particles).reshape(knots, self.particles) * 2 - 1
        curve = interpolate(draws, length)
        starts = bearing(problem) + np.pi * curve
        if warm is not None:
            starts[:, ::2] = warm[:, None] + 0.5 * curve[:, ::2]
        return wrap(starts)  # into the bounds of (12)


class _PolishedProgress(Progress):
    """The progress of a search that polishes, with the workspace of the kernels."""

    def __init__(self, section: Multistart, problem: Problem, length: int, limits: Limits) -> None:
        from tetractl.control.kernels.levenberg import lay_out_polish, polish

        super().__init__(length, limits)
        self.section, self.kernel = section, polish
        self.problem = problem
        self.many: Callable[[Floats], Floats] | None = None  # few warm starts need it
        self.one = compiled_costs(problem, 1)
        self.work = lay_out_polish(problem, length)
        self.slack = SLACK * float(problem.speed.max()) * problem.period
        rows = len(self.work.residual)
        self.factor = np.empty((rows, rows))
        growth = section.growth(problem)
        self.patience = round(section.patience * growth)
        self.steps = round(section.polish_steps * growth)
        self.trace = np.empty(self.steps + 1)

    def select(self, starts: Floats) -> list[Floats]:
        """Evaluate a round, (length, particles), and return its best sequences, best first."""
        if self.many is None:
            self.many = compiled_costs(self.problem, self.section.particles)
        found = self.many(starts)
        self.add(starts, found)
        order = np.argsort(found, kind="stable")[: self.section.polished]
        return [starts[:, n].copy() for n in order]

    def try_one(self, signals: Floats) -> None:
        """Evaluate one sequence."""
        column = signals[:, None]
        self.add(column, self.one(column))

    def polish(self, start: Floats) -> None:
        """Polish one sequence, and keep it if it is the best."""
        signals, before = start.copy(), self.cost
        most = NO_LIMIT if self.limits.evaluations is None else self.limits.evaluations
        _, steps, evaluations = self.kernel(
            self.work,
            signals,
            self.section.tolerance,
            self.slack,
            self.steps,
            self.patience,
            most - self.evaluations - 1,
            self.factor,
            self.trace,
        )
        self.evaluations += evaluations
        self.try_one(wrap(signals))
        if self.cost < before:
            self.history[-1:] = np.clip(self.trace[:steps], self.cost, before).tolist()
            self.history.append(self.cost)
        if self.cost <= self.section.tolerance:
            self.ended = StopReason.TARGET
