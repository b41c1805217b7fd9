"""Differences of two batches: of their means, paired or not, and as an effect size."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from tetractl.core.poses import Floats
from tetractl.results.estimate import Distribution, Interval, Z, t_quantile

_NAN = math.nan


@dataclass(frozen=True, slots=True)
class MeanDifference:
    """A difference of two means by a t test: `value` is the first minus the second."""

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
    """Interval of the difference of two means from the interval of each, which may be skewed.

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
    """Return how far an interval reaches below and above its mean; 0 for values all equal."""
    if values.n > 1 and values.std == 0:
        return 0.0, 0.0
    return values.mean - values.ci95.low, values.ci95.high - values.mean


def paired_t(differences: Floats) -> MeanDifference:
    """Compare two means by the differences (n,) of pairs, with Student's t: p and interval."""
    n = len(differences)
    differences = np.sort(differences)  # the order of the pairs must not matter
    mean = float(differences.mean()) if n else _NAN
    if n < 2:
        return MeanDifference(mean, Interval.none("needs two pairs"), _NAN, _NAN)
    error = float(differences.std(ddof=1)) / math.sqrt(n)
    if not error > 0:
        return MeanDifference(mean, Interval.none("all pairs differ alike"), _NAN, n - 1)
    half = t_quantile(n - 1) * error
    p_value = 2 * float(special.stdtr(n - 1, -abs(mean) / error))
    return MeanDifference(mean, Interval(mean - half, mean + half, "paired t"), p_value, n - 1)


@dataclass(frozen=True, slots=True)
class Effect:
    """Cliff's delta: P(first > second) - P(first < second), from -1 to 1."""

    value: float
    ci95: Interval


def cliffs_delta(ours: Floats, theirs: Floats) -> Effect:
    """Effect size of two batches without assuming normal values or equal deviations.

    delta = 2 theta - 1, theta = U / (m n) with the Mann-Whitney U. The interval is Newcombe's score
    interval of theta (Statistics in Medicine 25, 2006, method 5), which holds for small batches and
    for batches that do not overlap: the roots of (theta - t)^2 = z^2 V(t) with V(t) = t (1 - t)
    (1 + N (1 - t) / (2 - t) + N t / (1 + t)) / (m n), N = (m + n) / 2 - 1.
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

    edge = 1e-12  # 0 and 1 are roots of their own where theta is 0 or 1
    low = _root(excess, 0.0, min(theta, 1 - edge)) if theta > 0 else 0.0
    high = _root(excess, max(theta, edge), 1.0) if theta < 1 else 1.0
    return Effect(2 * theta - 1, Interval(2 * low - 1, 2 * high - 1, "Newcombe"))


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    from scipy import optimize  # slow to import, and needed by comparisons alone

    return float(optimize.root_scalar(function, bracket=(low, high), method="brentq").root)
