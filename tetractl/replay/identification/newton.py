"""One Newton step towards the greatest likelihood, for many robots or cells at once."""

from collections.abc import Callable

import numpy as np

from tetractl.core.poses import Floats

STEP, LONGEST = 0.1, 1.0  # steps of the parameters, for derivatives, and at most
SHARES = np.array([0.0, 0.05, 0.2, 0.5, 1.0])  # tried shares of a step


def newton_step(
    likelihood: Callable[[Floats], Floats], at: Floats, prior_std: float
) -> tuple[Floats, Floats]:
    """Return better parameters (N, P), and their standard deviations (N, P) by the curvature.

    `likelihood` returns its logarithm (N, V) for V variants of the parameters (N, V, P); each
    parameter has a normal prior around 0. Derivatives are differences.
    """

    def score(change: Floats) -> Floats:
        tried = at[:, None] + change
        return likelihood(tried) - np.square(tried).sum(axis=2) / (2 * prior_std**2)

    size = at.shape[1]
    one, (i, j) = STEP * np.eye(size), np.triu_indices(size, 1)
    found = score(np.vstack([np.zeros(size), one, -one, one[i] + one[j]])[None])
    base, up, down, both = np.split(found, (1, 1 + size, 1 + 2 * size), axis=1)
    bend = np.zeros((len(at), size, size))
    bend[:, range(size), range(size)] = (2 * base - up - down) / STEP**2
    bend[:, i, j] = bend[:, j, i] = (up[:, i] + up[:, j] - base - both) / STEP**2
    value, vector = np.linalg.eigh(bend)
    value = np.maximum(np.abs(value), prior_std**-2)  # a step uphill where the curve is hollow
    step = np.einsum("nij,nj,nkj,nk->ni", vector, 1 / value, vector, (up - down) / (2 * STEP))
    step = np.clip(step, -LONGEST, LONGEST)
    best = score(SHARES[:, None] * step[:, None]).argmax(axis=1)
    return at + SHARES[best][:, None] * step, np.sqrt(np.einsum("nij,nj->ni", vector**2, 1 / value))
