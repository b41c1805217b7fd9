"""The compiled steps of the filter in `cells.helix`, for one cell.

State and covariance move over pieces of constant field, and are updated with measurements.
`tests/testkit/microscope/helix_steps.py` computes the same with whole matrices.
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
    """Replace a covariance by f p f', and derivatives by f times these.

    Args:
        f: A matrix that differs from the unit matrix in few entries, shape (n, n). Zeros are
            skipped.
        p: The covariance, shape (n, n), changed in place.
        total: The derivatives, shape (n, n), changed in place. May be empty.
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
    """Change the field of a cell, later by the state DELAY.

    Args:
        m: The state, changed in place.
        p: The covariance, changed in place.
        total: Derivatives with respect to the state before, changed in place.
        resting: Whether the cell rests.
        before: The piece of field before, shape (3,).
        after: The piece of field afterwards, shape (3,).
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
def grow(p, model, resting, walled, seconds):
    """Add to a covariance what the states may change by themselves.

    Args:
        p: The covariance, changed in place.
        model: Numbers of the cell's model.
        resting: Whether the cell rests.
        walled: Whether it is near a wall.
        seconds: Duration [s].
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
    """Move a cell's state and covariance over a piece of constant field.

    To second order in the heading's error, a cell swims and turns by `along` and `round` less than
    at the mean. Half of what changes by itself does so before the motion: a heading that walks
    takes the cell with it, which is visible in its path and in its axis.

    Args:
        m: The state, changed in place.
        p: The covariance, changed in place.
        total: Derivatives with respect to the state before, changed in place.
        model: Numbers of the cell's model.
        walled: Whether the cell is near a wall, where turning says nothing about a.
        piece: Duration [s], x and y of the field, shape (3,).
    """
    seconds, ux, uy = piece
    half = seconds / 2
    resting = m[SPEED] < model[SLOWEST]
    grow(p, model, resting, walled, half)
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
    grow(p, model, resting, walled, half)
    p[TURN, TURN] += model[TURN] ** 2 * (1 - forget**2)


@compiled(**ENTRY)
def forward(m, p, total, model, walled, before, pieces):
    """Move a cell's state and covariance over pieces of constant field.

    A long piece is passed in steps of at most STEP_S, because the middle of a turn of a radian is
    not where its ends suggest.

    Args:
        m: The state, changed in place.
        p: The covariance, changed in place.
        total: Derivatives with respect to the state before, changed in place.
        model: Numbers of the cell's model.
        walled: Whether the cell is near a wall.
        before: The piece before, shape (3,).
        pieces: The pieces, shape (P, 3): duration [s], x and y of the field.
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
    """Predict x, y and axis of a cell's body.

    Args:
        m: The state.
        slowest: Minimum speed of the organism [um/s].
        expected: Filled with x, y and axis, shape (3,).
        h: Filled with their derivatives with respect to the states, shape (3, n).
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
    """Update a cell's state and covariance with a measurement, one number after another.

    Args:
        m: The state, changed in place.
        p: The covariance, changed in place.
        model: Numbers of the cell's model.
        measured: x, y [um] and axis [rad], shape (3,).
        deviation: Their standard deviations, shape (3,).
        h: Filled with their derivatives, shape (3, n).
        gain: Filled with the gains, shape (3, n).
        weighed: Filled with the innovations over their variances, shape (3,).

    Returns:
        ln of the likelihood by Student's distribution, the squared Mahalanobis distance from the
        prediction, and whether the heading was reversed.
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
    """Change the signs of the states (n,) that depend on which end of the axis is in front."""
    for state in (SPEED, C, S):
        states[state] = -states[state]


@compiled(**ENTRY)
def predict(mean, covariance, used, model, walled, before, pieces):
    """Move every row in use over pieces of constant field.

    Args:
        mean: States, shape (R, n), changed in place.
        covariance: Covariances, shape (R, n, n), changed in place.
        used: Whether each row is in use, shape (R,).
        model: Numbers of the cells' model.
        walled: Whether each cell is near a wall, shape (R,).
        before: The piece before, shape (3,).
        pieces: The pieces, shape (P, 3).
    """
    total = np.empty((0, 0))
    for row in range(len(used)):
        if used[row]:
            forward(mean[row], covariance[row], total, model, walled[row], before, pieces)


@compiled(**ENTRY)
def update(mean, covariance, rows, model, measured, deviation, likelihood, distance):
    """Update rows with measurements.

    Args:
        mean: States, shape (R, n), changed in place.
        covariance: Covariances, shape (R, n, n), changed in place.
        rows: The rows to update, shape (M,).
        model: Numbers of the cells' model.
        measured: The measurements, shape (M, 3).
        deviation: Their standard deviations, shape (M, 3).
        likelihood: Filled with ln of the likelihoods, shape (M,).
        distance: Filled with the squared distances, shape (M,).
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
    """Predict x, y and axis of cells' bodies.

    Args:
        mean: States, shape (R, n).
        rows: The rows to predict, shape (M,).
        slowest: Minimum speed of the organism [um/s].
        bodies: Filled with x, y and axis, shape (M, 3).
        slopes: Filled with their derivatives, shape (M, 3, n).
    """
    for i, row in enumerate(rows):
        expect(mean[row], slowest, bodies[i], slopes[i])
