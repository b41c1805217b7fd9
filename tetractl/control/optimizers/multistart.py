"""The recommended optimiser: Levenberg-Marquardt polishes the best of many random starts.

A particle swarm needs some ten thousand rollouts because it uses only the cost of a rollout. The
cost, equation (8) of the paper, is smooth, its gradient costs about as much as a rollout, and there
are far fewer misses (two coordinates per robot) than signals: Levenberg-Marquardt
(`tetractl.control.kernels.levenberg`) reaches the targets from about every third smooth random
sequence, in a few dozen steps. Global decisions, such as the side on which to pass an obstacle, are
made by random starts and selection: each round draws many smooth sequences, evaluates them in one
vectorised rollout and polishes only the best.

A thorough search hops: it repeatedly moves one of the best few sequences at random, polishes it,
and keeps it if it is better (basin hopping; Wales and Doye, J. Phys. Chem. A 101 (1997)). For
arbitrary starts and targets, most random sequences end in a corner between walls, obstacles and
other robots, and hops from nearly good sequences find good ones.
"""

from threading import get_ident
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from tetractl.control.cost import require_finite
from tetractl.control.curves import bearing, interpolate
from tetractl.control.rng import mix, uniform
from tetractl.control.search_progress import Progress
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats, wrap
from tetractl.experiment.base import Positive
from tetractl.experiment.controller import OptimizerSection


class Hops(NamedTuple):
    """A thorough search: how it hops, and how each hop is polished."""

    most: int = 1000  # number of hops for up to 3 robots; for N robots times (N / 3)^2
    work: float = 1e9  # limit of evaluations x signals x robots: some seconds
    pool: int = 6  # number of sequences from which hops start
    steps: int = 60  # as `Multistart.steps`
    patience: int = 12  # as `Multistart.patience`
    least_change: float = 0.15  # smallest change of signals [rad]
    most_change: float = 1.5  # largest change [rad]
    hit: float = 0.25  # cost of a position left in an obstacle, over the fastest robot's step


HOPS = Hops()


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
        if limits.thorough:
            progress.hop(key)
            return progress.search()
        if warm is not None:
            progress.try_one(warm)
            progress.polish(warm[None])
        for number in range(self._rounds(problem, length) if warm is None else 1):
            if progress.ended:
                break
            if progress.history and not progress.affords(self.particles):
                break
            progress.polish(progress.select(mix(key, number)))
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
        from tetractl.control.kernels import levenberg, multistart

        super().__init__(length, limits)
        self.section, self.problem, self.warm = section, problem, warm
        self.kernels, self.work = multistart, levenberg.lay_out_polish(problem, length)
        self.slack = section.slack * float(problem.speed.max()) * problem.period
        growth = section.growth(problem)
        self.patience = round(section.patience * growth)
        steps = round(section.steps * growth)
        if limits.thorough:
            self.patience, steps = HOPS.patience, HOPS.steps
            self.hops = round(HOPS.most * max(1.0, (len(problem.a) / 3) ** 2))
        self.polished = multistart.workspace(get_ident(), section.polished, length, steps)
        # iterations between two looks at the deadline
        step = len(self.work.room.residual) * len(problem.a) * length
        self.look = max(1, multistart.BETWEEN_LOOKS // step) if limits.timed else 0

    def select(self, key: int) -> Floats:
        """Scatter and evaluate a round, and return its best sequences (K, length), best first."""
        from tetractl.control.kernels.rollout import lay_out

        section, length, warm = self.section, self.length, self.warm
        count = min(round(section.knots * section.growth(self.problem)), length)
        starts, found = np.empty((length, section.particles)), np.empty(section.particles)
        finite = self.kernels.scatter(
            lay_out(self.problem, section.particles),
            np.uint64(key),
            bearing(self.problem),
            np.empty(0) if warm is None else warm,
            np.empty((count, section.particles)),
            starts,
            found,
        )
        if not finite:
            require_finite(found)
        self.add(starts, found)
        order = np.argsort(found, kind="stable")[: section.polished]
        return np.ascontiguousarray(starts[:, order].T)

    def try_one(self, signals: Floats) -> None:
        """Evaluate one sequence (length,) and add its cost to the history."""
        self.polished.steps[0] = 0
        self._improve(signals[None], 0, look=-1)
        require_finite(self.polished.costs[:1])
        self.evaluations += 1
        self.keep(signals, float(self.polished.costs[0]))

    def polish(self, starts: Floats) -> None:
        """Polish sequences (K, length) in turn until one is good enough; keep the best."""
        done, self.polished.steps[:] = 0, 0
        while done < len(starts) and self.affords(2):
            done = self._polish_some(starts, done)

    def _polish_some(self, starts: Floats, done: int) -> int:
        """Polish sequences (K, length) from number `done` until it is time to look at the deadline;
        return how many are polished."""
        found, first = self.polished, done
        done = self._improve(starts, first, self.look)
        begun = int(found.evaluations[done]) if done < len(starts) and found.steps[done] else 0
        if begun and self.limits.expired(self.evaluations + begun):
            done, self.ended = self._improve(starts, done, look=-1), StopReason.DEADLINE
        require_finite(found.costs[first:done])
        for n in range(first, done):
            before, cost = self.cost, float(found.costs[n])
            self.evaluations += int(found.evaluations[n])
            self.keep(found.signals[n], cost)
            if cost < before:
                merits = found.merits[n, : found.steps[n]]
                self.history[-1:] = np.clip(merits, cost, before).tolist()
                self.history.append(cost)
        if self.cost <= self.section.tolerance and self.ended is None:
            self.ended = StopReason.TARGET
        return done

    def _improve(self, starts: Floats, done: int, look: int) -> int:
        """Call the kernel `improve`."""
        most = 2**62 if self.limits.evaluations is None else self.limits.evaluations
        found = self.polished
        begun = int(found.evaluations[done]) if found.steps[done] else 0
        return self.kernels.improve(
            self.work,
            starts,
            done,
            self.section.tolerance,
            self.slack,
            self.patience,
            most - self.evaluations - begun,
            look,
            found,
        )

    def hop(self, key: int) -> None:
        """Polish randomly changed copies of the best sequences until one is good enough.

        A change ("hop") adds a random curve to all signals or to a span of them, or removes one
        signal and inserts another elsewhere. The pool is ordered by each sequence's merit after
        the polish, which includes the depths in obstacles, plus a cost for each position that is
        still in an obstacle.
        """
        pool: list[tuple[float, Floats]] = []
        found, length = self.polished, self.length
        middle, step = bearing(self.problem), self.slack / self.section.slack
        for number in range(self.hops):
            work = self.evaluations * length * len(self.problem.a)
            if self.ended or work > HOPS.work or (self.history and not self.affords(2)):
                break
            draws = uniform(mix(key, number), 0, length + 8)
            start = _moved(pool, draws, length, middle)
            if number == 0 and self.warm is not None:
                start = self.warm
            self.slack = self.section.slack * step * 30 ** draws[7]
            self.polish(start[None])
            hits = found.costs[0] // self.problem.obstacle_weight
            merit = found.merits[0, found.steps[0]] + HOPS.hit * step * hits
            pool.append((float(merit), found.signals[0].copy()))
            pool.sort(key=lambda one: one[0])
            del pool[HOPS.pool :]


def _moved(pool: list[tuple[float, Floats]], draws: Floats, length: int, middle: float) -> Floats:
    """Return a randomly changed copy of a sequence of the pool; see `_PolishedProgress.hop`."""
    which, way, size, count, first, second = draws[:6]
    knots = 2 * draws[8:] - 1
    if len(pool) < HOPS.pool:
        curve = interpolate(knots[: 2 + int(count * (length - 2)), None], length)[:, 0]
        return wrap(middle + np.pi * curve)
    base = pool[int(which * len(pool))][1]
    size = HOPS.least_change * (HOPS.most_change / HOPS.least_change) ** size
    curve = size * interpolate(knots[: 2 + int(count * length / 3), None], length)[:, 0]
    one, other = int(first * length), int(second * length)
    if way < 1 / 3:
        span = np.arange(length)
        curve[(span < min(one, other)) | (span > max(one, other))] = 0.0
    elif way < 2 / 3:
        base = np.insert(np.delete(base, one), other, np.pi * (2 * draws[6] - 1))
    return wrap(base + curve)
