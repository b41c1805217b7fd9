"""The paper's discrete model (4)-(6): a straight chord along the old heading, then a turn.

The last direction of a sequence therefore cannot move the last position.
"""

from typing import Any, NamedTuple, Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Held, Motion, Time, XYHeading
from tetractl.model.motion.polynomials import sincos, wrap


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance by (4)-(6)."""
    return (
        x + t * v * np.cos(heading),  # (4)
        y + t * v * np.sin(heading),  # (5)
        heading + t * a * np.sin(u - heading),  # (6)
    )


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Follow the chord of (4)-(5), turning steadily: after a whole period this is (4)-(6)."""
    half, chord, course = 0.5 * held.turning * t, v * t, held.course
    return x + chord * np.cos(course), y + chord * np.sin(course), heading + 2 * half


class EulerLanes(NamedTuple):
    """Constants of (4)-(6): T v and T a."""

    rows: Floats  # (N, size)
    pieces: int = 1
    size = 2

    @classmethod
    def of(cls, a: Floats, v: Floats, t: float) -> Self:
        """Return the constants of robots with a, v (N,) for steps of t [s]."""
        return cls(np.column_stack([v * t, a * t]))

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading after (4)-(6)."""
        step, turn = k
        sw, cw = sincos(wrap(turn * (su * c - cu * s)))
        return x + step * c, y + step * s, c * cw - s * sw, s * cw + c * sw

    @staticmethod
    def differentiate(
        c: float, s: float, cu: float, su: float, a: float, v: float, t: float
    ) -> Derivatives:
        """Return a step of (4)-(6) and its derivatives."""
        way, most = t * v, t * a
        keep = 1 - most * (cu * c + su * s)
        return way * c, way * s, most * (su * c - cu * s), -way * s, way * c, 0.0, 0.0, keep


EULER = Motion("euler", step, hold, EulerLanes)
