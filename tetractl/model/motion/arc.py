"""The motion under wheel speeds (24)-(25) computed once per step and held: arcs of a circle.

The heading advances as in (6), by w = t a sin(u - heading); the chord of the arc has length
t v sin(w/2) / (w/2) and direction heading + w/2.
"""

from typing import Any

import numpy as np

from tetractl.core import elementwise
from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Held, Motion, PlainLanes, Time, XYHeading
from tetractl.model.motion.polynomials import onwards, sincos, wrap

FLAT_HALF_TURN_RAD = 1e-4
"""Half the turn [rad] below which sin(h)/h is 1 - h^2/6, to rounding."""


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance along the arc that the wheel speeds of (24)-(25) drive."""
    half = 0.5 * t * a * elementwise.sin(u - heading)
    return _along(x, y, heading, half, t * v)


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Continue along the arc at the turning rate set by the command."""
    return _along(x, y, heading, 0.5 * held.turning * t, v * t)


def _along(x: Floats, y: Floats, heading: Floats, half: Floats, way: Floats) -> XYHeading:
    """Advance on an arc of the length `way` by twice the angle `half`."""
    straight = np.abs(half) < FLAT_HALF_TURN_RAD
    bent = np.where(straight, 1.0, half)
    straight = np.abs(half) < FLAT_HALF_TURN_RAD
    bent = np.where(straight, 1.0, half)
    chord = way * np.where(straight, 1 - half * half / 6, elementwise.sin(bent) / bent)
    course = heading + half
    x_after = x + chord * elementwise.cos(course)
    y_after = y + chord * elementwise.sin(course)
    return x_after, y_after, heading + 2 * half


def differentiate(c: float, s: float, cu: float, su: float, robot: Any, t: float) -> Derivatives:
    """Return a step of `t` [s] and its derivatives: the chord t v sin(h)/h at heading + h, h = w/2.

    c and s are cos and sin of the heading, cu and su those of the direction u, `robot` begins with
    a and v. Names end in what they are derivatives by: phi = u - heading, h, and the logarithms of
    a and of the speed, by which d/d(ln a) = a d/da.
    """
    a, v = robot[:2]
    h = 0.5 * t * a * (su * c - cu * s)
    h_phi = 0.5 * t * a * (cu * c + su * s)  # dh/dphi
    sh, ch = sincos(wrap(h))
    flat = abs(h) < FLAT_HALF_TURN_RAD
    divisor = 1.0 if flat else h
    sinc = 1 - h * h / 6 if flat else sh / divisor
    sinc_h = -h / 3 if flat else (ch - sinc) / divisor
    # cos and sin of the chord's direction, heading + h
    cos_chord = c * ch - s * sh
    sin_chord = s * ch + c * sh
    chord = t * v * sinc
    east = chord * cos_chord
    north = chord * sin_chord
    chord_h = t * v * sinc_h
    chord_phi = chord_h * h_phi
    east_phi = chord_phi * cos_chord - chord * sin_chord * h_phi
    north_phi = chord_phi * sin_chord + chord * cos_chord * h_phi
    by_heading = (-chord * sin_chord - east_phi, chord * cos_chord - north_phi, 1 - 2 * h_phi)
    by_u = (east_phi, north_phi, 2 * h_phi)
    east_a = h * (chord_h * cos_chord - chord * sin_chord)
    north_a = h * (chord_h * sin_chord + chord * cos_chord)
    by_a = (east_a, north_a, 2 * h)
    by_speed = (east, north, 0.0)
    return (east, north, 2 * h), by_heading, by_u, (by_a, by_speed)


class ArcLanes(PlainLanes):
    """The constants of an arc."""

    differentiate = staticmethod(differentiate)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading at the end of the step."""
        return onwards(x, y, c, s, differentiate(c, s, cu, su, k[:-1], k[-1])[0])


ARC = Motion("arc", step, hold, ArcLanes)
