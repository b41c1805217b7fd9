"""The compiled filter and smoother of one cell's whole path."""

import numpy as np

from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, INLINE_EXACT
from tetractl_microscope.cells.kernels.helix_steps import (
    ODD_DISTANCE,
    ODD_RUN,
    RATE,
    SLOWEST,
    STATES,
    WAY,
    correct,
    expect,
    forward,
    reverse,
)


@compiled(**INLINE_EXACT)
def arrive(m, p, total, model, pieces, first, k):
    """Move a cell's state and covariance to the next image.

    Args:
        m: The state, changed in place.
        p: The covariance, changed in place.
        total: Derivatives with respect to the state before.
        model: Numbers of the cell's model.
        pieces: Pieces of constant field, shape (P, 3).
        first: Pieces first[k] to first[k + 1] come before image k.
        k: Index of the image.
    """
    i = first[k]
    end = first[k + 1]
    if i < end:
        forward(m, p, total, model, False, pieces[max(i - 1, 0)], pieces[i:end])


@compiled(**INLINE_EXACT)
def loosen(p, start, distant_count, distance):
    """Make a cell's pose uncertain again after ODD_RUN distant measurements.

    Args:
        p: The covariance, to which the pose's variance of a new cell is added.
        start: Covariance of a new cell.
        distant_count: Number of distant measurements in a row so far.
        distance: Squared distance of the newest measurement.

    Returns:
        The number of distant measurements in a row.
    """
    distant_count = distant_count + 1 if distance > ODD_DISTANCE else 0
    if distant_count >= ODD_RUN:
        for state in range(RATE):
            p[state, state] += start[state, state]
        p[WAY, WAY] += start[0, 0]
        return 0
    return distant_count


@compiled(**ENTRY)
def likelihoods(mean, start, models, measured, deviation, pieces, first, totals):
    """Compute the log-likelihood of K images' measurements for V variants of a cell.

    Args:
        mean: State of each variant at the first image, shape (V, n). It is changed to that after
            the last image.
        start: Covariance at the first image, shape (n, n).
        models: Numbers of each variant's model, shape (V, 12).
        measured: The measurements, shape (K, 3).
        deviation: Their standard deviations, shape (K, 3).
        pieces: Pieces of constant field, shape (P, 3).
        first: Index of the first piece before each image.
        totals: Filled with the log-likelihoods, shape (V,).
    """
    h = np.empty((3, STATES))
    gain = np.empty((3, STATES))
    weighed = np.empty(3)
    none = np.empty((0, 0))
    for v in range(len(mean)):
        m = mean[v]
        p = start.copy()
        odd = 0
        totals[v] = 0.0
        for k in range(len(measured)):
            arrive(m, p, none, models[v], pieces, first, k)
            if np.isfinite(measured[k, 0]):
                likelihood, distance, _ = correct(
                    m, p, models[v], measured[k], deviation[k], h, gain, weighed
                )
                totals[v] += likelihood
                odd = loosen(p, start, odd, distance)


@compiled(**ENTRY)
def smooth(m, start, model, measured, deviation, pieces, first, means, bodies):
    """Estimate the states of a cell in K images, given the measurements in all images.

    It goes backwards in time with Bierman's form of the smoother ("Fixed interval smoothing with
    discrete measurements", Int. J. Control 18, 1973), which inverts no covariance: `pull` is how
    strongly later measurements pull at each state.

    Args:
        m: State at the first image. It is changed to that after the last image.
        start: Covariance at the first image, shape (n, n).
        model: Numbers of the cell's model.
        measured: The measurements, shape (K, 3).
        deviation: Their standard deviations, shape (K, 3).
        pieces: Pieces of constant field, shape (P, 3).
        first: Index of the first piece before each image.
        means: Filled with the states, shape (K, n).
        bodies: Filled with x, y and axis of the body, shape (K, 3).

    Returns:
        The covariance after the last image.
    """
    count = len(measured)
    p = start.copy()
    covariances = np.empty((count, STATES, STATES))
    totals = np.zeros((count, STATES, STATES))
    h = np.zeros((count, 3, STATES))
    gain = np.zeros((count, 3, STATES))
    weighed = np.zeros((count, 3))
    turned = np.zeros(count, np.bool_)
    odd = 0
    for k in range(count):
        for i in range(STATES):
            totals[k, i, i] = 1.0
        arrive(m, p, totals[k], model, pieces, first, k)
        is_measured = np.isfinite(measured[k, 0])
        distance = 0.0
        if is_measured:
            _, distance, turned[k] = correct(
                m, p, model, measured[k], deviation[k], h[k], gain[k], weighed[k]
            )
        means[k] = m
        covariances[k] = p
        if is_measured:
            odd = loosen(p, start, odd, distance)
    pull = np.zeros(STATES)
    before = np.empty(STATES)
    for k in range(count - 1, -1, -1):
        for i in range(STATES):
            for j in range(STATES):
                means[k, i] -= covariances[k, i, j] * pull[j]
        if turned[k]:
            reverse(pull)
        for i in range(2, -1, -1):
            weight = weighed[k, i]
            for j in range(STATES):
                weight += gain[k, i, j] * pull[j]
            for j in range(STATES):
                pull[j] -= h[k, i, j] * weight
        before[:] = 0.0
        for j in range(STATES):
            for i in range(STATES):
                before[i] += totals[k, j, i] * pull[j]
        pull[:] = before
        expect(means[k], model[SLOWEST], bodies[k], h[k])
    return p
