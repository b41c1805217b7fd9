"""Elementary functions of one number, with the same bits on every processor.

The functions `sin`, `exp` and `log` of the C library and of NumPy use different code on different
processors. Their results differ in the last bits, and this may lead to another plan and another
trial. The functions here use only what IEEE 754 rounds correctly everywhere: + - * /, square roots
and powers of two.

Kernels compile these functions, and plain Python code calls them as they are, with the same bits.
`elementary_arrays` has the same functions for arrays. The error of each function is at most 8 units
in the last place.

The functions are Taylor series, after the argument x has been reduced to a small range. There, r
is the remainder, and k a whole number:

    sin, cos     x = k pi/2 + r, with r in [-pi/4, pi/4]
    exp, expm1   x = k ln 2 + r, with r in [-ln(2)/2, ln(2)/2]
    log          x = m 2^k with sqrt(1/2) <= m < sqrt(2); ln m = 2 atanh((m - 1)/(m + 1))
    atan         the nearest of 0, pi/8, ..., pi/2 is subtracted from the angle, so that less than
                 pi/16 remains
"""

import math

# Constants of the reduction. pi/2 and ln 2 are sums of several numbers. All but the smallest have
# few digits, so that their products with k are exact.
TWO_OVER_PI = 2 / math.pi
HALF_PI_HIGH = float.fromhex("0x1.921fb544p+0")
HALF_PI_MIDDLE = float.fromhex("0x1.0b4611a6p-34")
HALF_PI_LOW = float.fromhex("0x1.3198a2e037073p-69")
ONE_OVER_LN_2 = float.fromhex("0x1.71547652b82fep+0")
LN_2 = float.fromhex("0x1.62e42fefa39efp-1")
LN_2_HIGH = float.fromhex("0x1.62e42feep-1")
LN_2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
ROOT_HALF = math.sqrt(0.5)
TANGENTS_OF_EIGHTHS = (0.0, math.sqrt(2.0) - 1.0, 1.0)
"""tan(j pi/8) for j = 0, 1, 2: the tangents of the angles that `atan2` subtracts."""
TAN_PI_16 = float.fromhex("0x1.975f5e0553158p-3")
"""tan(pi/16): above this ratio, `atan2` subtracts the angle pi/8."""
TAN_3_PI_16 = float.fromhex("0x1.561b82ab7f990p-1")
"""tan(3 pi/16): above this ratio, `atan2` subtracts the angle pi/4."""

ANGLE_MAX = 1e6
"""Minimum angle [rad] from which `sin` and `cos` subtract whole turns first."""
EXPONENT_MAX = 800.0
"""Minimum |x| from which exp(x) is infinite for a positive x, and 0 for a negative x."""


def reduce_angle(x):
    """Split an angle x [rad] into k quarter turns and a small remainder r: x = k pi/2 + r.

    Returns:
        k: The number of quarter turns; an integer.
        r: The remaining angle, |r| <= pi/4 [rad]; NaN if x is not finite.
    """
    if not abs(x) < ANGLE_MAX:
        if not abs(x) < math.inf:
            return 0, math.nan
        x = x % math.tau
    k = math.floor(x * TWO_OVER_PI + 0.5)
    return k, ((x - k * HALF_PI_HIGH) - k * HALF_PI_MIDDLE) - k * HALF_PI_LOW


def sin(x):
    """Compute the sine of an angle x [rad], with the same bits on every processor.

    The result is NaN if x is not finite.
    """
    quarter_turns, remainder = reduce_angle(x)
    value = cos_near_0(remainder) if quarter_turns & 1 else sin_near_0(remainder)
    return -value if quarter_turns & 2 else value


def cos(x):
    """Compute the cosine of an angle x [rad], with the same bits on every processor.

    The result is NaN if x is not finite.
    """
    quarter_turns, remainder = reduce_angle(x)
    value = sin_near_0(remainder) if quarter_turns & 1 else cos_near_0(remainder)
    return -value if (quarter_turns + 1) & 2 else value


def sin_near_0(x):
    """Compute sin x for |x| <= pi/4, by a polynomial."""
    square = x * x
    series = 1 / 1307674368000
    series = 1 / 6227020800 - square * series
    series = 1 / 39916800 - square * series
    series = 1 / 362880 - square * series
    series = 1 / 5040 - square * series
    series = 1 / 120 - square * series
    series = 1 / 6 - square * series
    return x - x * square * series


def cos_near_0(x):
    """Compute cos x for |x| <= pi/4, by a polynomial."""
    square = x * x
    series = 1 / 20922789888000
    series = 1 / 87178291200 - square * series
    series = 1 / 479001600 - square * series
    series = 1 / 3628800 - square * series
    series = 1 / 40320 - square * series
    series = 1 / 720 - square * series
    series = 1 / 24 - square * series
    return 1.0 - square * (0.5 - square * series)


def reduce_exponent(x):
    """Split an exponent x into k powers of two and a small remainder r: e^x = 2^k e^r.

    This holds for |x| < EXPONENT_MAX.

    Returns:
        k: An integer.
        r: The remaining exponent, |r| <= ln(2)/2.
    """
    k = math.floor(x * ONE_OVER_LN_2 + 0.5)
    return k, (x - k * LN_2_HIGH) - k * LN_2_LOW


def exp(x):
    """Compute e^x, with the same bits on every processor.

    The result is infinite if it is too large for a float.
    """
    if not abs(x) < EXPONENT_MAX:
        return _exp_of_large(x)
    k, remainder = reduce_exponent(x)
    expm1_remainder = expm1_near_0(remainder)
    # in two factors, because 2^k alone may be out of the range of floats
    return (1.0 + expm1_remainder) * power_of_2(k >> 1) * power_of_2(k - (k >> 1))


def expm1(x):
    """Compute e^x - 1, without loss of precision for small x."""
    if not abs(x) < EXPONENT_MAX:
        return _exp_of_large(x) - 1.0
    k, remainder = reduce_exponent(x)
    expm1_remainder = expm1_near_0(remainder)
    if k == 0:
        return expm1_remainder
    if k > 1000:  # the error of leaving out -1 is less than one unit in the last place
        return exp(x)
    power = power_of_2(k) if k > -1000 else 0.0
    return (power - 1.0) + power * expm1_remainder


def _exp_of_large(x):
    """Compute e^x for |x| beyond EXPONENT_MAX, and for NaN."""
    if x > 0:
        return math.inf
    return 0.0 if x < 0 else math.nan


def expm1_near_0(x):
    """Compute e^x - 1 for |x| <= ln(2)/2, by a polynomial."""
    series = 1 / 87178291200
    series = 1 / 6227020800 + x * series
    series = 1 / 479001600 + x * series
    series = 1 / 39916800 + x * series
    series = 1 / 3628800 + x * series
    series = 1 / 362880 + x * series
    series = 1 / 40320 + x * series
    series = 1 / 5040 + x * series
    series = 1 / 720 + x * series
    series = 1 / 120 + x * series
    series = 1 / 24 + x * series
    series = 1 / 6 + x * series
    series = 1 / 2 + x * series
    return x + x * x * series


def power_of_2(k):
    """Compute 2^k for a whole number k from -1022 to 1023."""
    return math.ldexp(1.0, k)


def log(x):
    """Compute the natural logarithm. It is -infinite for 0, and NaN for negative numbers."""
    if not 0.0 < x < math.inf:
        if x == 0.0:
            return -math.inf
        return x if x > 0.0 else math.nan
    mantissa, exponent = math.frexp(x)
    if mantissa < ROOT_HALF:
        mantissa = 2.0 * mantissa
        exponent -= 1
    ratio = (mantissa - 1.0) / (mantissa + 1.0)
    return exponent * LN_2_HIGH + (2.0 * artanh_near_0(ratio) + exponent * LN_2_LOW)


def log1p(x):
    """Compute ln(1 + x), without loss of precision for small x.

    The result is -infinite for x = -1, and NaN below.
    """
    one_plus_x = 1.0 + x
    if not 0.0 < one_plus_x < math.inf:
        return log(one_plus_x)
    return log(one_plus_x) + (x - (one_plus_x - 1.0)) / one_plus_x


def artanh_near_0(x):
    """Compute artanh x for |x| < 0.172, by a polynomial."""
    square = x * x
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
    return x + x * square * series


def tanh(x):
    """Compute the hyperbolic tangent of x, with the same bits on every processor.

    The formula is tanh |x| = -expm1(-2 |x|) / (2 + expm1(-2 |x|)).
    """
    expm1_of_minus_2x = expm1(-2.0 * abs(x))
    negative_tanh = expm1_of_minus_2x / (2.0 + expm1_of_minus_2x)
    return negative_tanh if x < 0 else -negative_tanh


def atan(x):
    """Compute the angle with tangent x [rad], from -pi/2 to pi/2."""
    return atan2(x, 1.0)


def atan2(y, x):
    """Compute the angle of the point (x, y) [rad], from -pi to pi.

    The result is 0 at the origin, and NaN if a coordinate is NaN.
    """
    magnitude = abs(x) + abs(y)
    if not magnitude > 0.0:
        return 0.0 if magnitude == 0.0 else math.nan
    smaller = min(abs(x), abs(y))
    larger = max(abs(x), abs(y))
    j = 0
    if smaller > TAN_3_PI_16 * larger:
        j = 2
    elif smaller > TAN_PI_16 * larger:
        j = 1
    tangent = TANGENTS_OF_EIGHTHS[j]
    remaining_tangent = (smaller - tangent * larger) / (larger + tangent * smaller)
    angle = j * (math.pi / 8) + arctan_near_0(remaining_tangent)
    if abs(y) > abs(x):
        angle = math.pi / 2 - angle
    if x < 0:
        angle = math.pi - angle
    return -angle if y < 0 else angle


def arctan_near_0(x):
    """Compute arctan x for |x| < 0.2, by a polynomial."""
    square = x * x
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
    return x - x * square * series


def hypot(x, y):
    """Compute the length of the vector (x, y), also if its square would overflow."""
    scale = max(abs(x), abs(y))
    if not 0.0 < scale < math.inf:
        return scale
    scaled_x = x / scale  # otherwise, the squares of large lengths would overflow
    scaled_y = y / scale
    return scale * math.sqrt(scaled_x * scaled_x + scaled_y * scaled_y)


def log_of_sum(ln_x, ln_y):
    """Compute ln(x + y) from ln x and ln y, where -inf means 0."""
    ln_larger = max(ln_x, ln_y)
    if ln_larger == -math.inf:
        return ln_larger
    return ln_larger + log1p(exp(min(ln_x, ln_y) - ln_larger))
