"""The functions of `elementary` for large arrays, with the same bits.

Each function takes the same steps as the function of the same name for numbers. The steps are
additions, products, divisions and comparisons of NumPy, which IEEE 754 rounds in the same way on
every processor. Nothing is added up over an array, so the order of elements does not matter.

Functions named `is_...` check which arguments a function accepts. They exclude NaN, infinite
numbers, and arguments whose results are near the limits of floats. `elementwise` computes those one
by one.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tetractl.core import elementary
from tetractl.core.elementary import (
    ANGLE_MAX,
    FIRST_LIMIT,
    HALF_PI_1,
    HALF_PI_2,
    HALF_PI_3,
    LN_2_1,
    LN_2_2,
    ONE_OVER_LN_2,
    ROOT_HALF,
    SECOND_LIMIT,
    TWO_OVER_PI,
    arctan_near_0,
    artanh_near_0,
    cos_near_0,
    expm1_near_0,
    sin_near_0,
)

Floats = NDArray[np.float64]

EXPONENT_MAX = 300.0
"""Limit of |x| below which `expm1` accepts an argument.

Below it, powers of two stay in the range of floats, and neither the 1 nor the power of expm1 may
be neglected.
"""


def sin(x: Floats) -> Floats:
    """Compute the sine of angles x [rad] below ANGLE_MAX."""
    k, r = _quarter_turns(x)
    value: Floats = np.where((k & 1) != 0, cos_near_0(r), sin_near_0(r))
    return np.where((k & 2) != 0, -value, value)


def cos(x: Floats) -> Floats:
    """Compute the cosine of angles x [rad] below ANGLE_MAX."""
    k, r = _quarter_turns(x)
    value: Floats = np.where((k & 1) != 0, sin_near_0(r), cos_near_0(r))
    return np.where(((k + 1) & 2) != 0, -value, value)


def _quarter_turns(x: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Split angles [rad] into the nearest number of quarter turns and the remainder [rad]."""
    k = np.floor(x * TWO_OVER_PI + 0.5)
    r = ((x - k * HALF_PI_1) - k * HALF_PI_2) - k * HALF_PI_3
    return k.astype(np.int64), r


def exp(x: Floats) -> Floats:
    """Compute e^x for arrays with x below `elementary.EXPONENT_MAX`."""
    k, p = _powers(np.maximum(x, -elementary.EXPONENT_MAX))  # from there on, the result is 0
    half = k >> 1
    return (1.0 + p) * np.ldexp(1.0, half) * np.ldexp(1.0, k - half)


def expm1(x: Floats) -> Floats:
    """Compute e^x - 1 for arrays with |x| below EXPONENT_MAX, precisely also near 0."""
    k, p = _powers(x)
    power = np.ldexp(1.0, k)
    return np.where(k == 0, p, (power - 1.0) + power * p)


def _powers(x: Floats) -> tuple[NDArray[np.int32], Floats]:
    """Split e^x into a power of two 2^k and a factor 1 + p; return k and p."""
    k = np.floor(x * ONE_OVER_LN_2 + 0.5)
    p = expm1_near_0((x - k * LN_2_1) - k * LN_2_2)
    return k.astype(np.int32), p


def log(x: Floats) -> Floats:
    """Compute the natural logarithm of positive finite numbers."""
    m, k = np.frexp(x)
    is_low = m < ROOT_HALF
    m = np.where(is_low, 2.0 * m, m)
    k = k - is_low
    f = (m - 1.0) / (m + 1.0)
    return k * LN_2_1 + (2.0 * artanh_near_0(f) + k * LN_2_2)


def log1p(x: Floats) -> Floats:
    """Compute ln(1 + x) if 1 + x is positive and finite."""
    whole = 1.0 + x
    return log(whole) + (x - (whole - 1.0)) / whole


def tanh(x: Floats) -> Floats:
    """Compute the hyperbolic tangent for arrays with |2 x| below EXPONENT_MAX."""
    rest = expm1(-2.0 * np.abs(x))
    value = rest / (2.0 + rest)
    return np.where(x < 0, value, -value)


def atan2(y: Floats, x: Floats) -> Floats:
    """Compute the angle of finite points (x, y) other than the origin [rad], from -pi to pi."""
    low = np.minimum(np.abs(x), np.abs(y))
    high = np.maximum(np.abs(x), np.abs(y))
    j = (low > FIRST_LIMIT * high).astype(np.int64) + (low > SECOND_LIMIT * high)
    tan = np.array(elementary.TAN_EIGHTH_TURN)[j]
    z = (low - tan * high) / (high + tan * low)
    angle: Floats = j * (math.pi / 8) + arctan_near_0(z)
    angle = np.where(np.abs(y) > np.abs(x), math.pi / 2 - angle, angle)
    angle = np.where(x < 0, math.pi - angle, angle)
    return np.where(y < 0, -angle, angle)


def is_angle(x: Floats) -> NDArray[np.bool_]:
    """Check which angles [rad] `sin` and `cos` accept: below ANGLE_MAX in magnitude, not NaN."""
    return np.abs(x) < ANGLE_MAX


def is_exponent(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `expm1` accepts: below EXPONENT_MAX in magnitude."""
    return np.abs(x) < EXPONENT_MAX


def is_finite_exponent(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `exp` accepts: numbers below `elementary.EXPONENT_MAX`."""
    return x < elementary.EXPONENT_MAX


def is_half_exponent(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `tanh` accepts: below half of EXPONENT_MAX in magnitude."""
    return is_exponent(2.0 * x)


def is_positive(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `log` accepts: positive and finite numbers."""
    return (x > 0.0) & (x < np.inf)


def is_above_minus_1(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `log1p` accepts: finite numbers above -1."""
    return is_positive(1.0 + x)


def is_off_origin(y: Floats, x: Floats) -> NDArray[np.bool_]:
    """Check which points `atan2` accepts: finite points other than the origin."""
    return is_positive(np.abs(x) + np.abs(y))
