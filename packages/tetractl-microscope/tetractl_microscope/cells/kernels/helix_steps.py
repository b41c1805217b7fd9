"""Compiled kernels of the extended Kalman filter in `cells.helix`, for one cell.

The time update predicts the state and its covariance over intervals with a constant field. The
measurement update corrects both with the observed body. `tests/testkit/microscope/helix_steps.py`
is a reference implementation with whole matrices.

In this module, a *piece* is an interval with a constant field: its duration [s] and the x and y
components of the field, relative to the reference field, shape (3,). n is STATE_SIZE. The states
are explained in `cells.helix`.
"""

import math

import numpy as np

from tetractl.model.motion import swimming
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, INLINE_EXACT, exact

X, Y, HEADING, SPEED, C, S, RATE, A, BIAS, TURN, FLOW_X, FLOW_Y, DELAY, PATH_LENGTH, SWAY, LEAD = (
    range(16)
)
STATE_SIZE = 16
# Indices of the constants in a `model` (12,). At the indices X to BIAS, it has the growth of that
# state's standard deviation per sqrt(s). At TURN, it has the standard deviation of that state.
DEVIATION_SCALE = 10  # factor by which the given standard deviations of measurements are multiplied
SPEED_MIN = 11  # speed below which a cell rests [um/s]: its helix then does not show its axis
MODEL_SIZE = 12

# Additional growth of standard deviations per sqrt(s). A resting cell may go on in any direction.
RESTING_HEADING_GROWTH = 0.5  # of the heading of a resting cell [rad]
RESTING_SPEED_GROWTH = 2.5  # of the speed of a resting cell [model[SPEED_MIN]]
WALL_HEADING_GROWTH = 1.0  # of the heading of a cell near a wall [rad]
HELIX_S = 5.0  # time constant with which c and s decay, so that a helix stays small
TURN_S = 0.5  # time constant with which unexplained turning decays
STEP_MAX_S = 0.04  # maximum duration of a step of the prediction
STEPS_MAX = 10_000  # maximum number of steps of a piece: beyond 400 s, the steps are longer
STUDENT_DOF = 8.0  # degrees of freedom of Student's t distribution, for which outliers cost little
# Maximum squared deviation, in variances, of a measurement that gets its full weight.
FULL_WEIGHT_MAX = 9.0
# A measurement is distant above this squared Mahalanobis distance. After DISTANT_COUNT distant
# measurements in a row, the filter's uncertainty is increased.
DISTANT_SQUARED = 30.0
DISTANT_COUNT = 3


torque = exact(swimming.torque)


@compiled(**ENTRY)
def propagate(jacobian, covariance, sensitivity):
    """Propagate a covariance P and derivatives D through a step with the Jacobian F.

    P becomes F P F', and D becomes F D.

    Args:
        jacobian: F, shape (n, n). It differs from the unit matrix in only a few entries, and its
            zeros are skipped.
        covariance: P, shape (n, n), changed in place.
        sensitivity: D, the derivatives of the state with respect to the initial state, shape
            (n, n), changed in place. Empty if they are not needed.
    """
    size = len(jacobian)
    left_product = np.zeros((size, size))
    new_sensitivity = np.zeros(sensitivity.shape)
    for i in range(size):
        for k in range(size):
            if jacobian[i, k] != 0.0:
                for j in range(size):
                    left_product[i, j] += jacobian[i, k] * covariance[k, j]
                for j in range(len(sensitivity)):
                    new_sensitivity[i, j] += jacobian[i, k] * sensitivity[k, j]
    covariance[:] = 0.0
    for i in range(size):
        for k in range(size):
            if jacobian[i, k] != 0.0:
                for j in range(size):
                    covariance[j, i] += left_product[j, k] * jacobian[i, k]
    sensitivity[:] = new_sensitivity


@compiled(**ENTRY)
def respond_late(state, covariance, sensitivity, is_resting, old_piece, new_piece):
    """Account for the delay with which a cell responds to a change of the field.

    During the time given by the state DELAY, the cell still turns in the old field. Its heading is
    changed by the difference between turning in the old field and turning in the new field.

    Args:
        state: The state, shape (n,), changed in place.
        covariance: The covariance, shape (n, n), changed in place.
        sensitivity: Derivatives with respect to the initial state, shape (n, n), changed in place.
        is_resting: Whether the cell rests.
        old_piece: The piece with the old field, shape (3,).
        new_piece: The piece with the new field, shape (3,).
    """
    turning_rate = 0.0 if is_resting else state[A]
    old_torque, old_slope = torque(state[HEADING] + state[BIAS], old_piece[1], old_piece[2])
    new_torque, new_slope = torque(state[HEADING] + state[BIAS], new_piece[1], new_piece[2])
    jacobian = np.eye(STATE_SIZE)
    slope_change = state[DELAY] * turning_rate * (old_slope - new_slope)
    jacobian[HEADING, HEADING] += slope_change
    jacobian[HEADING, BIAS] = slope_change
    jacobian[HEADING, A] = 0.0 if is_resting else state[DELAY] * (old_torque - new_torque)
    jacobian[HEADING, DELAY] = turning_rate * (old_torque - new_torque)
    state[HEADING] += state[DELAY] * turning_rate * (old_torque - new_torque)
    propagate(jacobian, covariance, sensitivity)


@compiled(**INLINE_EXACT)
def add_process_noise(covariance, model, is_resting, is_near_wall, duration_s):
    """Add the process noise of a time interval to a covariance.

    The process noise is larger for a cell that rests, and for a cell near a wall.

    Args:
        covariance: The covariance, shape (n, n), changed in place.
        model: Constants of the cell's model, shape (12,).
        is_resting: Whether the cell rests.
        is_near_wall: Whether the cell is near a wall.
        duration_s: Length of the interval [s].
    """
    for i in range(BIAS + 1):
        covariance[i, i] += model[i] ** 2 * duration_s
    covariance[PATH_LENGTH, PATH_LENGTH] += model[X] ** 2 * duration_s
    if is_resting:
        covariance[HEADING, HEADING] += RESTING_HEADING_GROWTH**2 * duration_s
        covariance[SPEED, SPEED] += (RESTING_SPEED_GROWTH * model[SPEED_MIN]) ** 2 * duration_s
    if is_near_wall:
        covariance[HEADING, HEADING] += WALL_HEADING_GROWTH**2 * duration_s


@compiled(**ENTRY)
def predict_step(state, covariance, sensitivity, model, is_near_wall, field_piece):
    """Predict the state and covariance of a cell after one step in a constant field.

    The prediction is of second order in the error of the heading: on average, a cell with an
    uncertain heading advances and turns less than a cell whose heading is known, by the factors
    `advance_factor` and `turning_factor`. Half of the process noise is added before the motion and
    half after it, because a random change of the heading also changes the path.

    Args:
        state: The state, shape (n,), changed in place.
        covariance: The covariance, shape (n, n), changed in place.
        sensitivity: Derivatives with respect to the initial state, shape (n, n), changed in place.
        model: Constants of the cell's model, shape (12,).
        is_near_wall: Whether the cell is near a wall. If so, its turning does not change the
            estimate of a.
        field_piece: Duration [s], and x and y of the field, shape (3,).
    """
    duration_s, field_x, field_y = field_piece
    half_s = duration_s / 2
    is_resting = state[SPEED] < model[SPEED_MIN]
    add_process_noise(covariance, model, is_resting, is_near_wall, half_s)
    advance_factor = math.exp(-covariance[HEADING, HEADING] / 2)
    turning_factor = math.exp(
        -(covariance[HEADING, HEADING] + 2 * covariance[HEADING, BIAS] + covariance[BIAS, BIAS]) / 2
    )
    turning_rate = 0.0 if is_resting else state[A] * turning_factor
    torque_start, slope_start = torque(state[HEADING] + state[BIAS], field_x, field_y)
    mid_heading = state[HEADING] + (turning_rate * torque_start + state[TURN]) * half_s
    torque_mid, slope_mid = torque(mid_heading + state[BIAS], field_x, field_y)
    turn_slope_start = turning_rate * slope_start
    turn_slope_mid = turning_rate * slope_mid
    # derivatives of the heading in the middle of the step, along which the cell moves, and direct
    # derivatives of the rate of turning there
    response_factor = 0.0 if is_near_wall or is_resting else turning_factor
    jacobian = np.eye(STATE_SIZE)
    advance_x = advance_factor * math.cos(mid_heading)
    advance_y = advance_factor * math.sin(mid_heading)
    bias_slope_mid = turn_slope_start * half_s if response_factor else 0.0
    bias_slope_end = turn_slope_mid if response_factor else 0.0
    for i, mid_slope, end_slope in (
        (HEADING, 1 + turn_slope_start * half_s, 0.0),
        (A, response_factor * torque_start * half_s, response_factor * torque_mid),
        (BIAS, bias_slope_mid, bias_slope_end),
        (TURN, half_s, 1.0),
    ):
        jacobian[X, i] = -state[SPEED] * advance_y * duration_s * mid_slope
        jacobian[Y, i] = state[SPEED] * advance_x * duration_s * mid_slope
        jacobian[HEADING, i] += duration_s * (end_slope + turn_slope_mid * mid_slope)
    jacobian[X, SPEED] = advance_x * duration_s
    jacobian[Y, SPEED] = advance_y * duration_s
    jacobian[X, FLOW_X] = jacobian[Y, FLOW_Y] = jacobian[PATH_LENGTH, SPEED] = duration_s
    helix_angle = state[RATE] * duration_s
    helix_decay = math.exp(-duration_s / HELIX_S)
    turn_decay = math.exp(-duration_s / TURN_S)
    rotation_cos = helix_decay * math.cos(helix_angle)
    rotation_sin = helix_decay * math.sin(helix_angle)
    c = state[C] * rotation_cos - state[S] * rotation_sin
    s = state[C] * rotation_sin + state[S] * rotation_cos
    jacobian[C, C] = rotation_cos
    jacobian[C, S] = -rotation_sin
    jacobian[C, RATE] = -s * duration_s
    jacobian[S, C] = rotation_sin
    jacobian[S, S] = rotation_cos
    jacobian[S, RATE] = c * duration_s
    jacobian[TURN, TURN] = turn_decay
    state[X] += (state[SPEED] * advance_x + state[FLOW_X]) * duration_s
    state[Y] += (state[SPEED] * advance_y + state[FLOW_Y]) * duration_s
    state[HEADING] += (turning_rate * torque_mid + state[TURN]) * duration_s
    state[C] = c
    state[S] = s
    state[TURN] *= turn_decay
    state[PATH_LENGTH] += state[SPEED] * duration_s
    propagate(jacobian, covariance, sensitivity)
    add_process_noise(covariance, model, is_resting, is_near_wall, half_s)
    covariance[TURN, TURN] += model[TURN] ** 2 * (1 - turn_decay**2)


@compiled(**ENTRY)
def predict_pieces(state, covariance, sensitivity, model, is_near_wall, piece_before, pieces):
    """Predict the state and covariance of a cell over successive pieces of constant field.

    A long piece is divided into steps of at most STEP_MAX_S, because the path of a cell that turns
    by a radian or more cannot be computed from its two ends.

    Args:
        state: The state, shape (n,), changed in place.
        covariance: The covariance, shape (n, n), changed in place.
        sensitivity: Derivatives with respect to the initial state, shape (n, n), changed in place.
            Empty if they are not needed.
        model: Constants of the cell's model, shape (12,).
        is_near_wall: Whether the cell is near a wall.
        piece_before: The piece before the first one, shape (3,).
        pieces: The pieces, shape (P, 3): duration [s], and x and y of the field.
    """
    step_piece = np.empty(3)
    for i in range(len(pieces)):
        previous_piece = pieces[i - 1] if i else piece_before
        if not is_near_wall and (
            pieces[i, 1] != previous_piece[1] or pieces[i, 2] != previous_piece[2]
        ):
            respond_late(
                state,
                covariance,
                sensitivity,
                state[SPEED] < model[SPEED_MIN],
                previous_piece,
                pieces[i],
            )
        n_steps = max(1, math.ceil(min(pieces[i, 0] / STEP_MAX_S, STEPS_MAX)))
        step_piece[:] = pieces[i]
        step_piece[0] /= n_steps
        for _ in range(n_steps):
            predict_step(state, covariance, sensitivity, model, is_near_wall, step_piece)


@compiled(**ENTRY)
def predict_body(state, speed_min, body, jacobian):
    """Predict where a cell's body is measured, with the derivatives of this prediction.

    Args:
        state: The state, shape (n,).
        speed_min: Speed below which a cell of this organism rests [um/s].
        body: Filled with x, y [um] and the axis [rad] of the body, shape (3,).
        jacobian: Filled with their derivatives with respect to the state, shape (3, n).
    """
    cos = math.cos(state[HEADING])
    sin = math.sin(state[HEADING])
    speed = max(state[SPEED], speed_min)
    swing = state[SWAY] * state[S] + state[LEAD] * state[C]
    sideways_speed = state[RATE] * swing
    angle_slope = -speed / (speed**2 + sideways_speed**2)
    body[0] = state[X] - state[C] * sin
    body[1] = state[Y] + state[C] * cos
    body[2] = state[HEADING] - math.atan2(sideways_speed, speed)
    jacobian[:] = 0.0
    jacobian[0, X] = jacobian[1, Y] = jacobian[2, HEADING] = 1.0
    jacobian[0, HEADING] = -state[C] * cos
    jacobian[1, HEADING] = -state[C] * sin
    jacobian[2, RATE] = angle_slope * swing
    jacobian[0, C] = -sin
    jacobian[1, C] = cos
    jacobian[2, C] = angle_slope * state[RATE] * state[LEAD]
    jacobian[2, S] = angle_slope * state[RATE] * state[SWAY]
    jacobian[2, SWAY] = angle_slope * state[RATE] * state[S]
    jacobian[2, LEAD] = angle_slope * state[RATE] * state[C]
    jacobian[2, SPEED] = -angle_slope * sideways_speed / speed if state[SPEED] > speed_min else 0.0


@compiled(**ENTRY)
def correct_state(
    state, covariance, model, measured, measured_sd, jacobian, gain, weighted_innovation
):
    """Update the state and covariance of a cell with one measurement of its body.

    The three components are processed one after another. A component far from its prediction gets
    less weight, so an outlier changes the estimate only a little. If the speed becomes clearly
    negative, the cell is turned around: its heading pointed to the wrong end of the axis.

    Args:
        state: The state, shape (n,), changed in place.
        covariance: The covariance, shape (n, n), changed in place.
        model: Constants of the cell's model, shape (12,).
        measured: Measured x, y [um] and axis [rad], shape (3,).
        measured_sd: Standard deviations of the measurement, shape (3,).
        jacobian: Filled with the derivatives of the prediction, shape (3, n).
        gain: Filled with the Kalman gains, shape (3, n).
        weighted_innovation: Filled with the innovations divided by their variances, shape (3,).

    Returns:
        The log-likelihood under Student's t distribution, the squared Mahalanobis distance from the
        prediction, and whether the cell was turned around.
    """
    innovation = np.empty(3)
    correction = np.zeros(STATE_SIZE)
    squared_distance = 0.0
    log_variances = 0.0
    predict_body(state, model[SPEED_MIN], innovation, jacobian)
    for i in range(3):
        innovation[i] = measured[i] - innovation[i]
        if i == 2:
            innovation[i] = (innovation[i] + math.pi / 2) % math.pi - math.pi / 2
        variance = (model[DEVIATION_SCALE] * measured_sd[i]) ** 2
        for j in range(STATE_SIZE):
            innovation[i] -= jacobian[i, j] * correction[j]
            gain[i, j] = 0.0
            for k in range(STATE_SIZE):
                gain[i, j] += covariance[j, k] * jacobian[i, k]
        for j in range(STATE_SIZE):
            variance += jacobian[i, j] * gain[i, j]
        squared_deviation = innovation[i] ** 2 / variance
        squared_distance += squared_deviation
        log_variances += math.log(variance)
        variance *= max(squared_deviation / FULL_WEIGHT_MAX, 1.0)
        weighted_innovation[i] = innovation[i] / variance
        for j in range(STATE_SIZE):
            correction[j] += gain[i, j] * weighted_innovation[i]
            for k in range(j + 1):
                covariance[j, k] = covariance[k, j] = (
                    covariance[j, k] - gain[i, j] * gain[i, k] / variance
                )
        for j in range(STATE_SIZE):
            gain[i, j] /= variance
    for j in range(STATE_SIZE):
        state[j] += correction[j]
    is_backwards = state[SPEED] < -model[SPEED_MIN]
    if is_backwards:  # the heading points to the wrong end of the axis
        state[HEADING] += math.pi
        swap_ends(state)
        for j in range(STATE_SIZE):
            swap_ends(covariance[j])
        for j in range(STATE_SIZE):
            swap_ends(covariance[:, j])
    return (
        -(STUDENT_DOF + 3) / 2 * math.log1p(squared_distance / STUDENT_DOF) - log_variances / 2,
        squared_distance,
        is_backwards,
    )


@compiled(**INLINE_EXACT)
def swap_ends(values):
    """Change the signs of the states (n,) that depend on which end of the cell is its front."""
    for i in (SPEED, C, S):
        values[i] = -values[i]


@compiled(**ENTRY)
def predict(states, covariances, is_used, model, is_near_wall, piece_before, pieces):
    """Run the time update of the Kalman filter for every cell.

    Args:
        states: States of R cells, shape (R, n), changed in place.
        covariances: Covariances, shape (R, n, n), changed in place.
        is_used: Whether each row holds a cell, shape (R,). The other rows are not changed.
        model: Constants of the cells' model, shape (12,).
        is_near_wall: Whether each cell is near a wall, shape (R,).
        piece_before: The piece of constant field before the first one, shape (3,).
        pieces: Successive pieces of constant field, shape (P, 3): duration [s], and x and y of the
            field relative to the reference field.
    """
    no_sensitivity = np.empty((0, 0))
    for row in range(len(is_used)):
        if is_used[row]:
            predict_pieces(
                states[row],
                covariances[row],
                no_sensitivity,
                model,
                is_near_wall[row],
                piece_before,
                pieces,
            )


@compiled(**ENTRY)
def update(
    states, covariances, rows, model, measured, measured_sd, log_likelihoods, squared_distances
):
    """Run the measurement update of the Kalman filter for some of the cells.

    Args:
        states: States of R cells, shape (R, n), changed in place.
        covariances: Covariances, shape (R, n, n), changed in place.
        rows: Rows of the measured cells, shape (M,).
        model: Constants of the cells' model, shape (12,).
        measured: Measured x, y [um] and axis [rad], shape (M, 3).
        measured_sd: Standard deviations of the measurements, shape (M, 3).
        log_likelihoods: Filled with the log-likelihoods, shape (M,).
        squared_distances: Filled with the squared Mahalanobis distances, shape (M,).
    """
    jacobian = np.empty((3, STATE_SIZE))
    gain = np.empty((3, STATE_SIZE))
    weighted_innovation = np.empty(3)
    for i, row in enumerate(rows):
        log_likelihoods[i], squared_distances[i], _ = correct_state(
            states[row],
            covariances[row],
            model,
            measured[i],
            measured_sd[i],
            jacobian,
            gain,
            weighted_innovation,
        )


@compiled(**ENTRY)
def predict_bodies(states, rows, speed_min, bodies, jacobians):
    """Predict the measurements of several cells' bodies, and their derivatives.

    Args:
        states: States of R cells, shape (R, n).
        rows: Rows of the cells to predict, shape (M,).
        speed_min: Speed below which a cell of this organism rests [um/s].
        bodies: Filled with x, y [um] and the axis [rad] of each body, shape (M, 3).
        jacobians: Filled with their derivatives with respect to the state, shape (M, 3, n).
    """
    for i, row in enumerate(rows):
        predict_body(states[row], speed_min, bodies[i], jacobians[i])
