"""Elementary functions as polynomials, which a compiler can turn into vector code.

They are plain functions of scalars: kernels compile them, and they also work without a compiler.

Coefficients are written out, lowest first, because computed ones would depend on the processor.
They interpolate at Chebyshev points of the squared argument q. The degree gives an error below
1e-13 on the named range: the errors of steps add up, and a path must agree with the readable model
to 1e-9. The functions of `tetractl.core.elementary` are exact to the last digits, but take longer.
"""

import math

import numpy as np

LOG_2 = 0.6931471805599453  # ln 2
TAN_EIGHTH = math.sqrt(2.0) - 1.0  # tan of an eighth of a half turn

SINE = (
    0.9999999999999948,
    -0.1666666666661352,
    0.008333333323660397,
    -0.00019841263244918644,
    2.75552675340755e-06,
    -2.475654531922431e-08,
)
"""Coefficients of sin(t)/t as a polynomial of q = t^2, for |t| up to pi/4."""
COSINE = (
    0.9999999999999435,
    -0.4999999999934735,
    0.04166666654358041,
    -0.0013888880382498289,
    2.4798927129567507e-05,
    -2.717334712576943e-07,
)
"""Coefficients of cos t as a polynomial of q = t^2, for |t| up to pi/4."""
ATANH = (
    0.9999999999999711,
    0.333333333401693,
    0.19999997336009678,
    0.14286094520176398,
    0.11086637356391349,
    0.09811287139631193,
)
"""Coefficients of atanh(f)/f as a polynomial of q = f^2, for |f| up to (sqrt(2) - 1)^2."""
ATAN = (
    1.0000000000000004,
    -0.33333333333301446,
    0.19999999986792955,
    -0.14285713007974288,
    0.11111055893215314,
    -0.0908960530452157,
    0.07673934282702476,
    -0.06506596272543727,
    0.05022113107122174,
    -0.025229787642710978,
)
"""Coefficients of atan(z)/z as a polynomial of q = z^2, for |z| up to tan(pi/8)."""
COSH = (
    0.9999999999999993,
    0.5000000000001344,
    0.04166666666293897,
    0.0013888889115936552,
    2.4801755610263722e-05,
    2.743549831678975e-07,
)
"""Coefficients of cosh t as a polynomial of q = t^2, for |t| up to ln(2)/2."""
SINH = (
    0.9999999999999991,
    0.16666666666676203,
    0.008333333331481268,
    0.00019841268371201154,
    2.756251300663744e-06,
    2.2357657468102138e-08,
)
"""Coefficients of sinh(t)/t as a polynomial of q = t^2, for |t| up to ln(2)/2."""
SHIFT = 1.5 * 2.0**52
"""A float near which the bits of a float are those of an integer, apart from an offset."""
ROOT_HALF_BITS = 0x3FE6A09E667F3BCD
"""The bits of the float sqrt(1/2)."""
DECAY_MAX = 230.0
"""Maximum argument x of exp(-x). For a larger x, `decay` returns exp(-230), about 1e-100."""


def horner(coefficients, q):
    """Evaluate a polynomial of q, given its coefficients with the lowest power first."""
    value = coefficients[-1]
    for i in range(len(coefficients) - 2, -1, -1):
        value = value * q + coefficients[i]
    return value


def alternating(k, first, end, q):
    """Evaluate a polynomial with two or more coefficients.

    Even and odd powers are summed separately, which halves the chain of dependent operations.

    Args:
        k: Array that contains the coefficients, lowest first.
        first: Index of the first coefficient.
        end: Index after the last coefficient.
        q: The argument.
    """
    q2 = q * q
    odd_sum = k[end - 1]
    even_sum = k[end - 2]
    for i in range(end - 3, first - 1, -1):
        lower = odd_sum * q2 + k[i]
        odd_sum = even_sum
        even_sum = lower
    return odd_sum * q + even_sum


def sincos(x):
    """Compute (sin x, cos x) for |x| <= pi by halving the angle twice."""
    quarter = 0.25 * x
    q = quarter * quarter
    s_quarter = quarter * horner(SINE, q)
    c_quarter = horner(COSINE, q)
    s_half = 2.0 * s_quarter * c_quarter
    c_half = 1.0 - 2.0 * s_quarter * s_quarter
    return 2.0 * s_half * c_half, 1.0 - 2.0 * s_half * s_half


def wrap(x):
    """Wrap an angle x [rad] into [-pi, pi], by adding whole turns."""
    return x - math.tau * np.rint(x / math.tau)


def onwards(x, y, c, s, step):
    """Compute the pose of a robot after a step.

    Args:
        x: x before the step.
        y: y before the step.
        c: Cosine of the heading before the step.
        s: Sine of the heading before the step.
        step: The step: dx, dy, dheading.

    Returns:
        x, y, and the cosine and sine of the heading.
    """
    dx, dy, turn = step
    sin_turn, cos_turn = sincos(wrap(turn))
    return x + dx, y + dy, c * cos_turn - s * sin_turn, s * cos_turn + c * sin_turn


def mantissa(y):
    """Split a finite y > 0 into (m, k) with y = m 2^k and sqrt(1/2) <= m < sqrt(2)."""
    bits = np.float64(y).view(np.int64)
    exponent = (bits - np.int64(ROOT_HALF_BITS)) >> 52
    return np.int64(bits - (exponent << 52)).view(np.float64), np.float64(exponent)


def log_from_ratio(f, k):
    """Compute ln(m 2^k) from f = (m - 1)/(m + 1), because ln m = 2 atanh f."""
    return k * LOG_2 + 2 * f * horner(ATANH, f * f)


def decay(x):
    """Compute exp(-x) for x >= 0. From x = 230 on, the result stays exp(-230)."""
    x = min(x, DECAY_MAX)
    halvings = np.rint(x / LOG_2)
    remainder = halvings * LOG_2 - x  # exp(-x) = 2^-k exp(r)
    exponent = np.float64(SHIFT - halvings).view(np.int64) + np.int64(1023)
    power = np.int64(exponent << 52).view(np.float64)  # 2^-k
    return power * (
        horner(COSH, remainder * remainder) + remainder * horner(SINH, remainder * remainder)
    )


def arctan(z):
    """Compute atan z [rad] by a polynomial, with an error below 1e-13."""
    size = abs(z)
    smaller = min(size, 1.0)
    larger = max(size, 1.0)
    is_past_eighth = 1.0 if smaller > TAN_EIGHTH * larger else 0.0
    ratio = (smaller - is_past_eighth * larger) / (larger + is_past_eighth * smaller)
    value = ratio * horner(ATAN, ratio * ratio) + is_past_eighth * (math.pi / 4)
    value = math.pi / 2 - value if size > 1.0 else value
    return value if z >= 0 else -value
