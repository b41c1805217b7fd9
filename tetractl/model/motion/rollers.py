"""Rollers and helices with unequal step-outs in a rotating field: its axis and frequency move all.

A robot moves along the direction u of the field's axis, at once, with a speed that depends on the
frequency f of the field [rad/s],

    v(f) = k f  up to the robot's step-out,     k (f - sqrt(f^2 - step-out^2))  above it

(Adler's equation, averaged). The robot's `a` is its step-out [rad/s]: as in (3), the greatest rate
at which the field turns it. Its `speed` is the greatest one, k a. Its heading is the direction
sent. `tetractl.reproduce.roller_plan` has the plan in closed form.
"""

import math
from typing import Any

import numpy as np

from tetractl.core.poses import Floats, wrap
from tetractl.model.motion.motion import (
    Derivatives,
    Effect,
    Held,
    Motion,
    PlainLanes,
    Time,
    XYHeading,
)
from tetractl.model.motion.polynomials import onwards


def turned(frequency: Floats, step_out: Floats) -> Floats:
    """Return the mean rates at which a field of these frequencies turns robots [rad/s]."""
    slip = np.sqrt(np.maximum((frequency - step_out) * (frequency + step_out), 0.0))
    return frequency - slip


def under(frequency: Floats, a: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Return a and the speeds at frequencies [rad/s] of robots with step-outs a and speeds v."""
    return a, v / a * turned(frequency, a)


def step(
    x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
) -> XYHeading:
    """Move along u at the speed v."""
    return x + t * v * np.cos(u), y + t * v * np.sin(u), heading + wrap(u - heading)


def hold(
    x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
) -> XYHeading:
    """Move along the direction held; a robot that stands keeps its heading."""
    x, y, turned = step(x, y, heading, held.direction, a, v, t)
    return x, y, np.where(t > 0, turned, heading)


def differentiate(c: float, s: float, cu: float, su: float, own: Any, t: float) -> Derivatives:
    """Return a step and its derivatives."""
    way = t * own[1]
    east, north, turn = way * cu, way * su, math.atan2(su * c - cu * s, cu * c + su * s)
    by_parameters = (0.0, 0.0, 0.0), (east, north, 0.0)
    return (east, north, turn), (0.0, 0.0, 0.0), (-north, east, 1.0), by_parameters


class RollerLanes(PlainLanes):
    """The constants of a step."""

    differentiate = staticmethod(differentiate)

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, cos and sin of the heading at the end of the step."""
        return onwards(x, y, c, s, differentiate(c, s, cu, su, k[:-1], k[-1])[0])


ROLLERS = Motion(
    "rollers", step, hold, RollerLanes, Effect("frequency", "rad/s", under, needed=True)
)
