"""The continuous motion (1)-(3) under a held direction, in closed form.

With phi = u - heading, (3) reads d phi/dt = -a sin phi, so tan(phi/2) decays by E = exp(-a t). With
c = cos(phi/2), s = sin(phi/2) and h = c^2 + s^2 E^2, the robot moves v (t + ln(h)/a) along u and
v (phi - phi')/a to the right of it, where tan((phi - phi')/2) = s c (1 - E) / (c^2 + s^2 E).

With phi_m, the angle phi at t/2, both components of the same displacement are odd functions,

    along u:  2 v/a artanh(tanh(a t/2) cos phi_m)     right:  2 v/a arctan(sinh(a t/2) sin phi_m),

the real and the imaginary part of 4 v/a artanh(r exp(i phi_m)), r = tanh(a t/4). Its series in r
gains a factor of r^2, below 0.1, with each term: rollouts need no logarithm and no arc tangent.
"""

import math
from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Held, Motion, Time, XYHeading
from tetractl.model.motion.polynomials import alternating, arctan, decay, log_from_ratio, mantissa

LARGEST_TURN = 1.25
"""Largest a t of one piece of a step, for which r^2 is at most 0.092."""
TERMS = 10
"""Number of terms of the series in r: the rest is at most 2.2e-12 of a piece's path."""
ODD = 2 * np.arange(TERMS) + 1
"""The powers of r in the series."""


def rates(heading: Floats, u: Floats | float, a: Floats, v: Floats) -> XYHeading:
    """Return dx/dt, dy/dt [length unit/s] and dheading/dt [rad/s] of (1)-(3) as printed."""
    return (
        v * np.cos(heading),  # (1)
        v * np.sin(heading),  # (2)
        a * np.sin(u - heading),  # (3)
    )


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance by the closed form of (1)-(3).

    Half angles keep phi near pi exact, where 1 + cos(phi) would cancel.
    """
    half = (u - heading) / 2
    c, s = np.cos(half), np.sin(half)
    decay = np.exp(-a * t)
    turned = 2 * np.arctan2(-np.expm1(-a * t) * s * c, c * c + s * s * decay)  # phi - phi'
    fall = s * s * np.expm1(-2 * a * t)  # h - 1; ln h by log1p near h = 1, by log near h = 0
    log_h = np.where(
        fall > -0.5, np.log1p(np.maximum(fall, -0.5)), np.log(c * c + (s * decay) ** 2)
    )
    along, right = v * (t + log_h / a), v * turned / a
    cos_u, sin_u = np.cos(u), np.sin(u)
    x, y = x + along * cos_u + right * sin_u, y + along * sin_u - right * cos_u
    return x, y, heading + turned


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Follow (1)-(3) under the direction held."""
    return step(x, y, heading, held.direction, a, v, t)


def turn(phi: float, a: float, t: float) -> float:
    """Return by how much a robot turns in a time t [s] under a direction at an angle phi."""
    c, s = math.cos(phi / 2), math.sin(phi / 2)
    return 2 * math.atan2(-math.expm1(-a * t) * s * c, c * c + s * s * math.exp(-a * t))


def differentiate(c: float, s: float, cu: float, su: float, own: Any, t: float) -> Derivatives:
    """Return a step and its derivatives, for any a t.

    Near phi = pi, 1 + cos phi cancels, and the turn of fast robots depends on it. Turn and
    way/(v t) depend on a and t by a t alone, so that their derivatives by ln a are those by ln t.
    """
    a, v = own[:2]
    e = decay(a * t)
    c, s = cu * c + su * s, su * c - cu * s  # cos and sin of phi
    near, far = 1 + c if c > 0.0 else s * s / (1 - c), (1 - c) * e
    d, across = near + far * e, near + far
    m, exponent = mantissa(0.5 * d)
    m1 = m + 1
    inverse = 1 / (d * m1 * across)
    log_half_d = log_from_ratio((m - 1) * (inverse * d * across), exponent)
    turn = 2 * arctan(s * (1 - e) * (inverse * d * m1))
    radius, over_d = v / a, inverse * m1 * across
    along, right = v * t + radius * log_half_d, radius * turn
    keep = 2 * e * over_d
    along_phi, right_phi = -radius * s * (1 - e * e) * over_d, radius * (1 - keep)
    east, north = along * cu + right * su, along * su - right * cu
    east_phi, north_phi = along_phi * cu + right_phi * su, along_phi * su - right_phi * cu
    c, s = (near - far * e) * over_d, s * keep  # cos and sin of phi'
    by_a = v * t * (c * cu + s * su) - east, v * t * (c * su - s * cu) - north, a * t * s
    by_u = east_phi - north, north_phi + east, 1 - keep
    return (east, north, turn), (-east_phi, -north_phi, keep), by_u, (by_a, (east, north, 0.0))


@cache
def odd_multiples(count: int) -> tuple[Floats, Floats]:
    """Return sin(n t)/sin t and cos(n t)/cos t, n = 1, 3, 5, ..., as polynomials of cos^2 t.

    Both are (count, count), a row for each n, lowest coefficient first.
    """
    sines, cosines = np.zeros((2, count, count))
    for rows, before in ((sines, -1.0), (cosines, 1.0)):  # the row for n = -1
        rows[0, 0] = 1.0
        for k in range(1, count):  # sin(n t) = 2 cos(2 t) sin((n - 2) t) - sin((n - 4) t)
            rows[k, 1:] = 4 * rows[k - 1, :-1]
            rows[k] -= 2 * rows[k - 1]
            rows[k] -= rows[k - 2] if k > 1 else before * (np.arange(count) == 0)
    return sines, cosines


class ExactLanes(NamedTuple):
    """Constants for one piece of a step, as used by `advance`."""

    rows: Floats  # (N, size)
    pieces: int  # number of pieces, each with a t <= LARGEST_TURN
    size = 4 + 2 * TERMS - 1

    @classmethod
    def of(cls, parameters: Floats, t: float) -> Self:
        """Return the constants of robots with PARAMETERS (N, K) for steps of t [s]."""
        a, v = parameters.T[:2]
        pieces = max(1, math.ceil(float(a.max()) * t / LARGEST_TURN))
        turn = a * t / pieces
        middle, end = np.tanh(turn / 4), np.tanh(turn / 2)
        series = (4 * v / a)[:, None] * middle[:, None] ** ODD / ODD
        sines, cosines = odd_multiples(TERMS)
        right, along = series @ sines, series @ cosines
        rows, last = np.empty((len(a), cls.size)), 4 + TERMS
        rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = middle, 1 - middle**2, end, 1 - end**2
        rows[:, 4:last], rows[:, last:] = right, (right - along)[:, :-1]
        return cls(rows, pieces)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading after a piece.

        With H the heading and U the direction as unit vectors, r = tanh(a t/2) and G = H + r U, the
        heading after t is (1 - r^2) G/|G|^2 + r U. The heading M after t/2 follows in the same way
        with tanh(a t/4). |G| is computed from H without assuming |H| = 1: rounding errors of |H|
        then grow no faster than those of a turn. The displacement is A(q) M - B(q) (M.U) U with
        polynomials of q = (M.U)^2: A sin phi_m to the right of u and (A - B) cos phi_m along u.
        """
        middle, still, end, rest = k[0], k[1], k[2], k[3]
        near = c * cu + s * su
        f = still / (2.0 - still + 2.0 * middle * near)
        wx, wy = end * cu, end * su
        gx, gy = c + wx, s + wy
        g = rest / (gx * gx + gy * gy)
        p = f * middle + middle  # M = f H + p U
        m = f * near + p
        q = m * m
        first_b = (len(k) + 5) // 2
        a = alternating(k, 4, first_b, q)
        along, through = a * p - m * alternating(k, first_b, len(k), q), a * f
        x, y = x + (through * c + along * cu), y + (through * s + along * su)
        return x, y, g * gx + wx, g * gy + wy

    differentiate = staticmethod(differentiate)


EXACT = Motion("exact", step, hold, ExactLanes)
