"""The paper's equations of a robot with two wheels: arcs (21)-(23), wheel speeds (24)-(25)."""

from typing import Any

from tetractl.core.elementary import cos, sin

SERIES_HALF_TURN_RAD = 0.3
"""Half the angle of an arc [rad] up to which sin(h)/h is computed by a series.

The series has four terms, with an error below 1e-9.
"""


def wheel_speeds(sine: Any, a: Any, v: Any, radius: Any) -> Any:
    """Compute left and right wheel speeds by the paper's (24)-(25) [length unit/s].

    Args:
        sine: sin(u - heading).
        a: Turning rate [rad/s].
        v: Speed [length unit/s].
        radius: Distance from a wheel to the centre [length unit].
    """
    difference = a * radius * sine
    return v - difference, v + difference


def arc_displacement(heading: float, angle: float, distance: float) -> tuple[float, float]:
    """Compute the displacement x, y on an arc by (21)-(23).

    Args:
        heading: Heading at the beginning of the arc [rad].
        angle: Angle by which the robot turns [rad].
        distance: Length of the arc [length unit].
    """
    half = angle / 2
    if abs(half) <= SERIES_HALF_TURN_RAD:
        square = angle * angle / 4
        sinc = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
    else:
        sinc = sin(half) / half
    chord = distance * sinc
    return chord * cos(heading + half), chord * sin(heading + half)
