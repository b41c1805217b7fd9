"""The compiled filter and smoother of one cell's whole path."""

import numpy as np

from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY, INLINE_EXACT
from tetractl.lab.cameras.cells.kernels.helix_steps import (
    SLOWEST,
    STATES,
    correct,
    expect,
    move,
    reverse,
)


@compiled(**INLINE_EXACT)
def advance(m, p, total, model, measured, deviation, pieces, h, gain, weighed):
    """Move a cell's state m and covariance p over pieces (P, 3) to the next picture, and update
    them by its measurement (3,), if there is one; return ln of the likelihood, and whether the
    heading was reversed.
    """
    for i in range(len(pieces)):
        move(m, p, total, model, False, pieces[i])
    if not np.isfinite(measured[0]):
        return 0.0, False
    likelihood, _, wrong = correct(m, p, model, measured, deviation, h, gain, weighed)
    return likelihood, wrong


@compiled(**ENTRY)
def likelihoods(mean, start, models, measured, deviation, pieces, first, found):
    """Write ln of the likelihood (V,) of K pictures' measurements (K, 3) for V variants, each with
    a mean (V, n) at the first picture, where `start` (n, n) is the covariance, and a model (V, 12).
    Pieces `first[k]` to `first[k + 1]` of the field (P, 3) are before picture k. `mean` is that
    after the last picture at the end.
    """
    h, gain, weighed = np.empty((3, STATES)), np.empty((3, STATES)), np.empty(3)
    none = np.empty((0, 0))
    for v in range(len(mean)):
        p, found[v] = start.copy(), 0.0
        for k in range(len(measured)):
            given = measured[k], deviation[k], pieces[first[k] : first[k + 1]], h, gain, weighed
            found[v] += advance(mean[v], p, none, models[v], *given)[0]


@compiled(**ENTRY)
def smooth(m, start, model, measured, deviation, pieces, first, means, bodies):
    """Write the states (K, n) of K pictures given the measurements of all pictures, and the x, y
    and axis (K, 3) of the body in these; return the covariance after the last picture, where m is
    the state at the end.

    Backwards in time by Bierman's form of the smoother ("Fixed interval smoothing with discrete
    measurements", Int. J. Control 18, 1973), which inverts no covariance: `pull` is how
    strongly later measurements pull at each state.
    """
    count, p = len(measured), start.copy()
    covariances, totals = np.empty((count, STATES, STATES)), np.zeros((count, STATES, STATES))
    h, gain = np.zeros((count, 3, STATES)), np.zeros((count, 3, STATES))
    weighed, turned = np.zeros((count, 3)), np.zeros(count, np.bool_)
    for k in range(count):
        np.fill_diagonal(totals[k], 1.0)
        given = measured[k], deviation[k], pieces[first[k] : first[k + 1]], h[k], gain[k]
        _, turned[k] = advance(m, p, totals[k], model, *given, weighed[k])
        means[k], covariances[k] = m, p
    pull = np.zeros(STATES)
    for k in range(count - 1, -1, -1):
        means[k] -= covariances[k] @ pull
        if turned[k]:
            reverse(pull)
        for i in range(2, -1, -1):
            pull -= h[k, i] * (weighed[k, i] + gain[k, i] @ pull)
        pull = totals[k].T @ pull
        expect(means[k], model[SLOWEST], bodies[k], h[k])
    return p
