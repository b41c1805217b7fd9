"""Compiled filter and smoother for the whole path of one cell; see `cells.helix`."""

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
    """Predict the state and covariance of a cell at the time of an image.

    Args:
        m: State at the previous image, shape (n,), changed in place.
        p: Covariance at the previous image, shape (n, n), changed in place.
        total: Derivatives with respect to the previous state, changed in place. May be empty.
        model: Constants of the cell's model, shape (12,).
        pieces: Intervals of constant field, shape (P, 3): duration [s], and x and y of the field.
        first: Pieces first[k] to first[k + 1] precede image k.
        k: Index of the image.
    """
    i = first[k]
    end = first[k + 1]
    if i < end:
        forward(m, p, total, model, False, pieces[max(i - 1, 0)], pieces[i:end])


@compiled(**INLINE_EXACT)
def loosen(p, start, distant_count, distance):
    """Increase the uncertainty of a cell after several distant measurements in a row.

    Args:
        p: The covariance, changed in place: the variances of a new cell are added.
        start: Covariance of a new cell, shape (n, n).
        distant_count: Number of distant measurements in a row before the newest one.
        distance: Squared Mahalanobis distance of the newest measurement.

    Returns:
        The number of distant measurements in a row, or 0 if the uncertainty was increased.
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
    """Compute the log-likelihood of K measurements for each of V parameter variants of a cell.

    Args:
        mean: State of each variant at the first image, shape (V, n). Replaced by the state after
            the last image.
        start: Covariance at the first image, shape (n, n).
        models: Constants of each variant's model, shape (V, 12).
        measured: Measured x, y [um] and axis [rad] in each image, shape (K, 3). NaN if not
            measured.
        deviation: Standard deviations of the measurements, shape (K, 3).
        pieces: Intervals of constant field, shape (P, 3): duration [s], and x and y of the field.
        first: Pieces first[k] to first[k + 1] precede image k.
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

    After a forward pass of the filter, a backward pass uses Bierman's form of the smoother ("Fixed
    interval smoothing with discrete measurements", Int. J. Control 18, 1973), which inverts no
    covariance. In the code, `pull` is the adjoint state: how strongly later measurements pull at
    each state.

    Args:
        m: State at the first image, shape (n,). Replaced by the filtered state after the last
            image.
        start: Covariance at the first image, shape (n, n).
        model: Constants of the cell's model, shape (12,).
        measured: Measured x, y [um] and axis [rad] in each image, shape (K, 3). NaN if not
            measured.
        deviation: Standard deviations of the measurements, shape (K, 3).
        pieces: Intervals of constant field, shape (P, 3): duration [s], and x and y of the field.
        first: Pieces first[k] to first[k + 1] precede image k.
        means: Filled with the smoothed states, shape (K, n).
        bodies: Filled with x, y [um] and the axis [rad] of the body, shape (K, 3).

    Returns:
        The covariance of the filtered state after the last image, shape (n, n).
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
