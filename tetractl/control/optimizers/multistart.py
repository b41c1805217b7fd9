"""Many starts, the best polished: the optimiser that replaces the swarm where no letter binds.

The swarm needs some ten thousand rollouts because it learns nothing from a rollout but its cost.
The cost (8) is smooth, its gradient costs about as much as a rollout, and the number of misses
(two a robot) is small against the number of signals: Levenberg-Marquardt solves it in a few dozen
steps from about every third smooth random sequence. What remains global, the way round an obstacle,
is left to chance and cheap selection: each round scatters many smooth sequences, evaluates them in
one vectorised rollout and polishes only the most promising.
"""

from collections.abc import Callable

import numpy as np

from tetractl.control.cost import Problem, require_finite
from tetractl.control.kernels.levenberg import Polish, lay_out_polish, polish
from tetractl.control.kernels.rollout import costs, lay_out
from tetractl.control.optimizers.compiled import NO_LIMIT
from tetractl.control.optimizers.pso import never
from tetractl.control.rng import mix, uniform
from tetractl.core.plan import Search
from tetractl.core.poses import Floats, wrap
from tetractl.experiment.controller import MultistartSpec

SLACK = 0.01  # share of the fastest robot's step by which a path is pushed clear of an obstacle


def multistart(
    problem: Problem,
    length: int,
    warm: Floats | None,
    spec: MultistartSpec,
    key: int,
    budget: int | None = None,
    expired: Callable[[], bool] = never,
) -> Search:
    """Search sequences of `length` signals, from `warm` or from nothing; a `Searcher`.

    A warm start is polished first; only where that fails is one round scattered, half of it around
    the warm start. The history holds J before and after each polish and, in between, the merit of
    its steps: (8) plus the depths inside obstacles.
    """
    hunt = _Hunt(problem, length, spec, budget)
    if warm is not None:
        hunt.take(warm)
        if hunt.affords(2):
            hunt.improve(warm)
    for number in range(spec.rounds if warm is None else 1):
        if hunt.ended or (number > 0 and _out_of_reach(problem, length, spec)):
            break
        if hunt.history and not hunt.affords(spec.particles):
            break
        starts = _scatter(problem, length, warm, spec, mix(key, number))
        for start in hunt.select(starts):
            if expired():
                hunt.ended = "deadline"
            if hunt.ended or not hunt.affords(2):
                break
            hunt.improve(start)
    return hunt.search()


def _out_of_reach(problem: Problem, length: int, spec: MultistartSpec) -> bool:
    """Whether even straight lines at full speed leave a cost above the tolerance."""
    seconds = problem.first_period + (length - 1) * problem.period
    gaps = problem.poses.distances(problem.targets)
    return float(np.maximum(gaps - problem.speed * seconds, 0.0).sum()) > spec.tolerance


def _scatter(
    problem: Problem, length: int, warm: Floats | None, spec: MultistartSpec, key: int
) -> Floats:
    """Draw smooth random sequences, shape (length, particles).

    Each is linear between `knots` directions drawn uniformly from the circle around the mean
    bearing of the targets; with a warm start, every other one is the warm start plus such a curve
    of up to half a radian.
    """
    knots = min(spec.knots, length)
    gaps = problem.targets - problem.poses.xy
    bearing = np.arctan2(gaps[:, 1].sum(), gaps[:, 0].sum())
    draws = uniform(key, 0, knots * spec.particles).reshape(knots, spec.particles) * 2 - 1
    at = np.linspace(0, knots - 1, length)
    below = np.minimum(at.astype(np.int64), max(knots - 2, 0))
    share = (at - below)[:, None]
    curve = draws[below] * (1 - share) + draws[np.minimum(below + 1, knots - 1)] * share
    starts = bearing + np.pi * curve
    if warm is not None:
        starts[:, ::2] = warm[:, None] + 0.5 * curve[:, ::2]
    return wrap(starts)  # into the bounds of (12)


class _Hunt:
    """The best sequence so far, and what it has cost."""

    def __init__(
        self, problem: Problem, length: int, spec: MultistartSpec, budget: int | None
    ) -> None:
        self.spec, self.length = spec, length
        self.budget = NO_LIMIT if budget is None else budget
        self.many = lay_out(problem, spec.particles)
        self.one = lay_out(problem, 1)
        self.work: Polish = lay_out_polish(problem, length)
        self.slack = SLACK * float(problem.speed.max()) * problem.period
        rows = len(self.work.residual)
        self.factor = np.empty((rows, rows))
        self.trace = np.empty(spec.polish_steps + 1)
        self.best = np.zeros(length)
        self.cost = np.inf
        self.history: list[float] = []
        self.evaluations = 0
        self.ended = ""

    def affords(self, evaluations: int) -> bool:
        """Whether the budget allows so many more; if not, that ends the search."""
        if self.evaluations + evaluations > self.budget:
            self.ended = self.ended or "evaluations"
        return not self.ended

    def select(self, starts: Floats) -> list[Floats]:
        """Evaluate a round and return its best, best first."""
        found = np.empty(starts.shape[1])
        costs(self.many, starts, found)
        require_finite(found)
        self.evaluations += found.size
        order = np.argsort(found, kind="stable")[: self.spec.polished]
        self._keep(starts[:, order[0]], float(found[order[0]]))
        return [starts[:, n].copy() for n in order]

    def take(self, signals: Floats) -> None:
        """Evaluate one sequence."""
        found = np.empty(1)
        costs(self.one, np.ascontiguousarray(signals[:, None]), found)
        require_finite(found)
        self.evaluations += 1
        self._keep(signals, float(found[0]))

    def improve(self, start: Floats) -> None:
        """Polish one sequence, and keep it if it is the best."""
        signals = start.copy()
        _, steps, evaluations = polish(
            self.work,
            signals,
            self.spec.tolerance,
            self.slack,
            self.spec.polish_steps,
            self.budget - self.evaluations - 1,
            self.factor,
            self.trace,
        )
        self.evaluations += evaluations
        before = self.cost
        self.take(wrap(signals))
        if self.cost < before:
            self.history[-1:] = np.clip(self.trace[:steps], self.cost, before).tolist()
            self.history.append(self.cost)
        if self.cost <= self.spec.tolerance:
            self.ended = "target"

    def _keep(self, signals: Floats, cost: float) -> None:
        if cost < self.cost or not self.history:
            self.best, self.cost = signals.copy(), cost
        self.history.append(self.cost)

    def search(self) -> Search:
        """Return what was found."""
        return Search(
            self.length,
            self.best,
            self.cost,
            np.minimum.accumulate(np.array(self.history)),
            self.evaluations,
            self.ended or "iterations",
        )
