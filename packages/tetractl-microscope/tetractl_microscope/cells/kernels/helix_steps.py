"""The compiled steps of the filter of `cells.helix`, for one cell: its state and
covariance move over pieces of constant field, and are updated by a measurement.

`tests/oracles/helix_steps.py` computes the same with whole matrices.
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
    """Replace the covariance p by f p f', and the derivatives `total` (n, n; may be empty) by
    f total.

    f (n, n) is the unit matrix but for few entries, so that zeros are skipped.
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
    """Let the field change from `before` (3,) to `after` (3,) later by the state DELAY."""
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
    """Add to the covariance p what the states may change by themselves in a time."""
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
    """Move a cell's state m and covariance p over a `piece` (3,) of constant field.

    Near a wall (`walled`) turning is no sign of a. `total` collects the derivatives with respect to
    the state before. To second order in the heading's error, a cell swims and turns by `along` and
    `round` less than at the mean. Half of what changes by itself does so before the motion: a
    heading that walks takes the cell with it, which is seen in its way as in its axis.
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
    """Move a cell's state m and covariance p over pieces (P, 3) of constant field, each the
    duration [s] and the field's x and y, after the piece `before` (3,). A long piece is moved over
    in steps of at most STEP_S: the middle of a turn of a radian is not where its ends suggest.
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
    """Write the predicted x, y and axis of the body (3,), and their derivatives h (3, n) with
    respect to the states.
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
    """Update a cell's state m and covariance p by x, y [um] and axis [rad] with their deviations
    (3,), one after the other; write their derivatives h (3, n), gains (3, n) and innovations over
    their variances (3,).

    Returns ln of the likelihood by Student's distribution, the squared Mahalanobis distance
    from the prediction, and whether the heading was reversed.
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
    """Move every row in use over pieces of constant field (P, 3), after the piece `before`."""
    total = np.empty((0, 0))
    for row in range(len(used)):
        if used[row]:
            forward(mean[row], covariance[row], total, model, walled[row], before, pieces)


@compiled(**ENTRY)
def update(mean, covariance, rows, model, measured, deviation, likelihood, distance):
    """Update rows (M,) by measurements (M, 3), and write ln of their likelihoods and squared
    distances (M,).
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
    """Write the predicted x, y and axis (M, 3) of rows (M,), and their derivatives (M, 3, n)."""
    for i, row in enumerate(rows):
        expect(mean[row], slowest, bodies[i], slopes[i])
