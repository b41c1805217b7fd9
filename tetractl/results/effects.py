"""How large a difference is: in deviations, of the deviations, and how large it must be to show."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from tetractl.core.poses import Floats
from tetractl.results.difference import Effect, welch
from tetractl.results.estimate import CONFIDENCE, Interval, Z, t_quantile

POWER = 0.8
_FEWEST = 5  # values a side for a ratio of deviations


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

    By the jackknife of Miller (Ann. Math. Statist. 39, 1968): each value of a side of n has the
    pseudo-value n ln s^2 - (n - 1) ln s_i^2, with the variance s_i^2 of the others; the difference
    of their means, by Welch's t, is that of the two ln s^2.
    """
    sides = [np.sort(ours), np.sort(theirs)]  # the order of the trials must not matter
    if min(map(len, sides)) < _FEWEST:
        return Ratio(math.nan, Interval.none(f"needs {_FEWEST} values on each side"), math.nan)
    one, other = (float(side.std(ddof=1)) for side in sides)
    pseudo = [_pseudo_values(side) for side in sides]
    if not (one > 0 and other > 0) or not all(np.isfinite(values).all() for values in pseudo):
        why = "all values of a side, or all but one, are equal"
        return Ratio(math.nan, Interval.none(why), math.nan)
    (m, mean, std), (n, mean2, std2) = (
        (len(values), float(values.mean()), float(values.std(ddof=1))) for values in pseudo
    )
    found = welch(m, mean, std, n, mean2, std2)
    if not found.ci95.known:
        return Ratio(one / other, found.ci95, math.nan)
    low, high = math.exp(found.ci95.low / 2), math.exp(found.ci95.high / 2)
    return Ratio(one / other, Interval(low, high, "jackknife"), found.p_value)


def _pseudo_values(values: Floats) -> Floats:
    n = len(values)
    squares = (values - values.mean()) ** 2
    without = squares.sum() - squares * n / (n - 1)  # of the others about their own mean
    with np.errstate(divide="ignore", invalid="ignore"):
        every = np.log(squares.sum() / (n - 1))
        return n * every - (n - 1) * np.log(without / (n - 2))


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
