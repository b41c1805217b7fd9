"""A readable filter of one swimming cell, as a reference for the kernels.

It uses full matrices, and computes the same as the kernels `helix_steps` and `helix_path`.
Derivatives of the motion are finite differences.
"""

import math

import numpy as np
from tetractl_microscope.cells.kernels import helix_path, helix_steps
from tetractl_microscope.cells.kernels.helix_steps import (
    BIAS,
    DELAY,
    FLOW_X,
    FLOW_Y,
    FULL_WEIGHT_MAX,
    HEADING,
    LEAD,
    PATH_LENGTH,
    RATE,
    SPEED,
    SPEED_MIN,
    STATE_SIZE,
    STUDENT_DOF,
    SWAY,
    TURN,
    TURN_S,
    A,
    C,
    S,
    X,
    Y,
)


def torque(m, field):
    """The turning rate for a = 1 by equation (3)."""
    dipole = m[HEADING] + m[BIAS]
    return field[1] * math.cos(dipole) - field[0] * math.sin(dipole)


def switched(m, before, field, slowest):
    """The state after a field that changes later by the state DELAY."""
    m = m.copy()
    if m[SPEED] > slowest:
        m[HEADING] += m[DELAY] * m[A] * (torque(m, before) - torque(m, field))
    return m


def moved(m, p, seconds, field, slowest):
    """The state after a piece of constant field, by the heading halfway, and to second order in its
    error.
    """
    resting = m[SPEED] < slowest
    m = m.copy()
    dipole = p[HEADING, HEADING] + 2 * p[HEADING, BIAS] + p[BIAS, BIAS]
    a = 0.0 if resting else m[A] * math.exp(-dipole / 2)
    middle = m.copy()
    middle[HEADING] += (a * torque(m, field) + m[TURN]) * seconds / 2
    ahead = np.array([math.cos(middle[HEADING]), math.sin(middle[HEADING])])
    ahead *= math.exp(-p[HEADING, HEADING] / 2)
    m[[X, Y]] += (m[SPEED] * ahead + m[[FLOW_X, FLOW_Y]]) * seconds
    m[HEADING] += (a * torque(middle, field) + m[TURN]) * seconds
    swing = complex(m[C], m[S]) * np.exp((1j * m[RATE] - 1 / helix_steps.HELIX_S) * seconds)
    m[C] = swing.real
    m[S] = swing.imag
    m[TURN] *= math.exp(-seconds / TURN_S)
    m[PATH_LENGTH] += m[SPEED] * seconds
    return m


def body(m, slowest):
    """The body's x, y and axis of a state."""
    aside = m[C] * np.array([-math.sin(m[HEADING]), math.cos(m[HEADING])])
    across = m[RATE] * (m[SWAY] * m[S] + m[LEAD] * m[C])
    sway = math.atan2(across, max(m[SPEED], slowest))
    return np.array([*(m[:2] + aside), m[HEADING] - sway])


def slopes(function, m):
    """The derivatives of a function of the state, by differences."""
    derivatives = []
    for step in 1e-6 * np.maximum(1.0, np.abs(m)) * np.eye(STATE_SIZE):
        change = function(m + step) - function(m - step)
        derivatives.append(change / (2 * step.sum()))
    return np.array(derivatives).T


def noise(m, model, walled, seconds):
    """The covariance (n, n) that a time adds, but that of turning."""
    totals = np.zeros(STATE_SIZE)
    slowest = model[SPEED_MIN]
    totals[:TURN] = model[:TURN] ** 2
    totals[PATH_LENGTH] = model[X] ** 2
    if m[SPEED] < slowest:
        totals[HEADING] += helix_steps.RESTING_HEADING_GROWTH**2
        totals[SPEED] += (helix_steps.RESTING_SPEED_GROWTH * slowest) ** 2
    totals[HEADING] += helix_steps.WALL_HEADING_GROWTH**2 * walled
    return np.diag(totals * seconds)


def move(m, p, model, walled, seconds, field):
    """State, covariance and derivatives after a piece of constant field: half of the noise comes
    before the motion.
    """
    half = noise(m, model, walled, seconds / 2)
    slowest = model[SPEED_MIN]
    p = p + half
    f = slopes(lambda state: moved(state, p, seconds, field, slowest), m)
    if walled:
        f[:, [A, BIAS]] = np.eye(STATE_SIZE)[:, [A, BIAS]]
    after = f @ p @ f.T + half
    after[TURN, TURN] += model[TURN] ** 2 * (1 - math.exp(-2 * seconds / TURN_S))
    return moved(m, p, seconds, field, slowest), after, f


def correct(m, p, model, measured, deviation):
    """State and covariance after a measurement, ln of its likelihood, and its squared distance:
    one number after the other, each with the less weight the farther it is beyond ODD.
    """
    first = m
    before = body(m, model[SPEED_MIN])
    slowest = model[SPEED_MIN]
    h = slopes(lambda state: body(state, slowest), m)
    distance = 0.0
    likelihood = 0.0
    for i, row in enumerate(h):
        off = measured[i] - before[i]
        if i == 2:
            off = (off + math.pi / 2) % math.pi - math.pi / 2
        off -= row @ (m - first)
        variance = row @ p @ row + deviation[i] ** 2
        distance += off**2 / variance
        likelihood -= math.log(variance) / 2
        variance *= max(off**2 / variance / FULL_WEIGHT_MAX, 1.0)
        gain = p @ row / variance
        m = m + gain * off
        p = p - variance * np.outer(gain, gain)
    likelihood -= (STUDENT_DOF + 3) / 2 * math.log1p(distance / STUDENT_DOF)
    if m[SPEED] < -slowest:
        signs = np.ones(STATE_SIZE)
        signs[[SPEED, C, S]] = -1
        m = signs * m
        p = signs[:, None] * signs * p
        m[HEADING] += math.pi
    return m, p, likelihood, distance


def smooth(m, p, model, measured, deviation, pieces):
    """The states of all pictures given all measurements, by the smoother of Rauch, Tung and
    Striebel; `pieces` is one piece before each picture but the first.
    """
    filtered = []
    predicted = []
    for k, values in enumerate(measured):
        f = np.eye(STATE_SIZE)
        if k:
            if k > 1 and pieces[k - 1][1:] != pieces[k - 2][1:]:
                change = pieces[k - 2][1:], pieces[k - 1][1:], model[SPEED_MIN]
                f = slopes(lambda state, change=change: switched(state, *change), m)
                m = switched(m, *change)
                p = f @ p @ f.T
            seconds, *field = pieces[k - 1]
            m, p, last = move(m, p, model, False, seconds, field)
            f = last @ f
        predicted.append((m, p, f))
        if np.isfinite(values[0]):
            m, p, _, distance = correct(m, p, model, values, deviation[k])
            assert distance < helix_path.DISTANT_SQUARED
        filtered.append((m, p))
    smoothed = [filtered[-1][0]]
    for (m, p), (ahead, spread, f) in zip(filtered[-2::-1], predicted[:0:-1], strict=True):
        gain = p @ f.T @ np.linalg.pinv(spread, hermitian=True)
        smoothed.append(m + gain @ (smoothed[-1] - ahead))
    return np.array(smoothed[::-1])
