"""The closed form of the paper's continuous motion (1)-(3) under a held direction u.

With phi = u - heading, (3) reads d phi/dt = -a sin phi, so tan(phi/2) decays by E = exp(-a t). With
c = cos(phi/2), s = sin(phi/2) and h = c^2 + s^2 E^2, the robot moves v (t + ln(h)/a) along u and v
(phi - phi')/a to the right of it, where tan((phi - phi')/2) = s c (1 - E) / (c^2 + s^2 E).

Let phi_m be the angle phi at the time t/2. Both components of the same displacement are odd
functions of it,

    along u:  2 v/a artanh(tanh(a t/2) cos phi_m)     right:  2 v/a arctan(sinh(a t/2) sin phi_m),

the real and the imaginary part of 4 v/a artanh(r exp(i phi_m)), r = tanh(a t/4). Each term of its
series in r is smaller than the last by a factor of r^2, which is below 0.1. Therefore simulations
of many sequences need no logarithm and no arc tangent.
"""

import math
from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np

from tetractl.core import elementwise
from tetractl.core.elementary import atan2, cos, exp, expm1, sin
from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Held, Motion, Time, XYHeading
from tetractl.model.motion.polynomials import alternating, arctan, decay, log_from_ratio, mantissa

LARGEST_TURN = 1.25
"""Maximum a t [rad] of one piece of a step, for which r^2 is at most 0.092."""
TERMS = 10
"""Number of terms of the series in r. The error is at most 2.2e-12 of a piece's path."""
ODD = 2 * np.arange(TERMS) + 1
"""The odd powers of r that occur in the series: 1, 3, 5, and so on."""


def rates(heading: Floats, u: Floats | float, a: Floats, v: Floats) -> XYHeading:
    """Compute the derivatives of x, y [length unit/s] and heading [rad/s] by (1)-(3).

    Args:
        heading: Heading [rad].
        u: Direction [rad].
        a: Turning rate [rad/s].
        v: Speed [length unit/s].
    """
    return (
        v * elementwise.cos(heading),  # (1)
        v * elementwise.sin(heading),  # (2)
        a * elementwise.sin(u - heading),  # (3)
    )


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance by the closed form of (1)-(3); see `StepFunction`.

    Half angles keep phi near pi exact, where 1 + cos(phi) would cancel.
    """
    half = (u - heading) / 2
    cos_half = elementwise.cos(half)
    sin_half = elementwise.sin(half)
    remaining = elementwise.exp(-a * t)
    decayed = -elementwise.expm1(-a * t)
    turned = 2 * elementwise.atan2(
        decayed * sin_half * cos_half, cos_half * cos_half + sin_half * sin_half * remaining
    )  # phi - phi'
    h_less_1 = sin_half * sin_half * elementwise.expm1(-2 * a * t)  # h - 1
    # ln h by log1p near h = 1, by log near h = 0
    by_log1p = elementwise.log1p(np.maximum(h_less_1, -0.5))
    log_h = np.where(
        h_less_1 > -0.5,
        by_log1p,
        elementwise.log(cos_half * cos_half + np.square(sin_half * remaining)),
    )
    along = v * (t + log_h / a)
    right = v * turned / a
    cos_u = elementwise.cos(u)
    sin_u = elementwise.sin(u)
    return (
        x + along * cos_u + right * sin_u,
        y + along * sin_u - right * cos_u,
        heading + turned,
    )


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Compute poses by (1)-(3) under the held direction; see `Hold`."""
    return step(x, y, heading, held.direction, a, v, t)


def turn(phi: float, a: float, t: float) -> float:
    """Compute the angle by which a robot turns under a held direction [rad].

    Args:
        phi: Angle from the heading to the direction [rad].
        a: Turning rate [rad/s].
        t: Duration [s].
    """
    c = cos(phi / 2)
    s = sin(phi / 2)
    return 2 * atan2(-expm1(-a * t) * s * c, c * c + s * s * exp(-a * t))


def differentiate(c: float, s: float, cu: float, su: float, robot: Any, t: float) -> Derivatives:
    """Compute a step and its derivatives, for any a t; see `Lanes.differentiate`.

    With the whole angle phi instead of half of it, h = d/2 where d = near + far E, near = 1 + cos
    phi and far = (1 - cos phi) E. Near phi = pi, 1 + cos phi cancels, and the turn of fast robots
    depends on it. The turn and the path/(v t) depend on a and t only through a t, so their
    derivatives with respect to ln a equal those with respect to ln t. One division gives all three
    inverses.
    """
    a, v = robot[:2]
    decayed = decay(a * t)
    cos_phi = cu * c + su * s
    sin_phi = su * c - cu * s
    near = 1 + cos_phi if cos_phi > 0.0 else sin_phi * sin_phi / (1 - cos_phi)
    far = (1 - cos_phi) * decayed
    two_h = near + far * decayed
    turn_denominator = near + far
    mantissa_h, exponent = mantissa(0.5 * two_h)
    mantissa_1 = mantissa_h + 1
    inverse = 1 / (two_h * mantissa_1 * turn_denominator)
    log_h = log_from_ratio((mantissa_h - 1) * (inverse * two_h * turn_denominator), exponent)
    turn = 2 * arctan(sin_phi * (1 - decayed) * (inverse * two_h * mantissa_1))
    radius = v / a
    over_d = inverse * mantissa_1 * turn_denominator
    along = v * t + radius * log_h
    right = radius * turn
    east = along * cu + right * su
    north = along * su - right * cu
    # by phi: the heading keeps this share of a change of it
    heading_kept = 2 * decayed * over_d
    along_phi = -radius * sin_phi * (1 - decayed * decayed) * over_d
    right_phi = radius * (1 - heading_kept)
    east_phi = along_phi * cu + right_phi * su
    north_phi = along_phi * su - right_phi * cu
    by_heading = (-east_phi, -north_phi, heading_kept)
    by_u = (east_phi - north, north_phi + east, 1 - heading_kept)
    # by ln a: v t times the velocity's direction after the step, less the step
    cos_after = (near - far * decayed) * over_d
    sin_after = sin_phi * heading_kept
    east_a = v * t * (cos_after * cu + sin_after * su) - east
    north_a = v * t * (cos_after * su - sin_after * cu) - north
    by_a = (east_a, north_a, a * t * sin_after)
    by_speed = (east, north, 0.0)
    return (east, north, turn), by_heading, by_u, (by_a, by_speed)


@cache
def odd_multiples(count: int) -> tuple[Floats, Floats]:
    """Compute sin(n t)/sin t and cos(n t)/cos t, n = 1, 3, 5, ..., as polynomials of cos^2 t.

    Both are (count, count), a row for each n, lowest coefficient first.
    """
    unit = np.zeros(count)  # the polynomial 1, that of n = 1
    unit[0] = 1.0
    sines = _recurrence(unit, -unit)
    cosines = _recurrence(unit, unit)
    return sines, cosines


def _recurrence(first: Floats, before: Floats) -> Floats:
    """Compute the polynomials p_n for n = 1, 3, 5, ..., from those for n = 1 and n = -1.

    The recurrence is

        p_n = 2 cos(2 t) p_(n-2) - p_(n-4),   2 cos(2 t) = 4 cos^2 t - 2.
    """
    rows = np.zeros((first.size, first.size))
    rows[0] = first
    for k in range(1, first.size):
        rows[k, 1:] = 4 * rows[k - 1, :-1]
        rows[k] -= 2 * rows[k - 1]
        rows[k] -= rows[k - 2] if k > 1 else before
    return rows


class ExactLanes(NamedTuple):
    """The constants of the exact motion for one piece of a step, as used by `advance`."""

    rows: Floats  # (N, size)
    pieces: int  # number of pieces, each with a t <= LARGEST_TURN
    size = 4 + 2 * TERMS - 1

    @classmethod
    def of(cls, parameters: Floats, t: float) -> Self:
        """Compute the constants of robots with PARAMETERS (N, K) for steps of t [s].

        A step is divided into equal pieces in which no robot turns by more than LARGEST_TURN.
        """
        a, v = parameters.T[:2]
        largest_turn = float(a.max()) * t
        pieces = max(1, math.ceil(largest_turn / LARGEST_TURN))
        turn = a * t / pieces
        middle = elementwise.tanh(turn / 4)
        end = elementwise.tanh(turn / 2)
        powers = np.repeat(np.square(middle)[:, None], TERMS, axis=1)
        powers[:, 0] = middle
        series = (4 * v / a)[:, None] * np.cumprod(powers, axis=1) / ODD
        sines, cosines = odd_multiples(TERMS)
        right = np.einsum("nk,kq->nq", series, sines)
        along = np.einsum("nk,kq->nq", series, cosines)
        first_b = 4 + TERMS
        rows = np.empty((len(a), cls.size))
        rows[:, 0] = middle
        rows[:, 1] = 1 - np.square(middle)
        rows[:, 2] = end
        rows[:, 3] = 1 - np.square(end)
        rows[:, 4:first_b] = right  # A(q) of `advance`
        rows[:, first_b:] = (right - along)[:, :-1]  # B(q)
        return cls(rows, pieces)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Compute x, y, cos and sin of the heading after a piece; see `Lanes.advance`.

        With H the heading and U the direction as unit vectors, r = tanh(a t/2) and G = H + r U, the
        heading after t is (1 - r^2) G/|G|^2 + r U. The heading M after t/2 follows in the same way
        with tanh(a t/4). |G| is computed from H without assuming |H| = 1: rounding errors of |H|
        then grow no faster than those of a turn. The displacement is A(q) M - B(q) (M.U) U with
        polynomials of q = (M.U)^2: A sin phi_m to the right of u and (A - B) cos phi_m along u.
        """
        middle = k[0]  # tanh(a t/4)
        middle_rest = k[1]  # 1 - tanh^2
        end = k[2]  # tanh(a t/2)
        end_rest = k[3]
        cos_phi = c * cu + s * su
        heading_weight = middle_rest / (2.0 - middle_rest + 2.0 * middle * cos_phi)
        wx = end * cu
        wy = end * su
        gx = c + wx
        gy = s + wy
        end_scale = end_rest / (gx * gx + gy * gy)
        direction_weight = heading_weight * middle + middle  # M = f H + p U
        cos_middle = heading_weight * cos_phi + direction_weight  # M.U
        cos2_middle = cos_middle * cos_middle
        first_b = (len(k) + 5) // 2
        poly_a = alternating(k, 4, first_b, cos2_middle)
        along_u = poly_a * direction_weight - cos_middle * alternating(
            k, first_b, len(k), cos2_middle
        )
        along_heading = poly_a * heading_weight
        x_after = x + (along_heading * c + along_u * cu)
        y_after = y + (along_heading * s + along_u * su)
        return x_after, y_after, end_scale * gx + wx, end_scale * gy + wy

    differentiate = staticmethod(differentiate)


EXACT = Motion("exact", step, hold, ExactLanes)
