"""The cross-entropy method: repeatedly fits a normal distribution to its best samples.

Source: de Boer, Kroese, Mannor and Rubinstein, "A tutorial on the cross-entropy method", Annals of
Operations Research 134 (2005), section 3 (continuous optimisation, with smoothed updates).

After each iteration (`tetractl.control.optimizers.sampling`), the E samples with the least J, the
elite, attract the distribution:

    m <- (1 - alpha) m + alpha mean(elite),     s <- (1 - alpha) s + alpha std(elite)

From m = 0 and s = spread the distribution contracts around a minimum of J.
"""

from typing import ClassVar, Literal

import numpy as np

from tetractl.control.optimizers.sampling import SamplingOptimizer
from tetractl.core.poses import Floats
from tetractl.experiment.base import defaults


@defaults(particles=256, iterations=80, knots=24, spread=3.0)
class CrossEntropy(SamplingOptimizer):
    """The cross-entropy method of Rubinstein and Kroese over the knots of smooth sequences."""

    type: Literal["cem"] = "cem"
    elite_share: ClassVar[float] = 1 / 16
    """Best fraction of an iteration's samples, E / P, towards which the distribution is moved."""
    smoothing: ClassVar[float] = 0.4
    """Weight alpha of the elite when the distribution is updated."""

    def updated(
        self, mean: Floats, std: Floats, samples: Floats, costs: Floats
    ) -> tuple[Floats, Floats]:
        """Return mean and standard deviation, moved towards those of the elite."""
        count = max(1, int(self.elite_share * costs.size))
        cheapest = np.argsort(costs, kind="stable")[:count]
        elite = samples[:, cheapest]
        elite_mean = elite.mean(axis=1, keepdims=True)
        elite_std = elite.std(axis=1, keepdims=True)
        mean = mean + self.smoothing * (elite_mean - mean)
        std = std + self.smoothing * (elite_std - std)
        return mean, std
