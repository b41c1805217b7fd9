"""Model predictive path integral control: the mean of noisy sequences, weighted by their cost.

Source: Williams, Aldrich and Theodorou, "Model predictive path integral control: from theory to
parallel computation", Journal of Guidance, Control, and Dynamics 40 (2017), algorithm 2.

From a nominal sequence u, each iteration draws P perturbations e_p, curves of K normal knots with
standard deviation s joined by straight lines, evaluates J(u + e_p), and moves the nominal sequence
by the mean of the perturbations under the weights of a Boltzmann distribution of the cost:

    w_p = exp(-(J(u + e_p) - min J) / lambda) / sum_q exp(-(J(u + e_q) - min J) / lambda)
    u  <- u + sum_p w_p e_p

The temperature lambda is TEMPERATURE, which has no unit, times the standard deviation of the
iteration's costs; s is multiplied by COOLING after each iteration. The nominal sequence
is the first sample of each iteration, with e_1 = 0; the result is the best of all samples.
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

NOISE_WARM = 0.3  # standard deviation of the knots around a warm start [rad]
COOLING = 0.97  # factor of the standard deviation after each iteration
TEMPERATURE = 0.02  # lambda over the standard deviation of an iteration's costs


class Mppi(OptimizerSection):
    """Model predictive path integral control of Williams et al., iterated with falling noise."""

    type: Literal["mppi"] = "mppi"
    particles: int = Field(default=128, ge=2, le=1_000_000)
    """Number P of sequences in an iteration, including the nominal one."""
    iterations: int = Field(default=150, ge=1, le=1_000_000)
    """Largest number of iterations of one search."""
    knots: int = Field(default=32, ge=2, le=1000)
    """Number K of normally distributed knots of a perturbation, evenly spread over its length."""
    noise: Positive = 2.0
    """Initial standard deviation s of the knots without a warm start [rad]."""
    tolerance: Positive = 1.0
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    @property
    def iterations_max(self) -> int:
        """Largest number of iterations of one search; each moves the nominal sequence once."""
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

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search sequences of `length` signals from the warm start or the targets' bearing."""
        progress, costs = Progress(length, limits), compiled_costs(problem, self.particles)
        nominal = np.full(length, bearing(problem)) if warm is None else warm.copy()
        std = self.noise if warm is None else NOISE_WARM
        shape = (min(self.knots, length), self.particles)
        count = shape[0] * self.particles
        for z in range(self.iterations):
            if progress.history and not progress.affords(self.particles):
                break
            knots = std * normal(key, z * count, count).reshape(shape)
            knots[:, 0] = 0.0
            moves = interpolate(knots, length)
            signals = wrap(nominal[:, None] + moves)
            found = costs(signals)
            progress.add(signals, found)
            if progress.cost <= self.tolerance:
                progress.ended = StopReason.TARGET
                break
            weights = np.exp((found.min() - found) / (TEMPERATURE * found.std() + 1e-300))
            nominal = nominal + moves @ (weights / weights.sum())
            std *= COOLING
        return progress.search()
