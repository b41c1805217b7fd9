"""Compiled kernels of the extended Kalman filter in `cells.helix`, for one cell.

The time update predicts the state and its covariance over intervals with a constant field. The
measurement update corrects both with the observed body. `tests/testkit/microscope/helix_steps.py`
is a reference implementation with whole matrices.

In this module, a *piece* is an interval with a constant field: its duration [s] and the x and y
components of the field, relative to the reference field, shape (3,).
"""

import math

import numpy as np

from tetractl.model.motion import swimming
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, INLINE_EXACT, exact

X, Y, HEADING, SPEED, C, S, RATE, A, BIAS, TURN, FLOW_X, FLOW_Y, DELAY, WAY, SWAY, LEAD = range(16)
STATES = 16
# the numbers of a `model` (12,): of the states X to BIAS, the growth of the standard deviation per
# sqrt(s); of TURN, its standard deviation; the factor EXACT from stated deviations of measurements
# to their own; the speed SLOWEST below which a cell rests, and its helix does not give its axis
EXACT = 10
SLOWEST = 11
MODEL = 12

# further growth per sqrt(s) at rest, of the heading, and of the speed in SLOWEST, since a cell may
# go on in any direction; and of the heading near a wall
RESTING_HEADING = 0.5
RESTING_SPEED = 2.5
WALL_TURN = 1.0
HELIX_S = 5.0  # time constant with which c and s are forgotten, so that a helix stays small
TURN_S = 0.5  # time constant with which unexplained turning is forgotten
STEP_S = 0.04  # longest step of the motion [s]
STEPS_MAX = 10_000  # most steps of a piece: beyond 400 s they are longer
TAIL = 8.0  # degrees of freedom of Student's distribution, for which outliers cost little
ODD = 9.0  # squared distance, in standard deviations, above which a measurement gets less weight
# squared distance above which a measurement counts as far, and number of successive ones that are
# far which make the filter uncertain
ODD_DISTANCE = 30.0
ODD_RUN = 3


torque = exact(swimming.torque)


@compiled(**ENTRY)
def apply(f, p, total):
    """Replace a covariance p by f p f', and a matrix of derivatives by f times itself.

    Args:
        f: The Jacobian of one step, shape (n, n). It differs from the unit matrix in only a few
            entries, and its zeros are skipped.
        p: The covariance, shape (n, n), changed in place.
        total: The derivatives, shape (n, n), changed in place. Empty if they are not needed.
    """
    size = len(f)
    part = np.zeros((size, size))
    done = np.zeros(total.shape)
    for i in range(size):
        for k in range(size):
            if f[i, k] != 0.0:
                for j in range(size):
                    part[i, j] += f[i, k] * p[k, j]
                for j in range(len(total)):
                    done[i, j] += f[i, k] * total[k, j]
    p[:] = 0.0
    for i in range(size):
        for k in range(size):
            if f[i, k] != 0.0:
                for j in range(size):
                    p[j, i] += part[j, k] * f[i, k]
    total[:] = done


@compiled(**ENTRY)
def switch(m, p, total, resting, before, after):
    """Account for the delay with which a cell responds to a change of the field.

    During the time given by the state DELAY, the cell still turns in the old field. Its heading is
    changed by the difference between turning in the old field and turning in the new field.

    Args:
        m: The state, shape (n,), changed in place.
        p: The covariance, shape (n, n), changed in place.
        total: Derivatives with respect to the initial state, shape (n, n), changed in place.
        resting: Whether the cell rests.
        before: The piece with the old field, shape (3,).
        after: The piece with the new field, shape (3,).
    """
    a = 0.0 if resting else m[A]
    old, old_slope = torque(m[HEADING] + m[BIAS], before[1], before[2])
    new, new_slope = torque(m[HEADING] + m[BIAS], after[1], after[2])
    f = np.eye(STATES)
    bend = m[DELAY] * a * (old_slope - new_slope)
    f[HEADING, HEADING] += bend
    f[HEADING, BIAS] = bend
    f[HEADING, A] = 0.0 if resting else m[DELAY] * (old - new)
    f[HEADING, DELAY] = a * (old - new)
    m[HEADING] += m[DELAY] * a * (old - new)
    apply(f, p, total)


@compiled(**INLINE_EXACT)
def add_process_noise(p, model, resting, walled, seconds):
    """Add the process noise of a time interval to a covariance.

    The process noise is larger for a cell that rests, and for a cell near a wall.

    Args:
        p: The covariance, shape (n, n), changed in place.
        model: Constants of the cell's model, shape (12,).
        resting: Whether the cell rests.
        walled: Whether the cell is near a wall.
        seconds: Length of the interval [s].
    """
    for state in range(BIAS + 1):
        p[state, state] += model[state] ** 2 * seconds
    p[WAY, WAY] += model[X] ** 2 * seconds
    if resting:
        p[HEADING, HEADING] += RESTING_HEADING**2 * seconds
        p[SPEED, SPEED] += (RESTING_SPEED * model[SLOWEST]) ** 2 * seconds
    if walled:
        p[HEADING, HEADING] += WALL_TURN**2 * seconds


@compiled(**ENTRY)
def move(m, p, total, model, walled, piece):
    """Predict the state and covariance of a cell after one step in a constant field.

    The prediction is of second order in the error of the heading: on average, a cell with an
    uncertain heading advances by the factor `along` less than one whose heading is known, and turns
    by the factor `round` less. Half of the process noise is added before the motion and half after
    it, because a random change of the heading also changes the path.

    Args:
        m: The state, shape (n,), changed in place.
        p: The covariance, shape (n, n), changed in place.
        total: Derivatives with respect to the initial state, shape (n, n), changed in place.
        model: Constants of the cell's model, shape (12,).
        walled: Whether the cell is near a wall. If so, its turning does not change the estimate of
            a.
        piece: Duration [s], and x and y of the field, shape (3,).
    """
    seconds, ux, uy = piece
    half = seconds / 2
    resting = m[SPEED] < model[SLOWEST]
    add_process_noise(p, model, resting, walled, half)
    along = math.exp(-p[HEADING, HEADING] / 2)
    round = math.exp(-(p[HEADING, HEADING] + 2 * p[HEADING, BIAS] + p[BIAS, BIAS]) / 2)
    a = 0.0 if resting else m[A] * round
    towards, slope = torque(m[HEADING] + m[BIAS], ux, uy)
    middle = m[HEADING] + (a * towards + m[TURN]) * half
    towards_2, slope_2 = torque(middle + m[BIAS], ux, uy)
    bend = a * slope
    bend_2 = a * slope_2
    # derivatives of the heading halfway, along which the cell moves; at the end: see below
    learns = 0.0 if walled or resting else round
    f = np.eye(STATES)
    cos = along * math.cos(middle)
    sin = along * math.sin(middle)
    by_bias = bend * half if learns else 0.0
    by_bias_2 = bend_2 if learns else 0.0
    for state, part, direct in (
        (HEADING, 1 + bend * half, 0.0),
        (A, learns * towards * half, learns * towards_2),
        (BIAS, by_bias, by_bias_2),
        (TURN, half, 1.0),
    ):
        f[X, state] = -m[SPEED] * sin * seconds * part
        f[Y, state] = m[SPEED] * cos * seconds * part
        f[HEADING, state] += seconds * (direct + bend_2 * part)
    f[X, SPEED] = cos * seconds
    f[Y, SPEED] = sin * seconds
    f[X, FLOW_X] = f[Y, FLOW_Y] = f[WAY, SPEED] = seconds
    angle = m[RATE] * seconds
    keep = math.exp(-seconds / HELIX_S)
    forget = math.exp(-seconds / TURN_S)
    cos_h = keep * math.cos(angle)
    sin_h = keep * math.sin(angle)
    c = m[C] * cos_h - m[S] * sin_h
    s = m[C] * sin_h + m[S] * cos_h
    f[C, C] = cos_h
    f[C, S] = -sin_h
    f[C, RATE] = -s * seconds
    f[S, C] = sin_h
    f[S, S] = cos_h
    f[S, RATE] = c * seconds
    f[TURN, TURN] = forget
    m[X] += (m[SPEED] * cos + m[FLOW_X]) * seconds
    m[Y] += (m[SPEED] * sin + m[FLOW_Y]) * seconds
    m[HEADING] += (a * towards_2 + m[TURN]) * seconds
    m[C] = c
    m[S] = s
    m[TURN] *= forget
    m[WAY] += m[SPEED] * seconds
    apply(f, p, total)
    add_process_noise(p, model, resting, walled, half)
    p[TURN, TURN] += model[TURN] ** 2 * (1 - forget**2)


@compiled(**ENTRY)
def forward(m, p, total, model, walled, before, pieces):
    """Predict the state and covariance of a cell over successive pieces of constant field.

    A long piece is divided into steps of at most STEP_S, because the path of a cell that turns by a
    radian or more cannot be computed from its two ends.

    Args:
        m: The state, shape (n,), changed in place.
        p: The covariance, shape (n, n), changed in place.
        total: Derivatives with respect to the initial state, shape (n, n), changed in place. Empty
            if they are not needed.
        model: Constants of the cell's model, shape (12,).
        walled: Whether the cell is near a wall.
        before: The piece before the first one, shape (3,).
        pieces: The pieces, shape (P, 3): duration [s], and x and y of the field.
    """
    step = np.empty(3)
    for i in range(len(pieces)):
        last = pieces[i - 1] if i else before
        if not walled and (pieces[i, 1] != last[1] or pieces[i, 2] != last[2]):
            switch(m, p, total, m[SPEED] < model[SLOWEST], last, pieces[i])
        steps = max(1, math.ceil(min(pieces[i, 0] / STEP_S, STEPS_MAX)))
        step[:] = pieces[i]
        step[0] /= steps
        for _ in range(steps):
            move(m, p, total, model, walled, step)


@compiled(**ENTRY)
def expect(m, slowest, expected, h):
    """Predict the measurement of a cell's body, and its derivatives.

    Args:
        m: The state, shape (n,).
        slowest: Speed below which a cell of this organism rests [um/s].
        expected: Filled with x, y [um] and the axis [rad] of the body, shape (3,).
        h: Filled with their derivatives with respect to the state, shape (3, n).
    """
    cos = math.cos(m[HEADING])
    sin = math.sin(m[HEADING])
    speed = max(m[SPEED], slowest)
    swing = m[SWAY] * m[S] + m[LEAD] * m[C]
    across = m[RATE] * swing
    slope = -speed / (speed**2 + across**2)
    expected[0] = m[X] - m[C] * sin
    expected[1] = m[Y] + m[C] * cos
    expected[2] = m[HEADING] - math.atan2(across, speed)
    h[:] = 0.0
    h[0, X] = h[1, Y] = h[2, HEADING] = 1.0
    h[0, HEADING] = -m[C] * cos
    h[1, HEADING] = -m[C] * sin
    h[2, RATE] = slope * swing
    h[0, C] = -sin
    h[1, C] = cos
    h[2, C] = slope * m[RATE] * m[LEAD]
    h[2, S] = slope * m[RATE] * m[SWAY]
    h[2, SWAY] = slope * m[RATE] * m[S]
    h[2, LEAD] = slope * m[RATE] * m[C]
    h[2, SPEED] = -slope * across / speed if m[SPEED] > slowest else 0.0


@compiled(**ENTRY)
def correct(m, p, model, measured, deviation, h, gain, weighed):
    """Update the state and covariance of a cell with one measurement of its body.

    The three components are processed one after another. A component far from its prediction gets
    less weight, so an outlier changes the estimate only a little. If the speed becomes clearly
    negative, the cell is turned around: its heading pointed to the wrong end of the axis.

    Args:
        m: The state, shape (n,), changed in place.
        p: The covariance, shape (n, n), changed in place.
        model: Constants of the cell's model, shape (12,).
        measured: Measured x, y [um] and axis [rad], shape (3,).
        deviation: Standard deviations of the measurement, shape (3,).
        h: Filled with the derivatives of the prediction, shape (3, n).
        gain: Filled with the Kalman gains, shape (3, n).
        weighed: Filled with the innovations divided by their variances, shape (3,).

    Returns:
        The log-likelihood under Student's t distribution, the squared Mahalanobis distance from the
        prediction, and whether the cell was turned around.
    """
    off = np.empty(3)
    moved = np.zeros(STATES)
    distance = 0.0
    spread = 0.0
    expect(m, model[SLOWEST], off, h)
    for i in range(3):
        off[i] = measured[i] - off[i]
        if i == 2:
            off[i] = (off[i] + math.pi / 2) % math.pi - math.pi / 2
        variance = (model[EXACT] * deviation[i]) ** 2
        for j in range(STATES):
            off[i] -= h[i, j] * moved[j]
            gain[i, j] = 0.0
            for k in range(STATES):
                gain[i, j] += p[j, k] * h[i, k]
        for j in range(STATES):
            variance += h[i, j] * gain[i, j]
        odd = off[i] ** 2 / variance
        distance += odd
        spread += math.log(variance)
        variance *= max(odd / ODD, 1.0)
        weighed[i] = off[i] / variance
        for j in range(STATES):
            moved[j] += gain[i, j] * weighed[i]
            for k in range(j + 1):
                p[j, k] = p[k, j] = p[j, k] - gain[i, j] * gain[i, k] / variance
        for j in range(STATES):
            gain[i, j] /= variance
    for j in range(STATES):
        m[j] += moved[j]
    wrong = m[SPEED] < -model[SLOWEST]
    if wrong:  # the heading points to the wrong end of the axis
        m[HEADING] += math.pi
        reverse(m)
        for j in range(STATES):
            reverse(p[j])
        for j in range(STATES):
            reverse(p[:, j])
    return -(TAIL + 3) / 2 * math.log1p(distance / TAIL) - spread / 2, distance, wrong


@compiled(**INLINE_EXACT)
def reverse(states):
    """Change the signs of the states (n,) that depend on which end of the cell is its front."""
    for state in (SPEED, C, S):
        states[state] = -states[state]


@compiled(**ENTRY)
def predict(mean, covariance, used, model, walled, before, pieces):
    """Run the time update of the Kalman filter for every cell.

    Args:
        mean: States of R cells, shape (R, n), changed in place.
        covariance: Covariances, shape (R, n, n), changed in place.
        used: Whether each row holds a cell, shape (R,). The other rows are not changed.
        model: Constants of the cells' model, shape (12,).
        walled: Whether each cell is near a wall, shape (R,).
        before: The piece of constant field before the first one, shape (3,).
        pieces: Successive pieces of constant field, shape (P, 3): duration [s], and x and y of the
            field relative to the reference field.
    """
    total = np.empty((0, 0))
    for row in range(len(used)):
        if used[row]:
            forward(mean[row], covariance[row], total, model, walled[row], before, pieces)


@compiled(**ENTRY)
def update(mean, covariance, rows, model, measured, deviation, likelihood, distance):
    """Run the measurement update of the Kalman filter for some of the cells.

    Args:
        mean: States of R cells, shape (R, n), changed in place.
        covariance: Covariances, shape (R, n, n), changed in place.
        rows: Rows of the measured cells, shape (M,).
        model: Constants of the cells' model, shape (12,).
        measured: Measured x, y [um] and axis [rad], shape (M, 3).
        deviation: Standard deviations of the measurements, shape (M, 3).
        likelihood: Filled with the log-likelihoods, shape (M,).
        distance: Filled with the squared Mahalanobis distances, shape (M,).
    """
    h = np.empty((3, STATES))
    gain = np.empty((3, STATES))
    weighed = np.empty(3)
    for i, row in enumerate(rows):
        likelihood[i], distance[i], _ = correct(
            mean[row], covariance[row], model, measured[i], deviation[i], h, gain, weighed
        )


@compiled(**ENTRY)
def expected(mean, rows, slowest, bodies, slopes):
    """Predict the measurements of several cells' bodies, and their derivatives.

    Args:
        mean: States of R cells, shape (R, n).
        rows: Rows of the cells to predict, shape (M,).
        slowest: Speed below which a cell of this organism rests [um/s].
        bodies: Filled with x, y [um] and the axis [rad] of each body, shape (M, 3).
        slopes: Filled with their derivatives with respect to the state, shape (M, 3, n).
    """
    for i, row in enumerate(rows):
        expect(mean[row], slowest, bodies[i], slopes[i])
