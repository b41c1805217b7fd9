"""Model predictive path integral control: the mean of noisy sequences, weighted by their cost.

Source: Williams, Aldrich and Theodorou, "Model predictive path integral control: from theory to
parallel computation", Journal of Guidance, Control, and Dynamics 40 (2017), algorithm 2.

After each iteration (`tetractl.control.optimizers.sampling`), the mean becomes that of the samples
under the weights of a Boltzmann distribution of the cost, and the noise falls:

    w_p = exp(-(J_p - min J) / lambda) / sum_q exp(-(J_q - min J) / lambda)
    m  <- sum_p w_p x_p,     s <- cooling s

The temperature lambda is `temperature`, which has no unit, times the standard deviation of the
iteration's costs.
"""

from typing import ClassVar, Literal

import numpy as np

from tetractl.control.optimizers.sampling import SamplingOptimizer
from tetractl.core.poses import Floats

NOT_ZERO = 1e-300
"""Added to lambda, so that equal costs give equal weights [length unit]."""


class Mppi(SamplingOptimizer):
    """Model predictive path integral control of Williams et al., iterated with falling noise."""

    type: Literal["mppi"] = "mppi"

    temperature: ClassVar[float] = 0.02
    """Temperature lambda, in units of the standard deviation of the iteration's costs."""
    cooling: ClassVar[float] = 0.97
    """Factor by which s is multiplied after each iteration."""

    def updated(
        self, mean: Floats, std: Floats, samples: Floats, costs: Floats
    ) -> tuple[Floats, Floats]:
        """Return the weighted mean of the samples, and a smaller standard deviation."""
        temperature = self.temperature * costs.std() + NOT_ZERO
        weights = np.exp((costs.min() - costs) / temperature)
        weights /= weights.sum()
        return (samples @ weights)[:, None], std * self.cooling
