"""The motion under wheel speeds (24)-(25) computed once per step and held: arcs of a circle.

The heading advances as in (6), by w = t a sin(u - heading); the chord of the arc has length
t v sin(w/2) / (w/2) and direction heading + w/2.
"""

from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Held, Motion, PlainLanes, Time, XYHeading
from tetractl.model.motion.polynomials import onwards, sincos, wrap


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance along the arc that the wheel speeds of (24)-(25) drive."""
    return _along(x, y, heading, 0.5 * t * a * np.sin(u - heading), t * v)


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Continue along the arc at the turning rate set by the command."""
    return _along(x, y, heading, 0.5 * held.turning * t, v * t)


def _along(x: Floats, y: Floats, heading: Floats, half: Floats, way: Floats) -> XYHeading:
    chord, course = way * np.sinc(half / np.pi), heading + half
    return x + chord * np.cos(course), y + chord * np.sin(course), heading + 2 * half


def differentiate(c: float, s: float, cu: float, su: float, own: Any, t: float) -> Derivatives:
    """Return a step and its derivatives: the chord t v sin(h)/h at heading + h, h = w/2."""
    a, v = own[:2]
    h, h_phi = 0.5 * t * a * (su * c - cu * s), 0.5 * t * a * (cu * c + su * s)
    sh, ch = sincos(wrap(h))
    flat = abs(h) < 1e-4
    by = 1.0 if flat else h
    sinc = 1 - h * h / 6 if flat else sh / by
    sinc_h = -h / 3 if flat else (ch - sinc) / by
    c, s = c * ch - s * sh, s * ch + c * sh
    chord, chord_h = t * v * sinc, t * v * sinc_h
    chord_phi = chord_h * h_phi
    east_phi, north_phi = chord_phi * c - chord * s * h_phi, chord_phi * s + chord * c * h_phi
    east, north = chord * c, chord * s
    by_heading = -chord * s - east_phi, chord * c - north_phi, 1 - 2 * h_phi
    by_a = h * (chord_h * c - chord * s), h * (chord_h * s + chord * c), 2 * h
    by_u = east_phi, north_phi, 2 * h_phi
    return (east, north, 2 * h), by_heading, by_u, (by_a, (east, north, 0.0))


class ArcLanes(PlainLanes):
    """The constants of an arc."""

    differentiate = staticmethod(differentiate)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading at the end of the step."""
        return onwards(x, y, c, s, differentiate(c, s, cu, su, k[:-1], k[-1])[0])


ARC = Motion("arc", step, hold, ArcLanes)
