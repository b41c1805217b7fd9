"""The filter of one swimming cell with whole matrices, to be read: what the kernels `helix_steps`
and `helix_path` compute. Derivatives of the motion are those of differences.
"""

import math

import numpy as np

from tetractl.lab.cameras.cells.kernels import helix_path, helix_steps
from tetractl.lab.cameras.cells.kernels.helix_steps import (
    BIAS,
    DELAY,
    FLOW_X,
    FLOW_Y,
    HEADING,
    ODD,
    RATE,
    SPEED,
    STATES,
    SWAY,
    TAIL,
    TURN,
    TURN_S,
    WAY,
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


def switched(m, before, field):
    """The state after a field that changes later by the state DELAY."""
    m = m.copy()
    if m[SPEED] > helix_steps.SLOWEST_UM_S:
        m[HEADING] += m[DELAY] * m[A] * (torque(m, before) - torque(m, field))
    return m


def moved(m, p, seconds, field):
    """The state after a piece of constant field, by the heading halfway, and to second order in its
    error.
    """
    m, resting = m.copy(), m[SPEED] < helix_steps.SLOWEST_UM_S
    dipole = p[HEADING, HEADING] + 2 * p[HEADING, BIAS] + p[BIAS, BIAS]
    a, middle = 0.0 if resting else m[A] * math.exp(-dipole / 2), m.copy()
    middle[HEADING] += (a * torque(m, field) + m[TURN]) * seconds / 2
    ahead = np.array([math.cos(middle[HEADING]), math.sin(middle[HEADING])])
    ahead *= math.exp(-p[HEADING, HEADING] / 2)
    m[[X, Y]] += (m[SPEED] * ahead + m[[FLOW_X, FLOW_Y]]) * seconds
    m[HEADING] += (a * torque(middle, field) + m[TURN]) * seconds
    swing = complex(m[C], m[S]) * np.exp((1j * m[RATE] - 1 / helix_steps.HELIX_S) * seconds)
    m[C], m[S] = swing.real, swing.imag
    m[TURN] *= math.exp(-seconds / TURN_S)
    m[WAY] += m[SPEED] * seconds
    return m


def body(m):
    """The body's x, y and axis of a state."""
    speed = max(m[SPEED], helix_steps.SLOWEST_UM_S)
    left = m[C] * np.array([-math.sin(m[HEADING]), math.cos(m[HEADING])])
    return np.array([*(m[:2] + left), m[HEADING] - m[SWAY] * math.atan2(m[RATE] * m[S], speed)])


def slopes(function, m):
    """The derivatives of a function of the state, by differences."""
    step = 1e-6 * np.maximum(1.0, np.abs(m)) * np.eye(STATES)
    return np.array([(function(m + one) - function(m - one)) / (2 * one.sum()) for one in step]).T


def noise(m, growth, turn_sd, walled, seconds):
    """The variances (n,) that a piece of constant field adds."""
    found = np.zeros(STATES)
    found[: len(growth)] = growth**2
    if m[SPEED] < helix_steps.SLOWEST_UM_S:
        found[HEADING] += helix_steps.RESTING_HEADING**2
        found[SPEED] += helix_steps.RESTING_SPEED**2
    found[HEADING] += helix_steps.WALL_TURN**2 * walled
    found *= seconds
    found[TURN] = turn_sd**2 * (1 - math.exp(-2 * seconds / TURN_S))
    return found


def move(m, p, growth, turn_sd, walled, seconds, field):
    """State, covariance and derivatives after a piece of constant field."""
    f = slopes(lambda state: moved(state, p, seconds, field), m)
    if walled:
        f[:, [A, BIAS]] = np.eye(STATES)[:, [A, BIAS]]
    added = noise(m, growth, turn_sd, walled, seconds)
    return moved(m, p, seconds, field), f @ p @ f.T + np.diag(added), f


def correct(m, p, measured, deviation):
    """State and covariance after a measurement, ln of its likelihood, and its squared distance."""
    h, off = slopes(body, m), measured - body(m)
    off[2] = (off[2] + math.pi / 2) % math.pi - math.pi / 2
    spread = h @ p @ h.T + np.diag(deviation**2)
    distance = off @ np.linalg.solve(spread, off)
    likelihood = -(TAIL + 3) / 2 * math.log1p(distance / TAIL)
    likelihood -= 0.5 * np.linalg.slogdet(spread)[1]
    spread[range(3), range(3)] *= max(distance / ODD, 1.0)
    gain = p @ h.T @ np.linalg.inv(spread)
    m, p = m + gain @ off, p - gain @ h @ p
    if m[SPEED] < helix_steps.BACKWARDS_UM_S:
        signs = np.ones(STATES)
        signs[[SPEED, C, S]] = -1
        m, p = signs * m, signs[:, None] * signs * p
        m[HEADING] += math.pi
    return m, p, likelihood, distance


def smooth(m, p, measured, deviation, pieces, growth, turn_sd):
    """The states of all pictures given all measurements, by the smoother of Rauch, Tung and
    Striebel; `pieces` is one piece before each picture but the first.
    """
    filtered, predicted = [], []
    for k, values in enumerate(measured):
        f = np.eye(STATES)
        if k:
            if k > 1 and pieces[k - 1][1:] != pieces[k - 2][1:]:
                change = pieces[k - 2][1:], pieces[k - 1][1:]
                f = slopes(lambda state, change=change: switched(state, *change), m)
                m, p = switched(m, *change), f @ p @ f.T
            seconds, *field = pieces[k - 1]
            m, p, last = move(m, p, growth, turn_sd, False, seconds, field)
            f = last @ f
        predicted.append((m, p, f))
        if np.isfinite(values[0]):
            m, p, _, distance = correct(m, p, values, deviation[k])
            assert distance < helix_path.ODD_DISTANCE
        filtered.append((m, p))
    found = [filtered[-1][0]]
    for (m, p), (ahead, spread, f) in zip(filtered[-2::-1], predicted[:0:-1], strict=True):
        found.append(m + p @ f.T @ np.linalg.pinv(spread, hermitian=True) @ (found[-1] - ahead))
    return np.array(found[::-1])
