"""The paper's discrete model (4)-(6): a straight chord along the old heading, then a turn.

The last direction of a sequence therefore cannot move the last position.
"""

from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion.motion import (
    Derivatives,
    Held,
    Motion,
    PlainLanes,
    Time,
    XYHeading,
    onwards,
)


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


def differentiate(
    c: float, s: float, cu: float, su: float, a: float, v: float, t: float
) -> Derivatives:
    """Return a step of (4)-(6) and its derivatives."""
    way, most = t * v, t * a
    turn, keep = most * (su * c - cu * s), 1 - most * (cu * c + su * s)
    return way * c, way * s, turn, -way * s, way * c, 0.0, 0.0, keep, 0.0, 0.0, turn


class EulerLanes(PlainLanes):
    """The constants of (4)-(6)."""

    differentiate = staticmethod(differentiate)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading at the end of the step."""
        return onwards(x, y, c, s, differentiate(c, s, cu, su, k[0], k[1], k[2]))


EULER = Motion("euler", step, hold, EulerLanes)
