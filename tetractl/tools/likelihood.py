"""Maximise a likelihood with Newton steps, and compute the intervals that follow."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats

NORMAL = 1.96
"""Distance of either end of a 95 % interval from the value, in standard deviations."""
UNLIKELY = -1e12
"""Log-likelihood of variants for which it cannot be computed."""
DIFFERENCE = 0.1
"""Step of each parameter by which derivatives are approximated."""
STEP_MOST = 1.0
SHARES = np.array([0.0, 0.05, 0.2, 0.5, 1.0])
"""Fractions of a Newton step that are tried."""


@dataclass(frozen=True, slots=True)
class SampleInterval:
    """A value and its 95 % interval. An end is infinite if the data do not bound the value."""

    value: float
    low: float
    high: float


def newton_step(
    likelihood: Callable[[Floats], Floats], parameters: Floats, prior_std: float
) -> tuple[Floats, Floats]:
    """Improve parameters with a Newton step, and estimate their standard deviations.

    Derivatives are approximated by differences. Each parameter has a normal prior around 0.

    Args:
        likelihood: Returns the log-likelihood (N, V) for V variants of the parameters (N, V, P).
        parameters: The parameters, shape (N, P).
        prior_std: Standard deviation of the prior.

    Returns:
        Better parameters (N, P), and their standard deviations (N, P) from the curvature.
    """

    def score(changes: Floats) -> Floats:
        """Return ln of the posterior (N, V) after changes (N or 1, V, P) of the parameters.

        Where it is not finite, it is UNLIKELY.
        """
        tried = parameters[:, None] + changes
        scores = likelihood(tried) - np.square(tried).sum(axis=2) / (2 * prior_std**2)
        return np.where(np.isfinite(scores), scores, UNLIKELY)

    slope, curvature = derivatives(score, parameters.shape[1])
    value, vector = np.linalg.eigh(curvature)
    value = np.maximum(np.abs(value), prior_std**-2)  # a step uphill where the curve is hollow
    step = np.einsum("nij,nj,nkj,nk->ni", vector, 1 / value, vector, slope)
    step = np.clip(step, -STEP_MOST, STEP_MOST)
    best = score(SHARES[:, None] * step[:, None]).argmax(axis=1)
    std = np.sqrt(np.einsum("nij,nj->ni", vector**2, 1 / value))
    return parameters + SHARES[best][:, None] * step, std


def derivatives(score: Callable[[Floats], Floats], size: int) -> tuple[Floats, Floats]:
    """Compute the slope (N, P) and the negative curvature (N, P, P) of a score of P parameters.

    They are approximated by differences: each parameter is raised and lowered alone, and each pair
    of parameters is raised together.
    """
    raised = DIFFERENCE * np.eye(size)
    row, column = np.triu_indices(size, 1)
    changes = np.vstack([np.zeros(size), raised, -raised, raised[row] + raised[column]])
    scores = score(changes[None])
    base, up, down, two_up = np.split(scores, (1, 1 + size, 1 + 2 * size), axis=1)
    slope = (up - down) / (2 * DIFFERENCE)
    curvature = np.zeros((len(base), size, size))
    curvature[:, range(size), range(size)] = (2 * base - up - down) / DIFFERENCE**2
    mixed = (up[:, row] + up[:, column] - base - two_up) / DIFFERENCE**2
    curvature[:, row, column] = mixed
    curvature[:, column, row] = mixed
    return slope, curvature
