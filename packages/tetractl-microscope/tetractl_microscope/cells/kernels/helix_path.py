"""Compiled filter and smoother for the whole path of one cell; see `cells.helix`."""

import numpy as np

from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, INLINE_EXACT
from tetractl_microscope.cells.kernels.helix_steps import (
    DISTANT_COUNT,
    DISTANT_SQUARED,
    PATH_LENGTH,
    RATE,
    SPEED_MIN,
    STATE_SIZE,
    correct_state,
    predict_body,
    predict_pieces,
    swap_ends,
)


@compiled(**INLINE_EXACT)
def predict_image(state, covariance, sensitivity, model, pieces, piece_starts, k):
    """Predict the state and covariance of a cell at the time of an image.

    Args:
        state: State at the previous image, shape (n,), changed in place.
        covariance: Covariance at the previous image, shape (n, n), changed in place.
        sensitivity: Derivatives with respect to the previous state, changed in place. May be empty.
        model: Constants of the cell's model, shape (12,).
        pieces: Intervals of constant field, shape (P, 3): duration [s], and x and y of the field.
        piece_starts: Pieces piece_starts[k] to piece_starts[k + 1] precede image k.
        k: Index of the image.
    """
    start = piece_starts[k]
    end = piece_starts[k + 1]
    if start < end:
        predict_pieces(
            state,
            covariance,
            sensitivity,
            model,
            False,
            pieces[max(start - 1, 0)],
            pieces[start:end],
        )


@compiled(**INLINE_EXACT)
def widen_if_distant(covariance, new_covariance, distant_count, squared_distance):
    """Increase the uncertainty of a cell after several distant measurements in a row.

    Args:
        covariance: The covariance, changed in place: the variances of a new cell are added.
        new_covariance: Covariance of a new cell, shape (n, n).
        distant_count: Number of distant measurements in a row before the newest one.
        squared_distance: Squared Mahalanobis distance of the newest measurement.

    Returns:
        The number of distant measurements in a row, or 0 if the uncertainty was increased.
    """
    distant_count = distant_count + 1 if squared_distance > DISTANT_SQUARED else 0
    if distant_count >= DISTANT_COUNT:
        for i in range(RATE):
            covariance[i, i] += new_covariance[i, i]
        covariance[PATH_LENGTH, PATH_LENGTH] += new_covariance[0, 0]
        return 0
    return distant_count


@compiled(**ENTRY)
def log_likelihoods_of(
    states, start_covariance, models, measured, measured_sd, pieces, piece_starts, log_likelihoods
):
    """Compute the log-likelihood of K measurements for each of V parameter variants of a cell.

    Args:
        states: State of each variant at the first image, shape (V, n). Replaced by the state after
            the last image.
        start_covariance: Covariance at the first image, shape (n, n).
        models: Constants of each variant's model, shape (V, 12).
        measured: Measured x, y [um] and axis [rad] in each image, shape (K, 3). NaN if not
            measured.
        measured_sd: Standard deviations of the measurements, shape (K, 3).
        pieces: Intervals of constant field, shape (P, 3): duration [s], and x and y of the field.
        piece_starts: Pieces piece_starts[k] to piece_starts[k + 1] precede image k.
        log_likelihoods: Filled with the log-likelihoods, shape (V,).
    """
    jacobian = np.empty((3, STATE_SIZE))
    gain = np.empty((3, STATE_SIZE))
    weighted_innovation = np.empty(3)
    no_sensitivity = np.empty((0, 0))
    for v in range(len(states)):
        state = states[v]
        covariance = start_covariance.copy()
        distant_count = 0
        log_likelihoods[v] = 0.0
        for k in range(len(measured)):
            predict_image(state, covariance, no_sensitivity, models[v], pieces, piece_starts, k)
            if np.isfinite(measured[k, 0]):
                log_likelihood, squared_distance, _ = correct_state(
                    state,
                    covariance,
                    models[v],
                    measured[k],
                    measured_sd[k],
                    jacobian,
                    gain,
                    weighted_innovation,
                )
                log_likelihoods[v] += log_likelihood
                distant_count = widen_if_distant(
                    covariance, start_covariance, distant_count, squared_distance
                )


@compiled(**ENTRY)
def smooth(
    state, start_covariance, model, measured, measured_sd, pieces, piece_starts, smoothed, bodies
):
    """Estimate the states of a cell in K images, given the measurements in all images.

    After a forward pass of the filter, a backward pass uses Bierman's form of the smoother ("Fixed
    interval smoothing with discrete measurements", Int. J. Control 18, 1973), which inverts no
    covariance. In the code, `adjoint` is the adjoint state: how strongly later measurements pull at
    each state.

    Args:
        state: State at the first image, shape (n,). Replaced by the filtered state after the last
            image.
        start_covariance: Covariance at the first image, shape (n, n).
        model: Constants of the cell's model, shape (12,).
        measured: Measured x, y [um] and axis [rad] in each image, shape (K, 3). NaN if not
            measured.
        measured_sd: Standard deviations of the measurements, shape (K, 3).
        pieces: Intervals of constant field, shape (P, 3): duration [s], and x and y of the field.
        piece_starts: Pieces piece_starts[k] to piece_starts[k + 1] precede image k.
        smoothed: Filled with the smoothed states, shape (K, n).
        bodies: Filled with x, y [um] and the axis [rad] of the body, shape (K, 3).

    Returns:
        The covariance of the filtered state after the last image, shape (n, n).
    """
    n_images = len(measured)
    covariance = start_covariance.copy()
    covariances = np.empty((n_images, STATE_SIZE, STATE_SIZE))
    sensitivities = np.zeros((n_images, STATE_SIZE, STATE_SIZE))
    jacobians = np.zeros((n_images, 3, STATE_SIZE))
    gains = np.zeros((n_images, 3, STATE_SIZE))
    weighted_innovations = np.zeros((n_images, 3))
    is_turned = np.zeros(n_images, np.bool_)
    distant_count = 0
    for k in range(n_images):
        for i in range(STATE_SIZE):
            sensitivities[k, i, i] = 1.0
        predict_image(state, covariance, sensitivities[k], model, pieces, piece_starts, k)
        is_measured = np.isfinite(measured[k, 0])
        squared_distance = 0.0
        if is_measured:
            _, squared_distance, is_turned[k] = correct_state(
                state,
                covariance,
                model,
                measured[k],
                measured_sd[k],
                jacobians[k],
                gains[k],
                weighted_innovations[k],
            )
        smoothed[k] = state
        covariances[k] = covariance
        if is_measured:
            distant_count = widen_if_distant(
                covariance, start_covariance, distant_count, squared_distance
            )
    adjoint = np.zeros(STATE_SIZE)
    adjoint_before = np.empty(STATE_SIZE)
    for k in range(n_images - 1, -1, -1):
        for i in range(STATE_SIZE):
            for j in range(STATE_SIZE):
                smoothed[k, i] -= covariances[k, i, j] * adjoint[j]
        if is_turned[k]:
            swap_ends(adjoint)
        for i in range(2, -1, -1):
            component_weight = weighted_innovations[k, i]
            for j in range(STATE_SIZE):
                component_weight += gains[k, i, j] * adjoint[j]
            for j in range(STATE_SIZE):
                adjoint[j] -= jacobians[k, i, j] * component_weight
        adjoint_before[:] = 0.0
        for j in range(STATE_SIZE):
            for i in range(STATE_SIZE):
                adjoint_before[i] += sensitivities[k, j, i] * adjoint[j]
        adjoint[:] = adjoint_before
        predict_body(smoothed[k], model[SPEED_MIN], bodies[k], jacobians[k])
    return covariance
