"""The paper's discrete model (4)-(6): robots drive straight along the old heading, then turn.

The last direction of a sequence therefore has no effect on the final position.
"""

from typing import Any

from tetractl.core import elementwise
from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives, Held, Motion, PlainLanes, Time, XYHeading
from tetractl.model.motion.polynomials import onwards


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Advance robots by one step of Euler's method, the paper's (4)-(6); see `StepFunction`."""
    return (
        x + t * v * elementwise.cos(heading),  # (4)
        y + t * v * elementwise.sin(heading),  # (5)
        heading + t * a * elementwise.sin(u - heading),  # (6)
    )


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Compute poses along the chord of (4)-(5) with a constant turning rate; see `Hold`.

    After a whole period, this equals (4)-(6).
    """
    chord = v * t
    half_turn = 0.5 * held.turning * t
    return (
        x + chord * elementwise.cos(held.course),
        y + chord * elementwise.sin(held.course),
        heading + 2 * half_turn,
    )


def differentiate(c: float, s: float, cu: float, su: float, robot: Any, t: float) -> Derivatives:
    """Compute a step of (4)-(6) and its derivatives; see `Lanes.differentiate`.

    The derivatives with respect to ln a and ln v are the turn and the chord.
    """
    a, v = robot[:2]
    chord = t * v
    east = chord * c
    north = chord * s
    turn_max = t * a
    turn = turn_max * (su * c - cu * s)
    turn_u = turn_max * (cu * c + su * s)  # dturn/du
    by_heading = (-north, east, 1 - turn_u)
    by_u = (0.0, 0.0, turn_u)
    by_ln_a = (0.0, 0.0, turn)
    by_ln_speed = (east, north, 0.0)
    return (east, north, turn), by_heading, by_u, (by_ln_a, by_ln_speed)


class EulerLanes(PlainLanes):
    """The constants of the discrete model (4)-(6) for compiled code, and its compiled step."""

    differentiate = staticmethod(differentiate)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Compute x, y, cos and sin of the heading at the end of the step; see `Lanes.advance`."""
        return onwards(x, y, c, s, differentiate(c, s, cu, su, k[:-1], k[-1])[0])


EULER = Motion("euler", step, hold, EulerLanes)
