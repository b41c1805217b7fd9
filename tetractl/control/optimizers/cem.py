"""The cross-entropy method: repeatedly fits a normal distribution to its best samples.

Source: de Boer, Kroese, Mannor and Rubinstein, "A tutorial on the cross-entropy method", Annals of
Operations Research 134 (2005), section 3 (continuous optimisation, with smoothed updates).

A sequence is u = base + W x: K knots x, joined by straight lines (W), added to the warm start, or
to the bearing of the targets if there is none. The knots are independent, x_k ~ N(m_k, s_k^2). Each
iteration draws P samples, selects the E samples with the least J, the elite, and moves the
distribution towards them:

    m <- (1 - alpha) m + alpha mean(elite),     s <- (1 - alpha) s + alpha std(elite)

From m = 0 and s = spread the distribution contracts around a minimum of J. The result is the best
of all samples, and never worse than the warm start, which is evaluated first.
"""

from typing import Literal

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

ELITE = 16  # one in so many samples of an iteration belongs to the elite
SPREAD_WARM = 0.3  # initial standard deviation of the knots around a warm start [rad]
SMOOTHING = 0.4  # weight alpha of the elite when the distribution is updated


class CrossEntropy(OptimizerSection):
    """The cross-entropy method of Rubinstein and Kroese over the knots of smooth sequences."""

    type: Literal["cem"] = "cem"
    particles: int = Field(default=256, ge=2, le=1_000_000)
    """Number P of samples in an iteration."""
    iterations: int = Field(default=80, ge=1, le=1_000_000)
    """Largest number of iterations of one search."""
    knots: int = Field(default=24, ge=2, le=1000)
    """Number K of directions drawn for a sequence, evenly spread over its length."""
    spread: Positive = 3.0
    """Initial standard deviation of the knots without a warm start [rad]."""
    tolerance: Positive = 1.0
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    @property
    def iterations_max(self) -> int:
        """Largest number of iterations of one search; each updates the distribution once."""
        return self.iterations

    @property
    def evaluations_min(self) -> int:
        """Least number of cost evaluations of a search: one iteration and a warm start."""
        return self.particles + 1

    @property
    def evaluations_max(self) -> int:
        """Largest number of cost evaluations of a search: all iterations and a warm start."""
        return self.particles * self.iterations + 1

    @property
    def good_enough(self) -> float:
        """The cost J at which a sequence is good enough: `tolerance`."""
        return self.tolerance

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals around the warm start or the targets' bearing."""
        progress, costs = Progress(length, limits), compiled_costs(problem, self.particles)
        base = np.full(length, bearing(problem)) if warm is None else warm
        if warm is not None:
            progress.add(warm[:, None], compiled_costs(problem, 1)(warm[:, None]))
        shape = (min(self.knots, length), self.particles)
        mean = np.zeros((shape[0], 1))
        std = np.full_like(mean, self.spread if warm is None else SPREAD_WARM)
        for z in range(self.iterations):
            if progress.history and progress.cost <= self.tolerance:
                progress.ended = StopReason.TARGET
            if progress.history and not progress.affords(self.particles):
                break
            noise = normal(key, z * mean.size * self.particles, mean.size * self.particles)
            knots = mean + std * noise.reshape(shape)
            signals = wrap(base[:, None] + interpolate(knots, length))
            found = costs(signals)
            progress.add(signals, found)
            elite = knots[:, np.argsort(found, kind="stable")[: max(1, self.particles // ELITE)]]
            mean += SMOOTHING * (elite.mean(axis=1, keepdims=True) - mean)
            std += SMOOTHING * (elite.std(axis=1, keepdims=True) - std)
        return progress.search()
