"""How large a difference is: in deviations, of the deviations, and how large it must be to show."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from tetractl.core.poses import Floats
from tetractl.stats.difference import Effect
from tetractl.stats.estimate import CONFIDENCE, Interval, Z, t_quantile

POWER = 0.8
_FEWEST = 5  # values a side for a ratio of deviations: fourth powers need some


@dataclass(frozen=True, slots=True)
class Ratio:
    """A ratio of two standard deviations, the first over the second, and p for its being 1."""

    value: float
    ci95: Interval
    p_value: float


def standardised(differences: Floats) -> Effect:
    """Return the mean of the differences (n,) of pairs over their own standard deviation, d.

    The interval is d -+ z sqrt(1/n + d^2 / 2(n - 1)), for large n (Hedges and Olkin, 1985).
    """
    n = len(differences)
    if n < 2:
        return Effect(math.nan, Interval.none("needs two pairs"))
    ordered = np.sort(differences)  # the order of the pairs must not matter
    std = float(ordered.std(ddof=1))
    if not std > 0:
        return Effect(math.nan, Interval.none("all pairs differ alike"))
    value = float(ordered.mean()) / std
    half = Z * math.sqrt(1 / n + value**2 / (2 * (n - 1)))
    return Effect(value, Interval(value - half, value + half, "Hedges"))


def deviation_ratio(ours: Floats, theirs: Floats) -> Ratio:
    """Compare the standard deviations of values (m,) and (n,), which need not be normal.

    By Bonett (Comput. Statist. Data Anal. 50, 2006): ln(c s1^2 / s2^2) has the variance
    sum_i (K - (n_i - 3) / n_i) / (n_i - 1), with the kurtosis K of both, pooled, about means
    trimmed by 1 / 2 sqrt(n_i - 4), and c = n1 / (n1 - z) over n2 / (n2 - z). Other than there,
    each side is divided by its own deviation before the kurtosis is pooled.
    """
    sides = [np.sort(ours), np.sort(theirs)]
    m, n = map(len, sides)
    if min(m, n) < _FEWEST:
        return Ratio(math.nan, Interval.none(f"needs {_FEWEST} values on each side"), math.nan)
    one, other = (float(side.std(ddof=1)) for side in sides)
    if not (one > 0 and other > 0):
        return Ratio(math.nan, Interval.none("the values of a side do not vary"), math.nan)
    fourth = sum(
        float((((side - _trimmed(side)) / std) ** 4).sum())
        for side, std in zip(sides, (one, other), strict=True)
    )
    kurtosis = (m + n) * fourth / (m + n - 2) ** 2
    variance = sum((kurtosis - (count - 3) / count) / (count - 1) for count in (m, n))
    middle = math.log((m / (m - Z)) / (n / (n - Z))) / 2 + math.log(one / other)
    half = math.sqrt(variance) / 2
    ends = (math.exp(middle - Z * half), math.exp(middle + Z * half))
    p_value = 2 * float(special.ndtr(-abs(middle) / half))
    return Ratio(one / other, Interval(*ends, "Bonett"), p_value)


def detectable(pairs: int, tests: int = 1) -> float:
    """Return the mean difference, in deviations of the differences, that `pairs` show in POWER of
    all studies, at the strictest level that Holm's correction of `tests` asks for.

    NaN for fewer than 2 pairs. By the noncentral t distribution.
    """
    return _detectable(pairs - 1, math.sqrt(pairs), tests) if pairs > 1 else math.nan


def detectable_between(m: int, n: int, tests: int = 1) -> float:
    """Return, as `detectable`, the difference of two means, in deviations of the values, that m and
    n values show."""
    if min(m, n) < 2:
        return math.nan
    return _detectable(m + n - 2, math.sqrt(m * n / (m + n)), tests)


def _detectable(degrees: int, root: float, tests: int) -> float:
    from scipy import optimize  # slow to import, and needed by comparisons alone

    bound = t_quantile(degrees, 1 - (1 - CONFIDENCE) / tests)

    def missing(size: float) -> float:
        low, high = special.nctdtr(degrees, size * root, [-bound, bound])
        return float(1 - high + np.nan_to_num(low)) - POWER  # NaN far out, where it is nothing

    found = optimize.root_scalar(missing, bracket=(0.0, (1.5 * bound + 3) / root), method="brentq")
    return float(found.root)


def _trimmed(ordered: Floats) -> float:
    """Return the mean without the share 1 / 2 sqrt(n - 4) of values at either end."""
    n = len(ordered)
    out = min(int(n / (2 * math.sqrt(n - 4))), (n - 1) // 2)
    return float(ordered[out : n - out].mean())
