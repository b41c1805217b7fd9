"""Elementary functions of one number, with the same bits on every processor.

The functions `sin`, `exp` and `log` of the C library and of NumPy use different code on different
processors. Their results differ in the last bits, and this may lead to another plan and another
trial. The functions here use only what IEEE 754 rounds correctly everywhere: + - * /, square roots
and powers of two.

Kernels compile these functions, and plain Python code calls them as they are, with the same bits.
`elementary_arrays` has the same functions for arrays. The error of each function is at most 8 units
in the last place.

The functions are Taylor series, after the argument has been reduced to a small range:

    sin, cos     x - k pi/2 in [-pi/4, pi/4], for the nearest whole number k
    exp, expm1   x - k ln 2 in [-ln(2)/2, ln(2)/2]
    log          x = m 2^k with sqrt(1/2) <= m < sqrt(2); ln m = 2 atanh((m - 1)/(m + 1))
    atan         the nearest of 0, pi/8, ..., pi/2 is taken off the angle: less than pi/16 is left
"""

import math

# Tables of the reduction: a first part with few digits, whose product with k is exact, and the
# rest.
TWO_OVER_PI = 2 / math.pi
HALF_PI_1 = float.fromhex("0x1.921fb544p+0")
HALF_PI_2 = float.fromhex("0x1.0b4611a6p-34")
HALF_PI_3 = float.fromhex("0x1.3198a2e037073p-69")
ONE_OVER_LN_2 = float.fromhex("0x1.71547652b82fep+0")
LN_2 = float.fromhex("0x1.62e42fefa39efp-1")
LN_2_1 = float.fromhex("0x1.62e42feep-1")
LN_2_2 = float.fromhex("0x1.a39ef35793c76p-33")
ROOT_HALF = math.sqrt(0.5)
TAN_EIGHTH_TURN = (0.0, math.sqrt(2.0) - 1.0, 1.0)
"""tan(j pi/8) for j = 0, 1, 2: the angles that `atan2` subtracts."""
FIRST_LIMIT = float.fromhex("0x1.975f5e0553158p-3")
"""tan(pi/16): above this ratio, `atan2` subtracts the angle pi/8."""
SECOND_LIMIT = float.fromhex("0x1.561b82ab7f990p-1")
"""tan(3 pi/16): above this ratio, `atan2` subtracts the angle pi/4."""

ANGLE_MAX = 1e6
"""Limit of angles [rad] below which `sin` and `cos` need not subtract whole turns first."""
EXPONENT_MAX = 800.0
"""Limit of |x| from which exp(x) is infinite for a positive x, and 0 for a negative x."""


def without_quarter_turns(x):
    """Subtract whole quarter turns from an angle x [rad], so that a short series suffices.

    Returns:
        k: The number of quarter turns; an integer.
        r: The remaining angle, |r| <= pi/4 [rad]; NaN if x is not finite.
    """
    if not abs(x) < ANGLE_MAX:
        if not abs(x) < math.inf:
            return 0, math.nan
        x = x % math.tau
    k = math.floor(x * TWO_OVER_PI + 0.5)
    return k, ((x - k * HALF_PI_1) - k * HALF_PI_2) - k * HALF_PI_3


def sin(x):
    """Compute the sine of an angle x [rad], with the same bits on every processor.

    The result is NaN if x is not finite.
    """
    k, r = without_quarter_turns(x)
    value = cos_near_0(r) if k & 1 else sin_near_0(r)
    return -value if k & 2 else value


def cos(x):
    """Compute the cosine of an angle x [rad], with the same bits on every processor.

    The result is NaN if x is not finite.
    """
    k, r = without_quarter_turns(x)
    value = sin_near_0(r) if k & 1 else cos_near_0(r)
    return -value if (k + 1) & 2 else value


def sin_near_0(r):
    """Compute sin r for |r| <= pi/4, by a polynomial."""
    square = r * r
    series = 1 / 1307674368000
    series = 1 / 6227020800 - square * series
    series = 1 / 39916800 - square * series
    series = 1 / 362880 - square * series
    series = 1 / 5040 - square * series
    series = 1 / 120 - square * series
    series = 1 / 6 - square * series
    return r - r * square * series


def cos_near_0(r):
    """Compute cos r for |r| <= pi/4, by a polynomial."""
    square = r * r
    series = 1 / 20922789888000
    series = 1 / 87178291200 - square * series
    series = 1 / 479001600 - square * series
    series = 1 / 3628800 - square * series
    series = 1 / 40320 - square * series
    series = 1 / 720 - square * series
    series = 1 / 24 - square * series
    return 1.0 - square * (0.5 - square * series)


def without_powers_of_2(x):
    """Write e^x as 2^k e^r with a small r, for |x| < EXPONENT_MAX.

    Returns:
        k: An integer.
        r: The rest of the exponent, |r| <= ln(2)/2.
    """
    k = math.floor(x * ONE_OVER_LN_2 + 0.5)
    return k, (x - k * LN_2_1) - k * LN_2_2


def exp(x):
    """Compute e^x.

    The result is infinite from x = EXPONENT_MAX on, or if it is too large for a float.
    """
    if not abs(x) < EXPONENT_MAX:
        return _exp_of_large(x)
    k, r = without_powers_of_2(x)
    p = expm1_near_0(r)
    # in two steps, of which neither leaves the range of floats too early
    return (1.0 + p) * power_of_2(k >> 1) * power_of_2(k - (k >> 1))


def expm1(x):
    """Compute e^x - 1, without loss of precision for small x."""
    if not abs(x) < EXPONENT_MAX:
        return _exp_of_large(x) - 1.0
    k, r = without_powers_of_2(x)
    p = expm1_near_0(r)
    if k == 0:
        return p
    if k > 1000:  # less than a last place is neglected
        return exp(x)
    power = power_of_2(k) if k > -1000 else 0.0
    return (power - 1.0) + power * p


def _exp_of_large(x):
    """Compute e^x for |x| beyond EXPONENT_MAX, and for NaN."""
    if x > 0:
        return math.inf
    return 0.0 if x < 0 else math.nan


def expm1_near_0(r):
    """Compute e^r - 1 for |r| <= ln(2)/2."""
    series = 1 / 87178291200
    series = 1 / 6227020800 + r * series
    series = 1 / 479001600 + r * series
    series = 1 / 39916800 + r * series
    series = 1 / 3628800 + r * series
    series = 1 / 362880 + r * series
    series = 1 / 40320 + r * series
    series = 1 / 5040 + r * series
    series = 1 / 720 + r * series
    series = 1 / 120 + r * series
    series = 1 / 24 + r * series
    series = 1 / 6 + r * series
    series = 1 / 2 + r * series
    return r + r * r * series


def power_of_2(k):
    """Compute 2^k for a whole number k from -1022 to 1023."""
    return math.ldexp(1.0, k)


def log(x):
    """Compute the natural logarithm. It is -infinite for 0, and NaN for negative numbers."""
    if not 0.0 < x < math.inf:
        if x == 0.0:
            return -math.inf
        return x if x > 0.0 else math.nan
    m, k = math.frexp(x)
    if m < ROOT_HALF:
        m = 2.0 * m
        k -= 1
    f = (m - 1.0) / (m + 1.0)
    return k * LN_2_1 + (2.0 * artanh_near_0(f) + k * LN_2_2)


def log1p(x):
    """Compute ln(1 + x), without loss of precision for small x.

    The result is -infinite for x = -1, and NaN below.
    """
    whole = 1.0 + x
    if not 0.0 < whole < math.inf:
        return log(whole)
    return log(whole) + (x - (whole - 1.0)) / whole


def artanh_near_0(f):
    """Compute artanh f for |f| < 0.172."""
    square = f * f
    series = 1 / 23
    series = 1 / 21 + square * series
    series = 1 / 19 + square * series
    series = 1 / 17 + square * series
    series = 1 / 15 + square * series
    series = 1 / 13 + square * series
    series = 1 / 11 + square * series
    series = 1 / 9 + square * series
    series = 1 / 7 + square * series
    series = 1 / 5 + square * series
    series = 1 / 3 + square * series
    return f + f * square * series


def tanh(x):
    """Compute the hyperbolic tangent, with the same bits on every processor."""
    rest = expm1(-2.0 * abs(x))
    value = rest / (2.0 + rest)
    return value if x < 0 else -value


def atan(x):
    """Compute the angle with tangent x [rad], from -pi/2 to pi/2."""
    return atan2(x, 1.0)


def atan2(y, x):
    """Compute the angle of the point (x, y) [rad], from -pi to pi.

    The result is 0 at the origin, and NaN if a coordinate is NaN.
    """
    total = abs(x) + abs(y)
    if not total > 0.0:
        return 0.0 if total == 0.0 else math.nan
    low = min(abs(x), abs(y))
    high = max(abs(x), abs(y))
    j = 0
    if low > SECOND_LIMIT * high:
        j = 2
    elif low > FIRST_LIMIT * high:
        j = 1
    tan = TAN_EIGHTH_TURN[j]
    z = (low - tan * high) / (high + tan * low)
    angle = j * (math.pi / 8) + arctan_near_0(z)
    if abs(y) > abs(x):
        angle = math.pi / 2 - angle
    if x < 0:
        angle = math.pi - angle
    return -angle if y < 0 else angle


def arctan_near_0(z):
    """Compute arctan z for |z| < 0.2."""
    square = z * z
    series = 1 / 23
    series = 1 / 21 - square * series
    series = 1 / 19 - square * series
    series = 1 / 17 - square * series
    series = 1 / 15 - square * series
    series = 1 / 13 - square * series
    series = 1 / 11 - square * series
    series = 1 / 9 - square * series
    series = 1 / 7 - square * series
    series = 1 / 5 - square * series
    series = 1 / 3 - square * series
    return z - z * square * series


def hypot(x, y):
    """Compute the length of the vector (x, y), also if its square would overflow."""
    size = max(abs(x), abs(y))
    if not 0.0 < size < math.inf:
        return size
    along = x / size  # else the squares of large lengths would overflow
    across = y / size
    return size * math.sqrt(along * along + across * across)


def log_of_sum(ln_x, ln_y):
    """Compute ln(x + y) from ln x and ln y, where -inf means 0."""
    high = max(ln_x, ln_y)
    if high == -math.inf:
        return high
    return high + log1p(exp(min(ln_x, ln_y) - high))
