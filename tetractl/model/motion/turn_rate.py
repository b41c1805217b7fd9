"""How robots turn other than by (3): faster to one side, and not faster than their motors allow.

A robot turns with the rate a exp(k) to the left and a exp(-k) to the right, where k is its `side`,
and never faster than `saturation` times the greater of these; 1 for motors that never saturate.

Under a held direction the side does not change, so that a step of any motion is one with a exp(+-k)
in place of a. While motors saturate, the a is taken with which the robot turns at its greatest rate
in the middle of the step: the turn differs by the order of its third power.
"""

import math
from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Parameter
from tetractl.model.motion.polynomials import sincos

TURNING = Parameter("side", False, 0.005), Parameter("saturation", True, 0.02)
"""The parameters of how robots turn, behind the PARAMETERS of all motions."""


def all_in_rows(of: Any) -> Floats:
    """Return PARAMETERS and TURNING (N, 4) in the fields of a problem."""
    rows = np.empty((len(of.a), 4))
    rows[:, 0], rows[:, 1] = of.a, of.speed
    rows[:, 2] = 0.0 if of.side is None else of.side
    rows[:, 3] = 1.0 if of.saturation is None else of.saturation
    return rows


def is_left(c: float, s: float, cu: float, su: float) -> bool:
    """Return whether a robot turns to the left, or not at all."""
    return su * c - cu * s >= 0


def turning(c: float, s: float, cu: float, su: float, own: Any, t: float) -> Any:
    """Return the a [rad/s] of a step of t [s] under a direction, and the derivatives of its
    logarithm by phi = u - heading, by `side` and by ln `saturation`; c, s and cu, su are cos and
    sin of heading and u, and `own` are PARAMETERS and TURNING."""
    a, _, side, saturation = own
    sine, more = su * c - cu * s, math.exp(side)
    left = 1.0 if sine >= 0 else -1.0
    rate = a * more if sine >= 0 else a / more
    if saturation >= 1:
        return rate, (0.0, left, 0.0)
    most = a * max(more, 1 / more) * saturation
    cosine, across = cu * c + su * s, abs(sine)
    sh, ch = sincos(min(0.5 * t * min(rate * across, most), math.pi))
    middle = across * ch - cosine * sh
    if rate * middle <= most:
        return rate, (0.0, left, 0.0)
    slope = -left * (cosine * ch + across * sh) / middle
    return most / middle, (slope, 1.0 if side >= 0 else -1.0, 1.0)


def held(a: float, slopes: Any, cosine: float, sine: float, hold: float) -> Any:
    """Return what `turning` does for wheels that are sent the rate of a heading, a sin(phi), and
    keep it for `hold` [s], which is Euler's method. By its modified equation (Hairer, Lubich and
    Wanner, Geometric Numerical Integration, section IX.1), phi follows to the second order in
    x = a hold

        phi' = -a sin(phi) (1 + x / 2 cos(phi) + x^2 (cos(phi)^2 / 3 - sin(phi)^2 / 12)).
    """
    x = min(a * hold, 1.0)  # beyond, the series says nothing
    grown = 1 + x * (0.5 * cosine + x * (cosine * cosine / 3 - sine * sine / 12))
    slope = -x * sine * (0.5 + x * cosine * 5 / 6) / grown
    return a * grown, (slopes[0] + slope, slopes[1], slopes[2])


def times(by: Any, factor: float) -> Any:
    """Return derivatives of x, y and heading times a factor."""
    return by[0] * factor, by[1] * factor, by[2] * factor


def by_turning(found: Derivatives, slopes: Any) -> Derivatives:
    """Return a step found with the a of `turning` with its derivatives by all parameters, given the
    `slopes` of that a."""
    step, (x_h, y_h, keep), (x_u, y_u, turn_u), (by_a, by_speed) = found
    x, y, turn = times(by_a, slopes[0])
    by_heading, by_u = (x_h - x, y_h - y, keep - turn), (x_u + x, y_u + y, turn_u + turn)
    return step, by_heading, by_u, (by_a, by_speed, times(by_a, slopes[1]), times(by_a, slopes[2]))
