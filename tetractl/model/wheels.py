"""A two-wheeled robot standing in for a cell, (21)-(25)."""

import numpy as np

from tetractl.core.poses import Floats


def wheel_speeds(
    heading: Floats, u: Floats | float, a: Floats, v: Floats, r: Floats | float
) -> tuple[Floats, Floats]:
    """Return (left, right) wheel speeds [length unit/s] that turn a robot like a cell, (24)-(25).

    heading, a [rad/s] and v [length unit/s] have shape (N,); r is the distance from a wheel to the
    centre [length unit].
    """
    difference = a * r * np.sin(u - heading)
    return v - difference, v + difference


def body_velocity(left: Floats, right: Floats, r: Floats | float) -> tuple[Floats, Floats]:
    """Return (speed v [length unit/s], turning rate [rad/s]) of given wheel speeds.

    dx/dt = (right + left) cos(heading) / 2                                             (21)
    dy/dt = (right + left) sin(heading) / 2                                             (22)
    dheading/dt = (right - left) / (2 r)                                                (23)
    """
    return (right + left) / 2, (right - left) / (2 * r)
