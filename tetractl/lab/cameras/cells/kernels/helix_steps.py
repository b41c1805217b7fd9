"""The compiled steps of the filter of `lab.cameras.cells.helix`, for one cell: its state and
covariance move over a piece of constant field, and are updated by a measurement.

`tests/oracles/helix_steps.py` computes the same with whole matrices.
"""

import math

import numpy as np

from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY, INLINE_EXACT

X, Y, HEADING, SPEED, C, S, RATE, A, BIAS, TURN, FLOW_X, FLOW_Y, DELAY, WAY, SWAY = range(15)
STATES = 15

SLOWEST_UM_S = 60.0  # below this speed a cell rests, and its helix does not give its axis
BACKWARDS_UM_S = -60.0  # speed along the heading below which the heading is reversed
# additional growth of deviations per sqrt(s) at rest, since a cell may go on in any direction
RESTING_HEADING, RESTING_SPEED = 0.5, 150.0
WALL_TURN = 1.0  # additional growth of the heading's deviation near a wall [rad/sqrt(s)]
HELIX_S = 5.0  # time constant with which c and s are forgotten, so that a helix stays small
TURN_S = 0.5  # time constant with which unexplained turning is forgotten
TAIL = 8.0  # degrees of freedom of Student's distribution, for which outliers cost little
ODD = 25.0  # squared distance, in standard deviations, above which a measurement gets less weight


@compiled(**INLINE_EXACT)
def torque(dipole, ux, uy):
    """Return the turning rate for a = 1 by equation (3), for a dipole's direction [rad] in the
    field (ux, uy), and its derivative with respect to the direction.
    """
    cos, sin = math.cos(dipole), math.sin(dipole)
    return uy * cos - ux * sin, -(uy * sin + ux * cos)


@compiled(**ENTRY)
def apply(f, p, total):
    """Replace the covariance p by f p f', and the derivatives `total` (n, n; may be empty) by
    f total.

    f (n, n) is the unit matrix but for few entries, so that zeros are skipped.
    """
    size = len(f)
    part, done = np.zeros((size, size)), np.zeros(total.shape)
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
def switch(m, p, total, before_x, before_y, ux, uy):
    """Let the field change from (before_x, before_y) to (ux, uy) later by the state DELAY."""
    a = m[A] if m[SPEED] > SLOWEST_UM_S else 0.0
    old, old_slope = torque(m[HEADING] + m[BIAS], before_x, before_y)
    new, new_slope = torque(m[HEADING] + m[BIAS], ux, uy)
    f = np.eye(STATES)
    bend = m[DELAY] * a * (old_slope - new_slope)
    f[HEADING, HEADING] += bend
    f[HEADING, BIAS] = bend
    f[HEADING, A] = m[DELAY] * (old - new) if a else 0.0
    f[HEADING, DELAY] = a * (old - new)
    m[HEADING] += m[DELAY] * a * (old - new)
    apply(f, p, total)


@compiled(**ENTRY)
def move(m, p, total, growth, turn_sd, walled, seconds, ux, uy):
    """Move a cell's state m and covariance p over a piece of constant field (ux, uy).

    `growth` (9,) and `turn_sd` are as in `HelixFilter`; near a wall (`walled`) turning is
    no sign of a. `total` collects the derivatives with respect to the state before. To second order
    in the heading's error, a cell swims and turns by `along` and `round` less than at the mean.
    """
    half = seconds / 2
    along = math.exp(-p[HEADING, HEADING] / 2)
    round = math.exp(-(p[HEADING, HEADING] + 2 * p[HEADING, BIAS] + p[BIAS, BIAS]) / 2)
    resting = m[SPEED] < SLOWEST_UM_S
    a = 0.0 if resting else m[A] * round
    towards, slope = torque(m[HEADING] + m[BIAS], ux, uy)
    middle = m[HEADING] + (a * towards + m[TURN]) * half
    towards_2, slope_2 = torque(middle + m[BIAS], ux, uy)
    bend, bend_2 = a * slope, a * slope_2
    # derivatives of the heading halfway, along which the cell moves; at the end: see below
    learns = 0.0 if walled or resting else round
    f = np.eye(STATES)
    cos, sin = along * math.cos(middle), along * math.sin(middle)
    for state, part, direct in (
        (HEADING, 1 + bend * half, 0.0),
        (A, learns * towards * half, learns * towards_2),
        (BIAS, bend * half * (learns > 0), bend_2 * (learns > 0)),
        (TURN, half, 1.0),
    ):
        f[X, state] = -m[SPEED] * sin * seconds * part
        f[Y, state] = m[SPEED] * cos * seconds * part
        f[HEADING, state] += seconds * (direct + bend_2 * part)
    f[X, SPEED], f[Y, SPEED] = cos * seconds, sin * seconds
    f[X, FLOW_X] = f[Y, FLOW_Y] = f[WAY, SPEED] = seconds
    angle = m[RATE] * seconds
    keep = math.exp(-seconds / HELIX_S)
    cos_h, sin_h = keep * math.cos(angle), keep * math.sin(angle)
    c, s = m[C] * cos_h - m[S] * sin_h, m[C] * sin_h + m[S] * cos_h
    f[C, C], f[C, S], f[C, RATE] = cos_h, -sin_h, -s * seconds
    f[S, C], f[S, S], f[S, RATE] = sin_h, cos_h, c * seconds
    forget = math.exp(-seconds / TURN_S)
    f[TURN, TURN] = forget
    m[X] += (m[SPEED] * cos + m[FLOW_X]) * seconds
    m[Y] += (m[SPEED] * sin + m[FLOW_Y]) * seconds
    m[HEADING] += (a * towards_2 + m[TURN]) * seconds
    m[C], m[S] = c, s
    m[TURN] *= forget
    m[WAY] += m[SPEED] * seconds
    apply(f, p, total)
    for state in range(len(growth)):
        p[state, state] += growth[state] ** 2 * seconds
    if resting:
        p[HEADING, HEADING] += RESTING_HEADING**2 * seconds
        p[SPEED, SPEED] += RESTING_SPEED**2 * seconds
    if walled:
        p[HEADING, HEADING] += WALL_TURN**2 * seconds
    p[TURN, TURN] += turn_sd**2 * (1 - forget**2)


@compiled(**ENTRY)
def expect(m, expected, h):
    """Write the predicted x, y and axis of the body (3,), and their derivatives h (3, n) with
    respect to the states.
    """
    cos, sin = math.cos(m[HEADING]), math.sin(m[HEADING])
    speed = max(m[SPEED], SLOWEST_UM_S)
    across = m[RATE] * m[S]
    expected[0] = m[X] - m[C] * sin
    expected[1] = m[Y] + m[C] * cos
    tilt = math.atan2(across, speed)
    expected[2] = m[HEADING] - m[SWAY] * tilt
    squared = speed**2 + across**2
    h[:] = 0.0
    h[0, X] = h[1, Y] = h[2, HEADING] = 1.0
    h[0, HEADING], h[1, HEADING] = -m[C] * cos, -m[C] * sin
    h[0, C], h[1, C] = -sin, cos
    h[2, SWAY] = -tilt
    h[2, S] = -m[SWAY] * m[RATE] * speed / squared
    h[2, RATE] = -m[SWAY] * m[S] * speed / squared
    h[2, SPEED] = m[SWAY] * across / squared if m[SPEED] > SLOWEST_UM_S else 0.0


@compiled(**ENTRY)
def inverse(s, out):
    """Write the inverse of the symmetric matrix s (3, 3), and return its determinant."""
    out[0, 0] = s[1, 1] * s[2, 2] - s[1, 2] ** 2
    out[0, 1] = out[1, 0] = s[0, 2] * s[1, 2] - s[0, 1] * s[2, 2]
    out[0, 2] = out[2, 0] = s[0, 1] * s[1, 2] - s[0, 2] * s[1, 1]
    out[1, 1] = s[0, 0] * s[2, 2] - s[0, 2] ** 2
    out[1, 2] = out[2, 1] = s[0, 1] * s[0, 2] - s[0, 0] * s[1, 2]
    out[2, 2] = s[0, 0] * s[1, 1] - s[0, 1] ** 2
    det = s[0, 0] * out[0, 0] + s[0, 1] * out[0, 1] + s[0, 2] * out[0, 2]
    out /= det
    return det


@compiled(**ENTRY)
def correct(m, p, measured, deviation, h, gain, weighed):
    """Update a cell's state m and covariance p by x, y [um] and axis [rad] with their deviations
    (3,); write derivatives h (3, n), gain (n, 3) and the weighed innovation (3,).

    Returns ln of the likelihood by Student's distribution, the squared Mahalanobis distance
    from the prediction, and whether the heading was reversed.
    """
    off, cross = np.empty(3), np.zeros((STATES, 3))
    spread, inv = np.empty((3, 3)), np.empty((3, 3))
    expect(m, off, h)
    for i in range(3):
        off[i] = measured[i] - off[i]
        for j in range(STATES):
            for k in range(STATES):
                cross[j, i] += p[j, k] * h[i, k]
    off[2] = (off[2] + math.pi / 2) % math.pi - math.pi / 2
    for i in range(3):
        for j in range(3):
            spread[i, j] = 0.0
            for k in range(STATES):
                spread[i, j] += h[i, k] * cross[k, j]
        spread[i, i] += deviation[i] ** 2
    det = inverse(spread, inv)
    distance = 0.0
    for i in range(3):
        for j in range(3):
            distance += off[i] * inv[i, j] * off[j]
    likelihood = -(TAIL + 3) / 2 * math.log1p(distance / TAIL) - 0.5 * math.log(det)
    if distance > ODD:
        for i in range(3):
            spread[i, i] *= distance / ODD
        inverse(spread, inv)
    for i in range(3):
        weighed[i] = inv[i, 0] * off[0] + inv[i, 1] * off[1] + inv[i, 2] * off[2]
    for j in range(STATES):
        m[j] += cross[j, 0] * weighed[0] + cross[j, 1] * weighed[1] + cross[j, 2] * weighed[2]
        for i in range(3):
            gain[j, i] = cross[j, 0] * inv[0, i] + cross[j, 1] * inv[1, i] + cross[j, 2] * inv[2, i]
    for j in range(STATES):
        for k in range(j + 1):
            less = gain[j, 0] * cross[k, 0] + gain[j, 1] * cross[k, 1] + gain[j, 2] * cross[k, 2]
            p[j, k] = p[k, j] = (p[j, k] + p[k, j]) / 2 - less
    wrong = m[SPEED] < BACKWARDS_UM_S
    if wrong:  # the heading points to the wrong end of the axis
        m[HEADING] += math.pi
        reverse(m)
        for j in range(STATES):
            reverse(p[j])
        for j in range(STATES):
            reverse(p[:, j])
    return likelihood, distance, wrong


@compiled(**INLINE_EXACT)
def reverse(states):
    """Change the signs of the states (n,) that depend on which end of the axis is in front."""
    for state in (SPEED, C, S):
        states[state] = -states[state]


@compiled(**ENTRY)
def predict(mean, covariance, used, growth, turn_sd, walled, before, piece):
    """Move every row in use over a piece of constant field (3,), after the field `before` (2,)."""
    total = np.empty((0, 0))
    seconds, ux, uy = piece
    for row in range(len(used)):
        if used[row]:
            m, p = mean[row], covariance[row]
            if (ux != before[0] or uy != before[1]) and not walled[row]:
                switch(m, p, total, before[0], before[1], ux, uy)
            move(m, p, total, growth[row], turn_sd, walled[row], seconds, ux, uy)


@compiled(**ENTRY)
def update(mean, covariance, rows, measured, deviation, likelihood, distance):
    """Update rows (M,) by measurements (M, 3), and write ln of their likelihoods and squared
    distances (M,).
    """
    h, gain, weighed = np.empty((3, STATES)), np.empty((STATES, 3)), np.empty(3)
    for i, row in enumerate(rows):
        m, p = mean[row], covariance[row]
        likelihood[i], distance[i], _ = correct(m, p, measured[i], deviation[i], h, gain, weighed)


@compiled(**ENTRY)
def seen(mean, rows, expected, slopes):
    """Write the predicted x, y and axis (M, 3) of rows (M,), and their derivatives (M, 3, n)."""
    for i, row in enumerate(rows):
        expect(mean[row], expected[i], slopes[i])
