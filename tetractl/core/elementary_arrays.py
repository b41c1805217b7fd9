"""The functions of `elementary` for large arrays, with the same bits.

Each function takes the same steps as the function of the same name for numbers. The steps are
additions, products, divisions and comparisons of NumPy, which IEEE 754 rounds in the same way on
every processor. Nothing is added up over an array, so the order of elements does not matter.

The functions named `accepts_...` check which arguments a function accepts. They exclude NaN,
infinite numbers, and arguments whose results are near the limits of floats. `elementwise` computes
these arguments one by one.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tetractl.core import elementary
from tetractl.core.elementary import (
    ANGLE_MAX,
    HALF_PI_HIGH,
    HALF_PI_LOW,
    HALF_PI_MIDDLE,
    LN_2_HIGH,
    LN_2_LOW,
    ONE_OVER_LN_2,
    ROOT_HALF,
    TAN_3_PI_16,
    TAN_PI_16,
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

Below it, powers of two stay in the range of floats, so that no case needs a formula of its own.
"""


def sin(x: Floats) -> Floats:
    """Compute the sine of angles x [rad] below ANGLE_MAX."""
    quarter_turns, remainder = _reduce_angles(x)
    value: Floats = np.where((quarter_turns & 1) != 0, cos_near_0(remainder), sin_near_0(remainder))
    return np.where((quarter_turns & 2) != 0, -value, value)


def cos(x: Floats) -> Floats:
    """Compute the cosine of angles x [rad] below ANGLE_MAX."""
    quarter_turns, remainder = _reduce_angles(x)
    value: Floats = np.where((quarter_turns & 1) != 0, sin_near_0(remainder), cos_near_0(remainder))
    return np.where(((quarter_turns + 1) & 2) != 0, -value, value)


def _reduce_angles(x: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Split angles [rad] into the nearest number of quarter turns and the remainder [rad]."""
    quarter_turns = np.floor(x * TWO_OVER_PI + 0.5)
    remainder = (
        (x - quarter_turns * HALF_PI_HIGH) - quarter_turns * HALF_PI_MIDDLE
    ) - quarter_turns * HALF_PI_LOW
    return quarter_turns.astype(np.int64), remainder


def exp(x: Floats) -> Floats:
    """Compute e^x for arrays with x below `elementary.EXPONENT_MAX`."""
    # from there on, the result is 0
    k, expm1_remainder = _split_powers(np.maximum(x, -elementary.EXPONENT_MAX))
    half = k >> 1
    return (1.0 + expm1_remainder) * np.ldexp(1.0, half) * np.ldexp(1.0, k - half)


def expm1(x: Floats) -> Floats:
    """Compute e^x - 1 for arrays with |x| below EXPONENT_MAX, precisely also near 0."""
    k, expm1_remainder = _split_powers(x)
    power = np.ldexp(1.0, k)
    return np.where(k == 0, expm1_remainder, (power - 1.0) + power * expm1_remainder)


def _split_powers(x: Floats) -> tuple[NDArray[np.int32], Floats]:
    """Split e^x into a power of two and a factor: e^x = 2^k (1 + p). Return k and p."""
    k = np.floor(x * ONE_OVER_LN_2 + 0.5)
    expm1_remainder = expm1_near_0((x - k * LN_2_HIGH) - k * LN_2_LOW)
    return k.astype(np.int32), expm1_remainder


def log(x: Floats) -> Floats:
    """Compute the natural logarithm of positive finite numbers."""
    mantissa, exponent = np.frexp(x)
    is_low = mantissa < ROOT_HALF
    mantissa = np.where(is_low, 2.0 * mantissa, mantissa)
    exponent = exponent - is_low
    ratio = (mantissa - 1.0) / (mantissa + 1.0)
    return exponent * LN_2_HIGH + (2.0 * artanh_near_0(ratio) + exponent * LN_2_LOW)


def log1p(x: Floats) -> Floats:
    """Compute ln(1 + x) if 1 + x is positive and finite."""
    one_plus_x = 1.0 + x
    return log(one_plus_x) + (x - (one_plus_x - 1.0)) / one_plus_x


def tanh(x: Floats) -> Floats:
    """Compute the hyperbolic tangent for arrays with |2 x| below EXPONENT_MAX."""
    expm1_of_minus_2x = expm1(-2.0 * np.abs(x))
    negative_tanh = expm1_of_minus_2x / (2.0 + expm1_of_minus_2x)
    return np.where(x < 0, negative_tanh, -negative_tanh)


def atan2(y: Floats, x: Floats) -> Floats:
    """Compute the angle of finite points (x, y) other than the origin [rad], from -pi to pi."""
    smaller = np.minimum(np.abs(x), np.abs(y))
    larger = np.maximum(np.abs(x), np.abs(y))
    j = (smaller > TAN_PI_16 * larger).astype(np.int64) + (smaller > TAN_3_PI_16 * larger)
    tangent = np.array(elementary.TANGENTS_OF_EIGHTHS)[j]
    remaining_tangent = (smaller - tangent * larger) / (larger + tangent * smaller)
    angle: Floats = j * (math.pi / 8) + arctan_near_0(remaining_tangent)
    angle = np.where(np.abs(y) > np.abs(x), math.pi / 2 - angle, angle)
    angle = np.where(x < 0, math.pi - angle, angle)
    return np.where(y < 0, -angle, angle)


def accepts_sine(x: Floats) -> NDArray[np.bool_]:
    """Check which angles [rad] `sin` and `cos` accept: those below ANGLE_MAX in magnitude."""
    return np.abs(x) < ANGLE_MAX


def accepts_expm1(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `expm1` accepts: below EXPONENT_MAX in magnitude."""
    return np.abs(x) < EXPONENT_MAX


def accepts_exp(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `exp` accepts: numbers below `elementary.EXPONENT_MAX`."""
    return x < elementary.EXPONENT_MAX


def accepts_tanh(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `tanh` accepts: below half of EXPONENT_MAX in magnitude."""
    return accepts_expm1(2.0 * x)


def accepts_log(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `log` accepts: positive and finite numbers."""
    return (x > 0.0) & (x < np.inf)


def accepts_log1p(x: Floats) -> NDArray[np.bool_]:
    """Check which arguments `log1p` accepts: finite numbers above -1."""
    return accepts_log(1.0 + x)


def accepts_atan2(y: Floats, x: Floats) -> NDArray[np.bool_]:
    """Check which points `atan2` accepts: finite points other than the origin."""
    return accepts_log(np.abs(x) + np.abs(y))
