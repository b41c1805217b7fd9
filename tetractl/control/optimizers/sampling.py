"""What optimisers share that fit a normal distribution to samples of smooth sequences.

A sequence of L signals is

    u = base + W x,     x_k ~ N(m_k, s_k^2),  k = 1 ... K

The base is the warm start, or without it the bearing of the targets. W joins K knots x [rad] by
straight lines. The knots are independent, and m = 0 at first. Each iteration

1. draws P samples of x, the first of them the mean m itself, so that the result, the best of all
   sequences, is never worse than the warm start;
2. evaluates the cost J of their sequences;
3. updates m and s from the samples and their costs, by the rule of the kind (`cem`, `mppi`).

m and s have the shape (K, 1), samples (K, P), sequences (L, P).
"""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from pydantic import Field

from tetractl.control.evaluate import compiled_costs
from tetractl.control.rng import normal
from tetractl.control.search_progress import Progress
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats, wrap
from tetractl.experiment.base import Positive
from tetractl.experiment.controller import OptimizerSection


class SamplingOptimizer(OptimizerSection):
    """A normal distribution of the knots of smooth sequences, updated after each iteration."""

    particles: int = Field(default=128, ge=2, le=1_000_000)
    """Number P of sequences in an iteration, including that of the mean."""
    iterations: int = Field(default=150, ge=1, le=1_000_000)
    """Largest number of iterations of one search."""
    knots: int = Field(default=32, ge=2, le=1000)
    """Number K of directions drawn for a sequence, evenly spread over its length."""
    spread: Positive = 2.0
    """Initial standard deviation s of the knots without a warm start [rad]."""
    tolerance: Positive = 1.0
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    spread_warm: ClassVar[float] = 0.3
    """Initial standard deviation s of the knots around a warm start [rad]."""

    @property
    def iterations_max(self) -> int:
        """Largest number of iterations of one search; each updates the distribution once."""
        return self.iterations

    @property
    def evaluations_min(self) -> int:
        """Least number of cost evaluations of a search: those of one iteration."""
        return self.particles

    @property
    def evaluations_max(self) -> int:
        """Largest number of cost evaluations of a search: all iterations."""
        return self.particles * self.iterations

    @property
    def good_enough(self) -> float:
        """The cost J at which a sequence is good enough: `tolerance`."""
        return self.tolerance

    @abstractmethod
    def updated(
        self, mean: Floats, std: Floats, samples: Floats, costs: Floats
    ) -> tuple[Floats, Floats]:
        """Return mean and standard deviation (K, 1) of the knots after an iteration, given those
        before, its samples (K, P) and their costs J (P,)."""

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals around the warm start or the targets' bearing."""
        costs_of = compiled_costs(problem, self.particles)
        progress = Progress(length, limits)
        base = np.full(length, bearing(problem)) if warm is None else warm
        knots = min(self.knots, length)
        mean = np.zeros((knots, 1))
        std = np.full((knots, 1), self.spread if warm is None else self.spread_warm)
        for z in range(self.iterations):
            if z > 0:
                progress.ended = progress.limit_before(self.particles)
            if progress.ended is not None:
                break
            samples = mean + std * self._noise(key, z, knots)
            signals = wrap(base[:, None] + interpolate(samples, length))
            costs = costs_of(signals)
            progress.add(signals, costs)
            if progress.cost <= self.tolerance:
                progress.ended = StopReason.TARGET
                break
            mean, std = self.updated(mean, std, samples, costs)
        return progress.search()

    def _noise(self, key: int, z: int, knots: int) -> Floats:
        """Return standard normal numbers of iteration z, (knots, P), zeros for the first sample."""
        count = knots * self.particles
        noise = normal(key, z * count, count).reshape(knots, self.particles)
        noise[:, 0] = 0.0
        return noise


def bearing(problem: Problem) -> float:
    """Return the direction of the mean vector from the robots to their targets [rad]."""
    x, y = (problem.targets - problem.poses.xy).T
    return float(np.arctan2(y.sum(), x.sum()))


def interpolate(knots: Floats, length: int) -> Floats:
    """Return sequences (length, P) that are linear between evenly spread knots (K, P).

    The first and last signals are the first and last knots; K is at most `length`.
    """
    places = np.linspace(0, len(knots) - 1, length)
    last_below = max(len(knots) - 2, 0)
    below = np.minimum(places.astype(np.int64), last_below)
    share = (places - below)[:, None]
    after = np.minimum(below + 1, len(knots) - 1)
    return knots[below] * (1 - share) + knots[after] * share
