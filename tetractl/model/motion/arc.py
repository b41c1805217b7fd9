"""The motion under wheel speeds (24)-(25) computed once per step and held: arcs of a circle.

The heading advances as in (6), by w = t a sin(u - heading); the chord of the arc has length
t v sin(w/2) / (w/2) and direction heading + w/2.
"""

from typing import Any, NamedTuple, Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Held, Motion, Time, XYHeading
from tetractl.model.motion.polynomials import sincos, wrap


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance along the arc that the wheel speeds of (24)-(25) drive."""
    half = 0.5 * t * a * np.sin(u - heading)
    chord = t * v * np.sinc(half / np.pi)
    course = heading + half
    return x + chord * np.cos(course), y + chord * np.sin(course), heading + 2 * half


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Continue along the arc at the turning rate set by the command."""
    half = 0.5 * held.turning * t
    chord, course = v * t * np.sinc(half / np.pi), heading + half
    return x + chord * np.cos(course), y + chord * np.sin(course), heading + 2 * half


class ArcLanes(NamedTuple):
    """Constants of an arc: T v and T a."""

    rows: Floats  # (N, size)
    pieces: int = 1
    size = 2

    @classmethod
    def of(cls, a: Floats, v: Floats, t: float) -> Self:
        """Return the constants of robots with a, v (N,) for steps of t [s]."""
        return cls(np.column_stack([v * t, a * t]))

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading at the end of the arc."""
        step, turn = k
        half = 0.5 * turn * (su * c - cu * s)
        sw, cw = sincos(wrap(half))
        flat = abs(half) < 1e-9
        chord = step * ((1.0 if flat else sw) / (1.0 if flat else half))
        c, s = c * cw - s * sw, s * cw + c * sw  # direction of the chord
        return x + chord * c, y + chord * s, c * cw - s * sw, s * cw + c * sw

    @staticmethod
    def differentiate(
        c: float, s: float, cu: float, su: float, a: float, v: float, t: float
    ) -> Derivatives:
        """Return a step and its derivatives: the chord t v sin(h)/h at heading + h, h = w/2."""
        h, h_phi = 0.5 * t * a * (su * c - cu * s), 0.5 * t * a * (cu * c + su * s)
        sh, ch = sincos(wrap(h))
        flat = abs(h) < 1e-4
        by = 1.0 if flat else h
        sinc = 1 - h * h / 6 if flat else sh / by
        sinc_h = -h / 3 if flat else (ch - sinc) / by
        c, s = c * ch - s * sh, s * ch + c * sh
        chord, chord_phi = t * v * sinc, t * v * sinc_h * h_phi
        east_phi, north_phi = chord_phi * c - chord * s * h_phi, chord_phi * s + chord * c * h_phi
        east_h, north_h = -chord * s - east_phi, chord * c - north_phi
        return chord * c, chord * s, 2 * h, east_h, north_h, east_phi, north_phi, 1 - 2 * h_phi


ARC = Motion("arc", step, hold, ArcLanes)
