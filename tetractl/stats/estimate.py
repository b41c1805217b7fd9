"""Estimates with intervals: a mean, a difference of two means, an effect size.

An estimate that needs more data than there is, is NaN with a reason.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy import special

from tetractl.core.poses import Floats

CONFIDENCE = 0.95
RESAMPLES = 9999
SEED = 20_100_503
"""The seed of every bootstrap, so that the same trials always give the same interval."""
ENOUGH = 8
"""Fewest values for a bootstrap or a verdict: below it bootstrap intervals are too short."""

_BATCH_ELEMENTS = 4_000_000  # resampled values held in memory at once
_GRID = 2.0**40
_NAN = math.nan
_Z = float(special.ndtri((1 + CONFIDENCE) / 2))
"""Of the normal distribution: |z| lies below it with the confidence of the intervals."""


def finite(value: float) -> float | None:
    """Return a number for JSON, None where it is not finite."""
    return value if math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Interval:
    """A 95 % interval; where there is none, `low` and `high` are NaN and `reason` is the cause."""

    low: float
    high: float
    method: str | None = None
    reason: str | None = None

    @classmethod
    def none(cls, reason: str) -> Self:
        """Return the absence of an interval, with its cause."""
        return cls(_NAN, _NAN, None, reason)

    @property
    def known(self) -> bool:
        """Whether there is an interval."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    @property
    def ends(self) -> list[float] | None:
        """Both ends for JSON, None where there is no interval."""
        return [self.low, self.high] if self.known else None

    def as_dict(self) -> dict[str, Any]:
        """Return the items of JSON that describe the interval."""
        return {"ci95": self.ends, "ci95_method": self.method, "ci95_reason": self.reason}


@dataclass(frozen=True, slots=True)
class Distribution:
    """n values described: mean, standard deviation (n - 1), median, range, interval of the mean.

    For n = 0 everything is NaN, for n = 1 the deviation.
    """

    n: int
    mean: float
    std: float
    median: float
    min: float
    max: float
    ci95: Interval

    def as_dict(self) -> dict[str, Any]:
        """Return the items of JSON that describe the values; what is not known is None."""
        return {
            "n": self.n,
            "mean": finite(self.mean),
            "std": finite(self.std),
            "median": finite(self.median),
            "min": finite(self.min),
            "max": finite(self.max),
            **self.ci95.as_dict(),
        }


def describe(rows: Floats) -> list[Distribution]:
    """Describe each row of an array of shape (R, n)."""
    count, n = rows.shape
    if n == 0:
        nothing = Distribution(0, _NAN, _NAN, _NAN, _NAN, _NAN, Interval.none("no values"))
        return [nothing] * count
    rows = np.sort(rows, axis=1)  # makes every number independent of the order of the trials
    low, high = rows[:, 0], rows[:, -1]
    mean = np.clip(rows.mean(axis=1), low, high)
    std = np.where(high > low, rows.std(axis=1, ddof=1), 0.0) if n > 1 else np.full(count, _NAN)
    median = np.median(rows, axis=1)
    intervals = _mean_intervals(rows, mean, std)
    figures = np.column_stack([mean, std, median, low, high]).tolist()
    return [
        Distribution(n, *row, ci95=interval)
        for row, interval in zip(figures, intervals, strict=True)
    ]


def describe_published(n: int, mean: float, std: float) -> Distribution:
    """Describe a published result of which only n, mean and deviation are known; the interval is
    Student's t."""
    half = _t_quantile(n - 1) * std / math.sqrt(n)
    interval = Interval(mean - half, mean + half, "t")
    return Distribution(n, mean, std, _NAN, _NAN, _NAN, interval)


def _t_quantile(degrees: float) -> float:
    """The bound below which |t| lies with the confidence of the intervals, t being Student's."""
    return float(special.stdtrit(degrees, (1 + CONFIDENCE) / 2))


def _mean_intervals(rows: Floats, mean: Floats, std: Floats) -> list[Interval]:
    """Intervals of the means of sorted rows (R, n): BCa bootstrap, Student's t for a small n."""
    n = rows.shape[1]
    if n == 1:
        return [Interval.none("one value has no spread")] * len(rows)
    spread = rows[:, -1] - rows[:, 0]
    varied = np.flatnonzero(spread > 0)
    intervals = [Interval.none(f"all {n} values are equal")] * len(rows)
    if n < ENOUGH:
        half = _t_quantile(n - 1) * std / math.sqrt(n)
        for i in varied:
            low, high = float(mean[i] - half[i]), float(mean[i] + half[i])
            intervals[i] = Interval(low, high, "t")
    elif varied.size:
        least, width = rows[varied, 0], spread[varied]
        low, high = _bootstrap([_counts(rows[varied], least[:, None], width[:, None])])
        low, high = least + low / _GRID * width, least + high / _GRID * width
        for i, a, b in zip(varied, low, high, strict=True):
            intervals[i] = _bca(a, b)
    return intervals


def _counts(values: Floats, least: Floats | np.float64, width: Floats | np.float64) -> Floats:
    """Values as whole numbers from 0 at `least` to _GRID at `least + width`.

    Their sums are exact, so neither the unit nor the order of summation changes which resampled
    means tie with the mean, and with that the interval.
    """
    return np.rint((values - least) / width * _GRID)


def _mean(values: Floats, axis: int = -1) -> Floats:
    return np.mean(values, axis=axis)


def _difference(ours: Floats, theirs: Floats, axis: int = -1) -> Floats:
    return np.mean(ours, axis=axis) - np.mean(theirs, axis=axis)


def _bootstrap(samples: Sequence[Floats]) -> tuple[Floats, Floats]:
    """BCa interval of the mean of one sample, or of the difference of the means of two."""
    from scipy import stats  # takes half a second, which a short run need not wait for

    with warnings.catch_warnings():  # a degenerate bootstrap is NaN, and `_bca` says so
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        result = stats.bootstrap(
            samples,
            _mean if len(samples) == 1 else _difference,
            n_resamples=RESAMPLES,
            batch=max(1, _BATCH_ELEMENTS // sum(sample.size for sample in samples)),
            vectorized=True,
            axis=-1,
            confidence_level=CONFIDENCE,
            method="BCa",
            rng=np.random.default_rng(SEED),
        )
    return result.confidence_interval.low, result.confidence_interval.high


def _bca(low: float, high: float) -> Interval:
    if math.isfinite(low) and math.isfinite(high):
        return Interval(float(low), float(high), "BCa")
    return Interval.none("the values vary too little for a bootstrap")


@dataclass(frozen=True, slots=True)
class MeanDifference:
    """A difference of two means by Welch's t: `value` is the first minus the second."""

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
    half = _t_quantile(degrees) * math.sqrt(v1 + v2)
    p_value = 2 * float(special.stdtr(degrees, -abs(difference) / math.sqrt(v1 + v2)))
    interval = Interval(difference - half, difference + half, "Welch")
    return MeanDifference(difference, interval, p_value, degrees)


def bootstrap_difference(ours: Floats, theirs: Floats) -> Interval:
    """Interval of mean(ours) - mean(theirs) by a BCa bootstrap of both batches."""
    if min(len(ours), len(theirs)) < ENOUGH:
        return Interval.none(f"the bootstrap needs {ENOUGH} values on each side")
    both = np.concatenate([ours, theirs])
    least, width = both.min(), np.ptp(both)
    if np.ptp(ours) == 0 and np.ptp(theirs) == 0:
        return Interval.none("the values do not vary on either side")
    low, high = _bootstrap([_counts(np.sort(batch), least, width) for batch in (ours, theirs)])
    return _bca(float(low / _GRID * width), float(high / _GRID * width))


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
    z2 = _Z**2
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


def proportion_interval(successes: int, n: int) -> Interval:
    """Wilson's interval of a proportion p: (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) /
    (1 + z^2 / n)."""
    if n == 0:
        return Interval.none("no trials")
    p, z2 = successes / n, _Z**2
    middle, scale = p + z2 / (2 * n), 1 + z2 / n
    half = _Z * math.sqrt(p * (1 - p) / n + z2 / (4 * n**2))
    low = (middle - half) / scale if successes > 0 else 0.0
    high = (middle + half) / scale if successes < n else 1.0
    return Interval(low, high, "Wilson")
