"""Turning rates of robots that turn faster to one side, or whose motors saturate.

These are extensions of the paper's equation (3). A robot turns with the rate a exp(k) to the left
and a exp(-k) to the right, where k is its `side`. It never turns faster than `saturation` times the
larger of these two rates. `saturation` is 1 for motors that never saturate.

Under a held direction, the side does not change. A step of any motion is therefore a step with a
exp(+-k) instead of a. While motors saturate, a is chosen so that the robot turns at its maximum
rate in the middle of the step. The turn then differs by the order of its third power.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from tetractl.core.elementary import exp
from tetractl.core.poses import Floats
from tetractl.model.motion.motion import Derivatives
from tetractl.model.motion.polynomials import sincos


class RobotParameters(NamedTuple):
    """The parameters of one robot: the PARAMETERS of its motion, its side and its saturation."""

    a: float
    speed: float
    side: float
    saturation: float


def parameters_in_rows(robots: Any) -> Floats:
    """Collect the `RobotParameters` of a problem's robots in an array (N, 4)."""
    rows = np.empty((len(robots.a), 4))
    rows[:, 0] = robots.a
    rows[:, 1] = robots.speed
    rows[:, 2] = 0.0 if robots.side is None else robots.side
    rows[:, 3] = 1.0 if robots.saturation is None else robots.saturation
    return rows


def is_left(
    heading_cos: float, heading_sin: float, direction_cos: float, direction_sin: float
) -> bool:
    """Check whether a robot turns to the left, or not at all.

    Args:
        heading_cos: Cosine of the heading.
        heading_sin: Sine of the heading.
        direction_cos: Cosine of the direction.
        direction_sin: Sine of the direction.
    """
    return direction_sin * heading_cos - direction_cos * heading_sin >= 0


def compute_turning_rate(
    heading_cos: float,
    heading_sin: float,
    direction_cos: float,
    direction_sin: float,
    robot: Any,
    t: float,
) -> Any:
    """Compute the turning rate a of a step, and the derivatives of its logarithm.

    Args:
        heading_cos: Cosine of the heading.
        heading_sin: Sine of the heading.
        direction_cos: Cosine of the direction u.
        direction_sin: Sine of the direction u.
        robot: The robot's `RobotParameters`.
        t: Duration of the step [s].

    Returns:
        a [rad/s], and the derivatives of ln a with respect to phi = u - heading, `side` and ln
        `saturation`.
    """
    a, _, side, saturation = robot
    sin_phi = direction_sin * heading_cos - direction_cos * heading_sin
    side_factor = exp(side)
    sign = 1.0 if sin_phi >= 0 else -1.0  # 1 to the left
    rate = a * side_factor if sin_phi >= 0 else a / side_factor
    if saturation >= 1:
        return rate, (0.0, sign, 0.0)
    rate_max = a * max(side_factor, 1 / side_factor) * saturation
    cos_phi = direction_cos * heading_cos + direction_sin * heading_sin
    sin_phi_size = abs(sin_phi)
    # half the turn of the step, and sin |phi| in the middle of it
    sin_half_turn, cos_half_turn = sincos(
        min(0.5 * t * min(rate * sin_phi_size, rate_max), math.pi)
    )
    sin_middle = sin_phi_size * cos_half_turn - cos_phi * sin_half_turn
    if rate * sin_middle <= rate_max:
        return rate, (0.0, sign, 0.0)
    slope = -sign * (cos_phi * cos_half_turn + sin_phi_size * sin_half_turn) / sin_middle
    return rate_max / sin_middle, (slope, 1.0 if side >= 0 else -1.0, 1.0)


def compute_held_turning_rate(a: float, slopes: Any, c: float, s: float, hold: Any) -> Any:
    """Compute the turning rate of wheels that keep a rate until the next rate is sent.

    Such wheels are sent the rate a sin(phi) of a heading. This is Euler's method. By its modified
    equation (Hairer, Lubich and Wanner, Geometric Numerical Integration, section IX.1), phi follows
    to the third order, with x_k = a^k hold_k,

        phi' = -a sin(phi) (1 + x_1 c / 2 + x_2 (c^2 / 3 - s^2 / 12) + x_3 (c^3 / 4 - c s^2 / 6)).

    Args:
        a: Turning rate [rad/s].
        slopes: Derivatives of ln a, as `compute_turning_rate` returns them.
        c: Cosine of phi.
        s: Sine of phi.
        hold: Means over time of the first three powers of how long a rate is kept [s, s2, s3].
    """
    rate = min(a, 1.0 / hold[0])  # beyond, the series says nothing
    x_1 = rate * hold[0]
    x_2 = rate * rate * hold[1]
    x_3 = rate * rate * rate * hold[2]
    factor = 1 + x_1 * c / 2 + x_2 * (c * c / 3 - s * s / 12)
    factor += x_3 * c * (c * c / 4 - s * s / 6)
    slope = x_1 / 2 + x_2 * c * 5 / 6 + x_3 * (c * c * 13 / 12 - s * s / 6)
    return a * factor, (slopes[0] - s * slope / factor, slopes[1], slopes[2])


def scale_derivatives(derivatives: Any, factor: float) -> Any:
    """Multiply the derivatives of x, y and heading by a factor."""
    return derivatives[0] * factor, derivatives[1] * factor, derivatives[2] * factor


def add_turning_derivatives(derivatives: Derivatives, slopes: Any) -> Derivatives:
    """Add the derivatives with respect to side and saturation to a step's `Derivatives`.

    The step was computed with the turning rate a of `compute_turning_rate`, and `slopes` are the
    derivatives of ln a that this function returned. The derivatives with respect to heading and
    direction are corrected, because a depends on them.
    """
    (
        step,
        (x_by_heading, y_by_heading, turn_by_heading),
        (x_by_u, y_by_u, turn_by_u),
        (by_a, by_speed),
    ) = derivatives
    x_by_phi, y_by_phi, turn_by_phi = scale_derivatives(
        by_a, slopes[0]
    )  # by phi: a changes with it, too
    by_heading = (x_by_heading - x_by_phi, y_by_heading - y_by_phi, turn_by_heading - turn_by_phi)
    by_u = (x_by_u + x_by_phi, y_by_u + y_by_phi, turn_by_u + turn_by_phi)
    by_side = scale_derivatives(by_a, slopes[1])
    by_saturation = scale_derivatives(by_a, slopes[2])
    return step, by_heading, by_u, (by_a, by_speed, by_side, by_saturation)
