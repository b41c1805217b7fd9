"""The compiled filter and smoother of one cell's whole path."""

import numpy as np

from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY, INLINE_EXACT
from tetractl.lab.cameras.cells.kernels.helix_steps import STATES, correct, move, reverse, switch

LOOSE = 5.0, 5.0, 0.3, 120.0, 4.0, 4.0
"""Deviations of the first states that are added where a cell moves unexpectedly."""
ODD_RUN = 3  # successive blobs far from their expected positions that make the filter uncertain
ODD_DISTANCE = 30.0  # squared Mahalanobis distance above which a blob counts as far


@compiled(**ENTRY)
def forward(m, p, total, growth, turn_sd, pieces, first, k):
    """Move a cell's state m and covariance p to picture k."""
    for i in range(first[k], first[k + 1]):
        if i and (pieces[i, 1] != pieces[i - 1, 1] or pieces[i, 2] != pieces[i - 1, 2]):
            switch(m, p, total, pieces[i - 1, 1], pieces[i - 1, 2], pieces[i, 1], pieces[i, 2])
        move(m, p, total, growth, turn_sd, False, pieces[i, 0], pieces[i, 1], pieces[i, 2])


@compiled(**INLINE_EXACT)
def loosen(p, odd, distance):
    """Add to the covariance p after ODD_RUN far measurements; return how many were in a row."""
    odd = odd + 1 if distance > ODD_DISTANCE else 0
    if odd >= ODD_RUN:
        for state, deviation in enumerate(LOOSE):
            p[state, state] += deviation**2
        return 0
    return odd


@compiled(**ENTRY)
def likelihoods(
    mean, covariance, measured, deviation, pieces, first, growth, turn_sd, exact, found
):
    """Write ln of the likelihood (V, K) of K pictures' measurements (K, 3) for V variants.

    Each variant starts with `mean` (V, n) and `covariance` (n, n) at the first picture, and has
    its `growth` (V, 9), `turn_sd` (V,) and factor `exact` (V,) on the measurements' deviations
    (K, 3). Pieces `first[k]` to `first[k + 1]` of the field (P, 3) are before picture k.
    `mean` is that after the last picture at the end.
    """
    h, gain, weighed = np.empty((3, STATES)), np.empty((STATES, 3)), np.empty(3)
    none = np.empty((0, 0))
    for v in range(len(mean)):
        m, p, odd = mean[v], covariance.copy(), 0
        for k in range(len(measured)):
            forward(m, p, none, growth[v], turn_sd[v], pieces, first, k)
            found[v, k] = 0.0
            if np.isfinite(measured[k, 0]):
                noise = deviation[k] * exact[v]
                found[v, k], distance, _ = correct(m, p, measured[k], noise, h, gain, weighed)
                odd = loosen(p, odd, distance)


@compiled(**ENTRY)
def smooth(m, p, measured, deviation, pieces, first, growth, turn_sd, exact, means):
    """Write the states (K, n) of K pictures given the measurements of all pictures; m and p are the
    filter's state and covariance after the last picture at the end.

    Backwards in time by Bierman's form of the smoother ("Fixed interval smoothing with discrete
    measurements", Int. J. Control 18, 1973), which inverts no covariance: `pull` is how
    strongly later measurements pull at each state.
    """
    count = len(measured)
    covariances, totals = np.empty((count, STATES, STATES)), np.zeros((count, STATES, STATES))
    h, gain = np.zeros((count, 3, STATES)), np.zeros((count, STATES, 3))
    weighed, turned, odd = np.zeros((count, 3)), np.zeros(count, np.bool_), 0
    for k in range(count):
        for i in range(STATES):
            totals[k, i, i] = 1.0
        forward(m, p, totals[k], growth, turn_sd, pieces, first, k)
        distance = 0.0
        if np.isfinite(measured[k, 0]):
            noise = deviation[k] * exact
            _, distance, turned[k] = correct(m, p, measured[k], noise, h[k], gain[k], weighed[k])
        means[k], covariances[k] = m, p
        if np.isfinite(measured[k, 0]):
            odd = loosen(p, odd, distance)
    pull, before = np.zeros(STATES), np.empty(STATES)
    for k in range(count - 1, -1, -1):
        for i in range(STATES):
            for j in range(STATES):
                means[k, i] -= covariances[k, i, j] * pull[j]
        if turned[k]:
            reverse(pull)
        for i in range(3):
            known = weighed[k, i]
            for j in range(STATES):
                known += gain[k, j, i] * pull[j]
            weighed[k, i] = known
        for j in range(STATES):
            for i in range(3):
                pull[j] -= h[k, i, j] * weighed[k, i]
        before[:] = 0.0
        for j in range(STATES):
            for i in range(STATES):
                before[i] += totals[k, j, i] * pull[j]
        pull[:] = before
