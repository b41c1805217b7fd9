"""What optimisers share that fit a normal distribution to samples of smooth sequences.

A sequence is u = base + W x: K knots x, joined by straight lines (W), added to the warm start, or
to the bearing of the targets if there is none. The knots are independent, x_k ~ N(m_k, s_k^2), with
m = 0 at first. Each iteration evaluates P sequences, the first of them that of the mean, so that
the result, the best of all, is never worse than the warm start. Then the kind's rule updates m and
s from the samples and their costs.
"""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from pydantic import Field

from tetractl.control.curves import bearing, interpolate
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
        self, mean: Floats, std: Floats, knots: Floats, costs: Floats
    ) -> tuple[Floats, Floats]:
        """Return mean and standard deviation (K, 1) of the knots after an iteration, given those
        before, its samples (K, P) and their costs J (P,)."""

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals around the warm start or the targets' bearing."""
        progress, costs = Progress(length, limits), compiled_costs(problem, self.particles)
        base = np.full(length, bearing(problem)) if warm is None else warm
        shape = min(self.knots, length), self.particles
        count, mean = shape[0] * shape[1], np.zeros((shape[0], 1))
        std = np.full_like(mean, self.spread if warm is None else self.spread_warm)
        for z in range(self.iterations):
            if progress.history and not progress.affords(self.particles):
                break
            noise = normal(key, z * count, count).reshape(shape)
            noise[:, 0] = 0.0
            knots = mean + std * noise
            signals = wrap(base[:, None] + interpolate(knots, length))
            found = costs(signals)
            progress.add(signals, found)
            if progress.cost <= self.tolerance:
                progress.ended = StopReason.TARGET
                break
            mean, std = self.updated(mean, std, knots, found)
        return progress.search()
