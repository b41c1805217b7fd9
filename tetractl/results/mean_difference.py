"""Compares two batches: means, effect sizes, standard deviations and ranks.

Tests by ranks assume no distribution. Their p-values are two-sided and exact as long as there are
at most EXACT values: the distribution of the sum of ranks is enumerated over all equally probable
cases, and tied values share their mean rank. With more values it is approximated as normal, with
the variance corrected for ties.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tetractl.core.poses import Floats
from tetractl.results.estimate import CONFIDENCE, Distribution, Interval, Z, t_quantile

_NAN = math.nan


@dataclass(frozen=True, slots=True)
class MeanDifference:
    """A difference of two means, the first minus the second, tested by a t test with `degrees`
    degrees of freedom.
    """

    value: float
    ci95: Interval
    p_value: float
    degrees: float


def welch(n1: int, mean1: float, std1: float, n2: int, mean2: float, std2: float) -> MeanDifference:
    """Compare two means from n, mean and standard deviation (n - 1) alone.

    With v_i = std_i^2 / n_i: t = (mean1 - mean2) / sqrt(v1 + v2), and the degrees of freedom of
    Welch and Satterthwaite are (v1 + v2)^2 / (v1^2 / (n1 - 1) + v2^2 / (n2 - 1)).
    """
    difference = mean1 - mean2
    if min(n1, n2) < 2:
        why = "Welch's t needs two values on each side"
        return MeanDifference(difference, Interval.none(why), _NAN, _NAN)
    v1, v2 = std1**2 / n1, std2**2 / n2
    if v1 + v2 == 0:
        why = "the values do not vary on either side"
        return MeanDifference(difference, Interval.none(why), _NAN, _NAN)
    share = v1 / (v1 + v2)
    degrees = 1 / (share**2 / (n1 - 1) + (1 - share) ** 2 / (n2 - 1))
    half = t_quantile(degrees) * math.sqrt(v1 + v2)
    p_value = 2 * float(special.stdtr(degrees, -abs(difference) / math.sqrt(v1 + v2)))
    interval = Interval(difference - half, difference + half, "Welch")
    return MeanDifference(difference, interval, p_value, degrees)


def from_both_intervals(ours: Distribution, theirs: Distribution) -> Interval:
    """Return the interval of the difference of two means from their own intervals.

    With means m, m', lower ends l, l' and upper ends u, u', by Zou and Donner (Statistics in
    Medicine 27, 2008): from m - m' - sqrt((m - l)^2 + (u' - m')^2) to m - m' + sqrt((u - m)^2 +
    (m' - l')^2).
    """
    (low, high), (low2, high2) = _reach(ours), _reach(theirs)
    if not all(map(math.isfinite, (low, high, low2, high2))):
        side = ours if not ours.ci95.known else theirs
        return Interval.none(f"no interval of one of the means: {side.ci95.reason}")
    if max(low, high, low2, high2) == 0:
        return Interval.none("the values do not vary on either side")
    difference = ours.mean - theirs.mean
    return Interval(
        difference - math.hypot(low, high2), difference + math.hypot(high, low2), "both intervals"
    )


def _reach(values: Distribution) -> tuple[float, float]:
    """Return the distances from the mean to the ends of its interval; 0 if all values are equal."""
    if values.n > 1 and values.std == 0:
        return 0.0, 0.0
    return values.mean - values.ci95.low, values.ci95.high - values.mean


def paired_t(differences: Floats) -> MeanDifference:
    """Compare two means from the differences (n,) of pairs, by Student's t test."""
    n = len(differences)
    differences = np.sort(differences)  # the order of the pairs must not matter
    mean = float(differences.mean()) if n else _NAN
    if n < 2:
        return MeanDifference(mean, Interval.none("an interval needs two pairs"), _NAN, _NAN)
    error = float(differences.std(ddof=1)) / math.sqrt(n)
    if not error > 0:
        return MeanDifference(mean, Interval.none("all differences are equal"), _NAN, n - 1)
    half = t_quantile(n - 1) * error
    p_value = 2 * float(special.stdtr(n - 1, -abs(mean) / error))
    return MeanDifference(mean, Interval(mean - half, mean + half, "paired t"), p_value, n - 1)


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect size with its 95 % interval: Cliff's delta, or a standardised mean difference."""

    value: float
    ci95: Interval


def cliffs_delta(ours: Floats, theirs: Floats) -> Effect:
    """Return Cliff's delta of two batches with any distributions: P(first > second) - P(first <
    second).

    delta = 2 theta - 1, theta = U / (m n) with the Mann-Whitney U. The interval is Newcombe's score
    interval of theta (Statistics in Medicine 25, 2006, method 5), which holds for small batches and
    for batches without overlap. Its ends are roots of (theta - t)^2 = z^2 V(t), V(t) = t (1 - t) (1
    + N (1 - t) / (2 - t) + N t / (1 + t)) / (m n), N = (m + n) / 2 - 1.
    """
    m, n = len(ours), len(theirs)
    if min(m, n) == 0:
        return Effect(_NAN, Interval.none("no values"))
    ordered = np.sort(theirs)
    below, up_to = (np.searchsorted(ordered, ours, side).sum() for side in ("left", "right"))
    theta = float(below + up_to) / (2 * m * n)  # a tie counts half
    if min(m, n) < 2:
        return Effect(2 * theta - 1, Interval.none("one value has no spread"))
    z2 = Z**2
    extra = (m + n) / 2 - 1

    def excess(t: float) -> float:
        shape = 1 + extra * (1 - t) / (2 - t) + extra * t / (1 + t)
        return (theta - t) ** 2 - z2 * t * (1 - t) * shape / (m * n)

    edge = 1e-12  # 0 and 1 are roots themselves if theta is 0 or 1
    low = _root(excess, 0.0, min(theta, 1 - edge)) if theta > 0 else 0.0
    high = _root(excess, max(theta, edge), 1.0) if theta < 1 else 1.0
    return Effect(2 * theta - 1, Interval(2 * low - 1, 2 * high - 1, "Newcombe"))


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    from scipy import optimize  # slow to import, and needed by comparisons alone

    return float(optimize.root_scalar(function, bracket=(low, high), method="brentq").root)


POWER = 0.8
_FEWEST = 5  # least number of values per side for a ratio of standard deviations


@dataclass(frozen=True, slots=True)
class Ratio:
    """A ratio of two standard deviations, the first over the second; `p_value` tests whether it is
    1.
    """

    value: float
    ci95: Interval
    p_value: float


def standardised(differences: Floats) -> Effect:
    """Return d, the mean of the differences (n,) of pairs divided by their standard deviation.

    The interval is d -+ z sqrt(1/n + d^2 / 2(n - 1)), for large n (Hedges and Olkin, 1985).
    """
    n = len(differences)
    if n < 2:
        return Effect(math.nan, Interval.none("an interval needs two pairs"))
    ordered = np.sort(differences)  # the order of the pairs must not matter
    std = float(ordered.std(ddof=1))
    if not std > 0:
        return Effect(math.nan, Interval.none("all differences are equal"))
    value = float(ordered.mean()) / std
    half = Z * math.sqrt(1 / n + value**2 / (2 * (n - 1)))
    return Effect(value, Interval(value - half, value + half, "Hedges"))


def deviation_ratio(ours: Floats, theirs: Floats) -> Ratio:
    """Compare the standard deviations of values (m,) and (n,), which need not be normal.

    Miller's jackknife (Ann. Math. Statist. 39, 1968): value i of n has the pseudo-value n ln s^2 -
    (n - 1) ln s_i^2, where s^2 is the variance of all values and s_i^2 that of all but value i.
    Welch's t test compares the means of both sides' pseudo-values.
    """
    # the result must not depend on the order of the trials
    sides = [np.sort(ours), np.sort(theirs)]
    if min(map(len, sides)) < _FEWEST:
        return Ratio(math.nan, Interval.none(f"needs {_FEWEST} values on each side"), math.nan)
    one, other = (float(side.std(ddof=1)) for side in sides)
    pseudo = [_pseudo_values(side) for side in sides]
    if not (one > 0 and other > 0) or not all(np.isfinite(values).all() for values in pseudo):
        why = "all values of one batch, or all but one, are equal"
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
    # sum of squares of all values but one, about their own mean
    without = squares.sum() - squares * n / (n - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        every = np.log(squares.sum() / (n - 1))
        return n * every - (n - 1) * np.log(without / (n - 2))


def detectable(pairs: int, tests: int = 1) -> float:
    """Return the mean difference that the paired t test finds with probability POWER, in standard
    deviations of the differences, at the strictest level of Holm's correction for `tests`.

    It follows from the noncentral t distribution; NaN for fewer than 2 pairs.
    """
    return _detectable(pairs - 1, math.sqrt(pairs), tests) if pairs > 1 else math.nan


def detectable_between(m: int, n: int, tests: int = 1) -> float:
    """Return the difference of the means of m and n unpaired values that a t test finds with
    probability POWER, in standard deviations of the values; NaN if m or n is below 2."""
    if min(m, n) < 2:
        return math.nan
    return _detectable(m + n - 2, math.sqrt(m * n / (m + n)), tests)


def _detectable(degrees: int, root: float, tests: int) -> float:
    from scipy import optimize  # slow to import, and needed by comparisons alone

    bound = t_quantile(degrees, 1 - (1 - CONFIDENCE) / tests)

    def missing(size: float) -> float:
        low, high = special.nctdtr(degrees, size * root, [-bound, bound])
        # the lower tail is NaN far from the mean, where it is 0
        return float(1 - high + np.nan_to_num(low)) - POWER

    found = optimize.root_scalar(missing, bracket=(0.0, (1.5 * bound + 3) / root), method="brentq")
    return float(found.root)


EXACT = 60  # largest number of values for an exact p-value


def signed_rank(differences: Floats) -> float:
    """Return the p-value of Wilcoxon's signed-rank test that differences (n,) are centred at 0.

    Differences of exactly 0 are left out. NaN if none is left.
    """
    kept = differences[differences != 0]
    n = len(kept)
    if n == 0:
        return math.nan
    # ranks are doubled to be whole numbers, since the mean rank of tied values may be a half
    double = _double_ranks(np.abs(kept))
    positive, total = int(double[kept > 0].sum()), int(double.sum())
    if n > EXACT:
        variance = float((double.astype(float) ** 2).sum()) / 4
        return _normal(positive - total / 2, variance)
    ways = np.zeros(total + 1)  # probability of each sum
    ways[0] = 1.0
    for rank in double.tolist():
        ways[rank:] = (ways[rank:] + ways[: total + 1 - rank]) / 2
        ways[:rank] /= 2
    return _two_sided(ways, positive)


def rank_sum(ours: Floats, theirs: Floats) -> float:
    """Return the p-value of the rank-sum test (Wilcoxon, Mann and Whitney) of values (m,) and (n,).
    NaN if one side has no values.
    """
    m, n = len(ours), len(theirs)
    if min(m, n) == 0:
        return math.nan
    double = _double_ranks(np.concatenate([ours, theirs]))
    mine = int(double[:m].sum())
    expected = m * (m + n + 1)
    if m + n > EXACT:
        spread = float(((double - double.mean()) ** 2).sum())
        variance = m * n * spread / ((m + n) * (m + n - 1)) if m + n > 1 else 0.0
        return _normal(mine - expected, variance)
    total = int(double.sum())
    ways = np.zeros((m + 1, total + 1))  # number of cases for each sum and number of ranks
    ways[0, 0] = 1.0
    for rank in double.tolist():
        ways[1:, rank:] += ways[:-1, : total + 1 - rank]
    return _two_sided(ways[m] / ways[m].sum(), mine)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple comparisons, by Holm (Scand. J. Statist. 6, 1979).

    The i-th smallest of k p-values is multiplied by k - i + 1, and raised to the corrected value of
    the next smaller p-value if that is larger. NaN stays NaN and is not counted in k.
    """
    order = sorted((p, i) for i, p in enumerate(p_values) if not math.isnan(p))
    found, least = [math.nan] * len(p_values), 0.0
    for rank, (p, i) in enumerate(order):
        least = max(least, min(1.0, p * (len(order) - rank)))
        found[i] = least
    return found


def _double_ranks(values: Floats) -> NDArray[np.int64]:
    """Return twice the rank of each value, an integer; equal values share their mean rank."""
    ordered = np.sort(values)
    below, up_to = (np.searchsorted(ordered, values, side) for side in ("left", "right"))
    return below + up_to + 1


def _two_sided(probability: Floats, seen: int) -> float:
    """Return the two-sided probability of a sum at least as extreme as `seen`; `probability[k]` is
    the probability of the sum k.
    """
    tails = probability[: seen + 1].sum(), probability[seen:].sum()
    return min(1.0, 2 * float(min(tails)))


def _normal(off: float, variance: float) -> float:
    if variance <= 0:
        return 1.0
    return 2 * float(special.ndtr(-abs(off) / math.sqrt(variance)))
