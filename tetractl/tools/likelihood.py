"""Maximise a likelihood with Newton steps, and compute standard deviations and intervals."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats

Z_95 = 1.96
"""Half the width of a 95 % interval of a normal distribution, in standard deviations."""
LOG_LIKELIHOOD_MIN = -1e12
"""Log-likelihood of parameters for which no finite likelihood can be computed."""
DIFFERENCE_STEP = 0.1
"""Step of each parameter with which derivatives are approximated."""
STEP_MAX = 1.0
"""Maximum change of a parameter in a Newton step."""
STEP_FRACTIONS = np.array([0.0, 0.05, 0.2, 0.5, 1.0])
"""Fractions of a Newton step that are tried."""


@dataclass(frozen=True, slots=True)
class SampleInterval:
    """An estimated value with its 95 % interval.

    Attributes:
        value: The estimated value.
        low: Lower end of the interval. -inf if the data do not bound the value from below.
        high: Upper end of the interval. inf if the data do not bound the value from above.
    """

    value: float
    low: float
    high: float


def newton_step(
    likelihood: Callable[[Floats], Floats], parameters: Floats, prior_std: float
) -> tuple[Floats, Floats]:
    """Improve parameters with a Newton step, and estimate their standard deviations.

    Derivatives are approximated by differences. Each parameter has a normal prior around 0.

    Args:
        likelihood: Function that returns the log-likelihood (N, V) for V variants of the parameters
            (N, V, P).
        parameters: The parameters, shape (N, P).
        prior_std: Standard deviation of the prior.

    Returns:
        Better parameters (N, P), and their standard deviations (N, P) from the curvature.
    """

    def score(changes: Floats) -> Floats:
        """Compute ln of the posterior (N, V) after changes (N or 1, V, P) of the parameters.

        Where the result is not finite, it is LOG_LIKELIHOOD_MIN.
        """
        tried = parameters[:, None] + changes
        scores = likelihood(tried) - np.square(tried).sum(axis=2) / (2 * prior_std**2)
        return np.where(np.isfinite(scores), scores, LOG_LIKELIHOOD_MIN)

    slope, curvature = derivatives(score, parameters.shape[1])
    eigenvalues, eigenvectors = np.linalg.eigh(curvature)
    # a step uphill where the curve is hollow
    eigenvalues = np.maximum(np.abs(eigenvalues), prior_std**-2)
    step = np.einsum("nij,nj,nkj,nk->ni", eigenvectors, 1 / eigenvalues, eigenvectors, slope)
    step = np.clip(step, -STEP_MAX, STEP_MAX)
    best_index = score(STEP_FRACTIONS[:, None] * step[:, None]).argmax(axis=1)
    std = np.sqrt(np.einsum("nij,nj->ni", eigenvectors**2, 1 / eigenvalues))
    return parameters + STEP_FRACTIONS[best_index][:, None] * step, std


def derivatives(score: Callable[[Floats], Floats], parameter_count: int) -> tuple[Floats, Floats]:
    """Approximate the slope and the negative curvature of a score by differences.

    Each parameter is raised and lowered alone, and each pair of parameters is raised together.

    Args:
        score: Function that returns the score (N, V) after changes (1, V, P) of P parameters.
        parameter_count: The number P of parameters.

    Returns:
        The slope, shape (N, P), and the negative curvature, shape (N, P, P).
    """
    steps = DIFFERENCE_STEP * np.eye(parameter_count)
    row, column = np.triu_indices(parameter_count, 1)
    changes = np.vstack([np.zeros(parameter_count), steps, -steps, steps[row] + steps[column]])
    scores = score(changes[None])
    base_score, raised_scores, lowered_scores, pair_scores = np.split(
        scores, (1, 1 + parameter_count, 1 + 2 * parameter_count), axis=1
    )
    slope = (raised_scores - lowered_scores) / (2 * DIFFERENCE_STEP)
    curvature = np.zeros((len(base_score), parameter_count, parameter_count))
    curvature[:, range(parameter_count), range(parameter_count)] = (
        2 * base_score - raised_scores - lowered_scores
    ) / DIFFERENCE_STEP**2
    mixed_curvature = (
        raised_scores[:, row] + raised_scores[:, column] - base_score - pair_scores
    ) / DIFFERENCE_STEP**2
    curvature[:, row, column] = mixed_curvature
    curvature[:, column, row] = mixed_curvature
    return slope, curvature
