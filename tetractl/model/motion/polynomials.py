"""Elementary functions as polynomials, which a compiler can turn into vector code.

They are plain functions of scalars: kernels compile them, and they also work without a compiler.

Coefficients are computed at import, by interpolation at Chebyshev points in the squared argument.
The degree gives an error below 1e-13 on the named range, since the errors of steps add up and a
path must agree with the readable model to 1e-9.
"""

import math
from collections.abc import Callable

import numpy as np

from tetractl.core.poses import Floats

LOG_2 = math.log(2.0)  # ln 2
TAN_EIGHTH = math.tan(math.pi / 8)  # tan of an eighth of a half turn


def fit(function: Callable[[Floats], Floats], top: float, degree: int) -> tuple[float, ...]:
    """Return the coefficients, lowest first, of a polynomial for `function` on [0, top]."""
    series = np.polynomial.Chebyshev.interpolate(function, degree, domain=[0.0, top])
    return tuple(float(c) for c in series.convert(kind=np.polynomial.Polynomial).coef)


def odd(function: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
    """Return f(t)/t of an odd function f, as a function of q = t^2."""

    def ratio(q: Floats) -> Floats:
        root = np.sqrt(q)
        return function(root) / root

    return ratio


_QUARTER = (math.pi / 4) ** 2  # square of the largest angle
SINE = fit(lambda q: np.sinc(np.sqrt(q) / np.pi), _QUARTER, 5)  # sin(t)/t of q = t^2
COSINE = fit(lambda q: np.cos(np.sqrt(q)), _QUARTER, 5)  # cos t
ATANH = fit(odd(np.arctanh), (math.sqrt(2) - 1) ** 4 * 1.01, 5)  # atanh(f)/f
ATAN = fit(odd(np.arctan), TAN_EIGHTH**2 * 1.01, 9)  # atan(z)/z

_HALF_STEP = (LOG_2 / 2) ** 2  # square of half a step of the exponent
COSH = fit(lambda q: np.cosh(np.sqrt(q)), _HALF_STEP, 5)  # cosh t of q = t^2
SINH = fit(odd(np.sinh), _HALF_STEP, 5)  # sinh(t)/t
SHIFT = 1.5 * 2.0**52  # floats near it have the bits of integers
ROOT_HALF_BITS = 0x3FE6A09E667F3BCD  # the bits of the float sqrt(1/2)
DECAY_MAX = 230.0  # beyond, exp(-x) counts as exp(-230), which is 1e-100


def horner(coefficients, q):
    """Return the value of a polynomial, given the lowest coefficient first."""
    value = coefficients[-1]
    for i in range(len(coefficients) - 2, -1, -1):
        value = value * q + coefficients[i]
    return value


def alternating(k, first, end, q):
    """Return the value of a polynomial with the two or more coefficients k[first:end], lowest
    first.

    Even and odd powers are summed separately, which halves the chain of dependent operations.
    """
    q2 = q * q
    odd = k[end - 1]
    even = k[end - 2]
    for i in range(end - 3, first - 1, -1):
        lower = odd * q2 + k[i]
        odd = even
        even = lower
    return odd * q + even


def sincos(x):
    """Return (sin x, cos x) for |x| <= pi, by halving the angle twice."""
    t = 0.25 * x
    q = t * t
    s_quarter = t * horner(SINE, q)
    c_quarter = horner(COSINE, q)
    s_half = 2.0 * s_quarter * c_quarter
    c_half = 1.0 - 2.0 * s_quarter * s_quarter
    return 2.0 * s_half * c_half, 1.0 - 2.0 * s_half * s_half


def wrap(x):
    """Return the angle x wrapped into [-pi, pi]."""
    return x - math.tau * np.rint(x / math.tau)


def onwards(x, y, c, s, step):
    """Return x, y, cos and sin of the heading after a step dx, dy, dheading."""
    dx, dy, turn = step
    sw, cw = sincos(wrap(turn))
    return x + dx, y + dy, c * cw - s * sw, s * cw + c * sw


def mantissa(y):
    """Return (m, k) with y = m 2^k and sqrt(1/2) <= m < sqrt(2), for finite y > 0."""
    bits = np.float64(y).view(np.int64)
    k = (bits - np.int64(ROOT_HALF_BITS)) >> 52
    return np.int64(bits - (k << 52)).view(np.float64), np.float64(k)


def log_from_ratio(f, k):
    """Return ln(m 2^k) from f = (m - 1)/(m + 1): ln m = 2 atanh f."""
    return k * LOG_2 + 2 * f * horner(ATANH, f * f)


def decay(x):
    """Return exp(-x) for x >= 0, or exp(-230) if that is more."""
    x = min(x, DECAY_MAX)
    k = np.rint(x / LOG_2)
    r = k * LOG_2 - x  # exp(-x) = 2^-k exp(r)
    exponent = np.float64(SHIFT - k).view(np.int64) + np.int64(1023)
    power = np.int64(exponent << 52).view(np.float64)  # 2^-k
    return power * (horner(COSH, r * r) + r * horner(SINH, r * r))


def arctan(z):
    """Return atan z, computed from the nearest of 0, pi/4 and pi/2."""
    size = abs(z)
    low = min(size, 1.0)
    high = max(size, 1.0)
    middle = 1.0 if low > TAN_EIGHTH * high else 0.0
    ratio = (low - middle * high) / (high + middle * low)
    value = ratio * horner(ATAN, ratio * ratio) + middle * (math.pi / 4)
    value = math.pi / 2 - value if size > 1.0 else value
    return value if z >= 0 else -value
