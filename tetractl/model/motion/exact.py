"""The continuous motion (1)-(3) under a held direction, in closed form.

With phi = u - heading, (3) reads d phi/dt = -a sin phi, so tan(phi/2) decays by E = exp(-a t). With
c = cos(phi/2), s = sin(phi/2) and h = c^2 + s^2 E^2, the robot moves v (t + ln(h)/a) along u and
v (phi - phi')/a to the right of it, where tan((phi - phi')/2) = s c (1 - E) / (c^2 + s^2 E).
"""

import math
from typing import Any, NamedTuple, Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion.base import Derivatives, Held, Motion, Strides, Time, XYHeading
from tetractl.model.motion.polynomials import (
    ARCTAN_MAX,
    arctan,
    log_from_ratio,
    mantissa,
)

LARGEST_TURN = 2 * math.asinh(ARCTAN_MAX)
"""Largest a t of one piece of a step: tan((phi - phi')/2) is at most sinh(a t/2), over all phi."""


def rates(heading: Floats, u: Floats, a: Floats, v: Floats) -> XYHeading:
    """Return dx/dt, dy/dt [length unit/s] and dheading/dt [rad/s] of (1)-(3) as printed."""
    return (
        v * np.cos(heading),  # (1)
        v * np.sin(heading),  # (2)
        a * np.sin(u - heading),  # (3)
    )


def turn(heading: Floats, u: Floats, a: Floats, t: Time) -> Floats:
    """Advance the headings alone; see `step`."""
    half, exponent = (u - heading) / 2, -a * t
    c, s = np.cos(half), np.sin(half)
    return heading + 2 * np.arctan2(-np.expm1(exponent) * s * c, c * c + s * s * np.exp(exponent))


def strides(heading: Floats, u: Floats, a: Floats, v: Floats, t: Time) -> Strides:
    """Return x of the ways along u and to the right of it, their y, and phi - phi'."""
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
    return (along * cos_u, right * sin_u), (along * sin_u, -right * cos_u), turned


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance by the closed form of (1)-(3).

    Half angles keep phi near pi exact, where 1 + cos(phi) would cancel.
    """
    (along_x, right_x), (along_y, right_y), turned = strides(heading, u, a, v, t)
    return x + along_x + right_x, y + along_y + right_y, heading + turned


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Follow (1)-(3) under the direction held."""
    return step(x, y, heading, held.direction, a, v, t)


class ExactLanes(NamedTuple):
    """Constants of one piece of a step: t v, v/a and E = exp(-a t)."""

    rows: Floats  # (N, size)
    pieces: int  # each with a t <= LARGEST_TURN
    size = 3

    @classmethod
    def of(cls, a: Floats, v: Floats, t: float) -> Self:
        """Return the constants of robots with a, v (N,) for steps of t [s]."""
        pieces = max(1, math.ceil(float(a.max()) * t / LARGEST_TURN))
        piece = t / pieces
        return cls(np.column_stack([v * piece, v / a, np.exp(-a * piece)]), pieces)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading after a piece.

        With D = 2 h = (1 + cos phi) + (1 - cos phi) E^2. The three quotients share one division.
        """
        step, radius, e = k
        c, s = cu * c + su * s, su * c - cu * s  # of phi
        near, far = 1 + c, (1 - c) * e
        d = near + far * e
        across = near + far
        m, exponent = mantissa(0.5 * d)
        m1 = m + 1
        inverse = 1 / (d * m1 * across)
        log_half_d = log_from_ratio((m - 1) * (inverse * d * across), exponent)
        half_turn = arctan(s * (1 - e) * (inverse * d * m1))
        along = step + radius * log_half_d
        right = 2 * radius * half_turn
        x = x + (along * cu + right * su)
        y = y + (along * su - right * cu)
        over_d = inverse * m1 * across
        c, s = (near - far * e) * over_d, 2 * e * s * over_d  # of phi'
        unit = 1.5 - 0.5 * (c * c + s * s)  # near phi = pi, rounding off the circle would grow
        c, s = c * unit, s * unit
        return x, y, cu * c + su * s, su * c - cu * s

    @staticmethod
    def differentiate(heading: float, u: float, a: float, v: float, t: float) -> Derivatives:
        """Return a step and its derivatives."""
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


def lanes(a: Floats, longest: float) -> type[ExactLanes]:
    """Return the class of constants, one for all robots."""
    return ExactLanes


EXACT = Motion("exact", step, hold, lanes, turn, strides)
