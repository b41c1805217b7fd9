"""One sequence, its predicted path, and how each step depends on heading and signal.

With phi = u - heading, a step moves a robot by d(heading, u) and turns it; `trace` stores, for each
robot and signal, the partial derivatives of d and of the next heading g:

    EAST_H, NORTH_H = dd/dheading;  EAST_U, NORTH_U = dd/du;  KEEP = dg/dheading = 1 - dg/du

(in all three models the turn depends on phi alone). The derivative of a later position by an
earlier signal follows by the chain rule backwards in time, in `backward`.
"""

import math

from numba import njit

from tetractl.control.kernels.math import PART
from tetractl.control.kernels.motion import ARC, EULER

EAST_H, NORTH_H, EAST_U, NORTH_U, KEEP = range(5)


@njit(**PART)
def _euler(heading, u, a, v, t):
    """One step of (4)-(6): (dx, dy, turn) and the derivatives."""
    c, s = math.cos(heading), math.sin(heading)
    phi = u - heading
    keep = 1 - t * a * math.cos(phi)
    return t * v * c, t * v * s, t * a * math.sin(phi), -t * v * s, t * v * c, 0.0, 0.0, keep


@njit(**PART)
def _arc(heading, u, a, v, t):
    """One step with held wheels: the chord t v sin(h)/h at heading + h, h = t a sin(phi)/2."""
    phi = u - heading
    h, h_phi = 0.5 * t * a * math.sin(phi), 0.5 * t * a * math.cos(phi)
    if abs(h) < 1e-4:
        sinc, slope = 1 - h * h / 6, -h / 3
    else:
        sinc = math.sin(h) / h
        slope = (math.cos(h) - sinc) / h
    c, s = math.cos(heading + h), math.sin(heading + h)
    chord, chord_phi = t * v * sinc, t * v * slope * h_phi
    east_phi, north_phi = chord_phi * c - chord * s * h_phi, chord_phi * s + chord * c * h_phi
    east_h, north_h = -chord * s - east_phi, chord * c - north_phi
    return chord * c, chord * s, 2 * h, east_h, north_h, east_phi, north_phi, 1 - 2 * h_phi


@njit(**PART)
def _exact(heading, u, a, v, t):
    """One step of the closed form of (1)-(3); see `tetractl.model.cell.exact`."""
    e = math.exp(-a * t)
    phi, cu, su = u - heading, math.cos(u), math.sin(u)
    c, s = math.cos(phi), math.sin(phi)
    d = (1 + c) + (1 - c) * e * e
    turn = 2 * math.atan2(s * (1 - e), (1 + c) + (1 - c) * e)
    along, right = v * (t + math.log(0.5 * d) / a), v * turn / a
    keep = 2 * e / d
    along_phi, right_phi = -v / a * s * (1 - e * e) / d, v / a * (1 - keep)
    east, north = along * cu + right * su, along * su - right * cu
    east_phi, north_phi = along_phi * cu + right_phi * su, along_phi * su - right_phi * cu
    return east, north, turn, -east_phi, -north_phi, east_phi - north, north_phi + east, keep


@njit(**PART)
def trace(u, start, a, v, first_period, period, model, path, slopes):
    """Predict under signals u (L,): path (N, L, 2) of positions, slopes (N, L, 5)."""
    for i in range(a.size):
        x, y, heading = start[i, 0], start[i, 1], start[i, 2]
        for j in range(u.size):
            t = first_period if j == 0 else period
            if model == EULER:
                step = _euler(heading, u[j], a[i], v[i], t)
            elif model == ARC:
                step = _arc(heading, u[j], a[i], v[i], t)
            else:
                step = _exact(heading, u[j], a[i], v[i], t)
            x += step[0]
            y += step[1]
            heading += step[2]
            path[i, j, 0], path[i, j, 1] = x, y
            for k in range(5):
                slopes[i, j, k] = step[3 + k]


@njit(**PART)
def backward(slopes, i, last, east, north, row):
    """Write to row (L,) how east * x + north * y of robot i after signal `last` depends on u."""
    by_heading = 0.0
    for j in range(row.size - 1, last, -1):
        row[j] = 0.0
    for j in range(last, -1, -1):
        keep = slopes[i, j, KEEP]
        by_u = east * slopes[i, j, EAST_U] + north * slopes[i, j, NORTH_U]
        row[j] = by_u + by_heading * (1 - keep)
        by_h = east * slopes[i, j, EAST_H] + north * slopes[i, j, NORTH_H]
        by_heading = by_h + by_heading * keep
