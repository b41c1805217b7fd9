"""Estimate a mean or a fraction with its 95 % interval.

All intervals are closed formulas without resampling, so the same values always give the same
interval. An estimate from too few values is NaN, with a reason.

A `Distribution` comes from values (`distributions`), or from a published mean and standard
deviation. In the second case, the interval is computed (`published_distribution`) or given
(`known_distribution`). `mean_difference` compares two means.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy import special

from tetractl.core.poses import Floats
from tetractl.tools.table.table import UNKNOWN_TEXT, create_length_format

CONFIDENCE = 0.95
"""Confidence of all intervals."""

TAIL_FACTOR = 10
"""Errors above this multiple of the median are the tail, if the spec states no bound."""
VALUES_MIN = 3
"""Minimum number of values for an interval of a mean. Two values have no skewness."""
_NAN = math.nan
NORMAL_QUANTILE = float(special.ndtri((1 + CONFIDENCE) / 2))
"""Quantile z of the normal distribution for the confidence of the intervals."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A 95 % confidence interval of a mean or a fraction.

    Attributes:
        low: Lower end. NaN if the interval is unknown.
        high: Upper end. NaN if the interval is unknown.
        method: Name of the method, such as "Wilson". None if the interval is unknown.
        reason: Why the interval is unknown. None if it is known.
    """

    low: float
    high: float
    method: str | None = None
    reason: str | None = None

    @classmethod
    def none(cls, reason: str) -> Self:
        """Create an interval that cannot be computed, for the given reason."""
        return cls(_NAN, _NAN, None, reason)

    @property
    def known(self) -> bool:
        """Whether the confidence interval could be computed."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def text(self, format_end: Callable[[float], str]) -> str:
        """Format the interval as "LOW to HIGH", with each end formatted by `format_end`.

        If there is no interval, return the reason or, without a reason, "-".
        """
        if self.known:
            return f"{format_end(self.low)} to {format_end(self.high)}"
        return f"none: {self.reason}" if self.reason else UNKNOWN_TEXT

    @property
    def bounds(self) -> list[float] | None:
        """Both ends for JSON, [low, high].

        The value is None if there is no interval.
        """
        return [self.low, self.high] if self.known else None

    def as_dict(self) -> dict[str, Any]:
        """Return the interval as items of JSON. The ends are None if there is no interval."""
        return {"ci95": self.bounds, "ci95_method": self.method, "ci95_reason": self.reason}


@dataclass(frozen=True, slots=True)
class Tail:
    """The number of values above a bound, which counts rare large errors.

    The mean of a few values does not show rare large ones: an event with a probability of 2 % is
    missing in two of three batches of 20 trials.

    Attributes:
        bound: The bound: the spec's, or 10 times the median. NaN without values, or if the median
            is not positive.
        above: Number of values above the bound.
        n: Number of values.
        stated: Whether the bound comes from the spec.
        ci95: Wilson's interval of the fraction above / n.
    """

    bound: float
    above: int
    n: int
    stated: bool
    ci95: Interval

    @property
    def label(self) -> str:
        """The label of the row in tables that counts values above the bound."""
        return f"errors above {'error_bound' if self.stated else f'{TAIL_FACTOR} times the median'}"

    def text(self, unit: str = "") -> str:
        """Describe the tail, such as "2 of 100 above 85.0 mm (95 % interval 1 to 7 %)".

        The text is "-" if there is no bound.
        """
        if not math.isfinite(self.bound):
            return UNKNOWN_TEXT
        bound = f"{create_length_format(self.bound)(self.bound)} {unit}".strip()
        return f"{self.above} of {self.n} above {bound}{percent(self.ci95)}"

    def as_dict(self) -> dict[str, Any]:
        """Return the number of rare large values as items of JSON.

        The number is None and the bound is NaN if there is no bound.
        """
        return {
            "bound": self.bound,
            "stated": self.stated,
            "n_above": self.above if math.isfinite(self.bound) else None,
            "ci95": self.ci95.bounds,
        }


@dataclass(frozen=True, slots=True)
class Distribution:
    """A summary of n values: mean, standard deviation, median, range, and interval.

    With n = 0, mean, deviation, median and range are NaN. With n = 1, only the deviation is NaN.

    Attributes:
        n: Number of values.
        mean: Mean.
        std: Standard deviation, with n - 1.
        median: Median.
        min: Minimum.
        max: Maximum.
        ci95: 95 % confidence interval of the mean.
        tail: Number of values above a bound.
    """

    n: int
    mean: float
    std: float
    median: float
    min: float
    max: float
    ci95: Interval
    tail: Tail

    def as_dict(self) -> dict[str, Any]:
        """Return the distribution of values as items of JSON. Unknown numbers remain NaN."""
        return {
            "n": self.n,
            "mean": self.mean,
            "std": self.std,
            "median": self.median,
            "min": self.min,
            "max": self.max,
            **self.ci95.as_dict(),
            "tail": self.tail.as_dict(),
        }


def distributions(rows: Floats, bound: float | None = None) -> list[Distribution]:
    """Compute mean, spread and interval of each row of an array of shape (R, n).

    Tails are above `bound` or, if it is None, above 10 times the row's median.
    """
    row_count, n = rows.shape
    if n == 0:
        return [known_distribution(0, _NAN, _NAN, Interval.none("no values"))] * row_count
    rows = np.sort(rows, axis=1)  # so that no result depends on the order of the trials
    minima = rows[:, 0]
    maxima = rows[:, -1]
    means = np.clip(rows.mean(axis=1), minima, maxima)
    medians = np.median(rows, axis=1)
    stds = _standard_deviations(rows)
    return [
        Distribution(
            n=n,
            mean=float(means[i]),
            std=float(stds[i]),
            median=float(medians[i]),
            min=float(minima[i]),
            max=float(maxima[i]),
            ci95=_mean_interval(rows[i], float(means[i]), float(stds[i])),
            tail=_count_tail(rows[i], float(medians[i]), bound),
        )
        for i in range(row_count)
    ]


def _standard_deviations(rows: Floats) -> Floats:
    """Compute the standard deviation (R,) of each of some sorted rows (R, n), with n - 1.

    The deviation of a single value is NaN. The deviation of equal values is exactly 0.
    """
    row_count, n = rows.shape
    if n == 1:
        return np.full(row_count, _NAN)
    return np.where(rows[:, -1] > rows[:, 0], rows.std(axis=1, ddof=1), 0.0)


def known_distribution(n: int, mean: float, std: float, ci95: Interval) -> Distribution:
    """Create a distribution from known statistics of n values. All other statistics are NaN.

    Args:
        n: Number of values.
        mean: Mean of the values.
        std: Standard deviation of the values.
        ci95: 95 % confidence interval of the mean.
    """
    unknown = Tail(_NAN, 0, n, False, Interval.none(""))
    return Distribution(n, mean, std, _NAN, _NAN, _NAN, ci95, unknown)


def _count_tail(values: Floats, median: float, bound: float | None) -> Tail:
    """Count the values (n,) above `bound` or, if it is None, above TAIL_FACTOR times the median.

    If this limit is not positive or is NaN, nothing is counted, and the tail's bound is NaN.
    """
    limit = TAIL_FACTOR * median if bound is None else bound
    n = len(values)
    if not limit > 0:
        bound_name = "median" if bound is None else "bound"
        return Tail(_NAN, 0, n, False, Interval.none(f"the {bound_name} is not positive"))
    above = int((values > limit).sum())
    return Tail(limit, above, n, bound is not None, proportion_interval(above, n))


def published_distribution(n: int, mean: float, std: float) -> Distribution:
    """Create the distribution of a published result from its mean and standard deviation.

    The interval is Student's t interval on a logarithmic scale.

    Args:
        n: Number of values.
        mean: Mean of the values.
        std: Standard deviation of the values.
    """
    if mean <= 0 or std <= 0:
        return known_distribution(n, mean, std, Interval.none("nothing varies"))
    return known_distribution(n, mean, std, Interval(*_log_t_ends(n, mean, std), "log-t"))


def t_quantile(degrees: float, confidence: float = CONFIDENCE) -> float:
    """Compute the bound that |t| does not exceed with probability `confidence`.

    t has Student's distribution with `degrees` degrees of freedom.
    """
    return float(special.stdtrit(degrees, (1 + confidence) / 2))


def _mean_interval(values: Floats, mean: float, std: float) -> Interval:
    """Compute the 95 % interval of the mean of sorted values (n,).

    For values that are never negative, such as distances, it is Student's t interval on a
    logarithmic scale, with a higher upper end for skewed values; both ends are positive. For other
    values it is Student's t interval.
    """
    n = len(values)
    if n == 1:
        return Interval.none("a single value has no spread")
    if not std > 0:
        return Interval.none(f"all {n} values are equal")
    if n < VALUES_MIN:
        return Interval.none(f"an interval needs at least {VALUES_MIN} values")
    if values[0] < 0:
        half_width = t_quantile(n - 1) * std / math.sqrt(n)
        return Interval(float(mean - half_width), float(mean + half_width), "t")
    low, high = _log_t_ends(n, mean, std)
    return Interval(low, max(high, _skewed_upper_end(values, mean, std)), "log-t")


def _log_t_ends(n: int, mean: float, std: float) -> tuple[float, float]:
    """Compute the ends of Student's t interval of a mean on a logarithmic scale.

    With m = `mean` and s = `std`, the ends are m exp(-+ t(0.975, n - 1) s / (sqrt(n) m)): for n
    values, the standard error of log m is s / (sqrt(n) m).
    """
    half_width = t_quantile(n - 1) * std / (math.sqrt(n) * mean)
    low = mean * math.exp(-half_width)
    high = mean * math.exp(half_width)
    return float(low), float(high)


def _skewed_upper_end(values: Floats, mean: float, std: float) -> float:
    """Compute the upper end of Hall's interval of a mean (J. R. Statist. Soc. B 54, 1992).

    The n values have mean m, standard deviation s and skewness G. With g = G / sqrt(n) the function

        f(T) = T + g T^2 / 3 + g^2 T^3 / 27 + g / 6

    removes the skewness from Student's T, so that f(T) is distributed about like T for normal
    values. The upper end is where f(T) is the lower quantile, -t(0.975, n - 1):

        m - T s / sqrt(n)  with  f(T) = -t(0.975, n - 1)

    As f(T) - g / 6 = ((1 + g T / 3)^3 - 1) / g, T is 3 / g (cbrt(1 + g (f(T) - g / 6)) - 1).
    """
    n = len(values)
    deviations = (values - mean) / std  # scaled first: cubes of small lengths would underflow
    moment = float(np.mean(deviations**3) / np.mean(deviations**2) ** 1.5)
    g = math.sqrt(n - 1) / (n - 2) * moment
    t = -t_quantile(n - 1)
    if abs(g) > 1e-6:  # otherwise f(T) is T
        t = 3 / g * float(np.cbrt(1 + g * (t - g / 6)) - 1)
    return float(mean - t * std / math.sqrt(n))


def proportion_interval(successes: int, n: int) -> Interval:
    """Compute Wilson's 95 % interval of a proportion p = `successes` / n.

    The ends are (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n). With n = 0,
    there is no interval.
    """
    if n == 0:
        return Interval.none("no trials")
    p = successes / n
    z2 = NORMAL_QUANTILE**2
    centre = p + z2 / (2 * n)
    scale = 1 + z2 / n
    half_width = NORMAL_QUANTILE * math.sqrt(p * (1 - p) / n + z2 / (4 * n**2))
    low = (centre - half_width) / scale if successes > 0 else 0.0
    high = (centre + half_width) / scale if successes < n else 1.0
    return Interval(low, high, "Wilson")


def percent(fraction: Interval) -> str:
    """Format the interval of a fraction in percent and in brackets. Return "" if there is none."""
    if not fraction.known:
        return ""
    return f" (95 % interval {100 * fraction.low:.0f} to {100 * fraction.high:.0f} %)"


# ---- Trials of the arms of a study ----


@dataclass(frozen=True, slots=True)
class ArmErrors:
    """The total errors of the trials in one arm of a study, which have the same settings.

    An object may also describe all trials with the same value of a swept field.

    Attributes:
        value: The value, or the arm's name.
        label: The value as text.
        arms: Number of arms that the trials belong to.
        errors: Total error of each trial, shape (n,).
        error: The distribution of these errors.
    """

    value: Any
    label: str
    arms: int
    errors: Floats  # (n,) of each trial
    error: Distribution

    @classmethod
    def from_errors(
        cls, value: Any, label: str, arms: int, errors: Floats, bound: float | None = None
    ) -> Self:
        """Compute the statistics of the errors of the trials of one arm.

        Args:
            value: Value of the swept field, or the arm's name.
            label: The value as text.
            arms: Number of arms that the trials belong to.
            errors: Total error of each trial, shape (n,).
            bound: Bound of the tail, as in `distributions`.
        """
        return cls(value, label, arms, errors, distributions(errors[None], bound)[0])


def are_numeric(arms: Iterable[ArmErrors]) -> bool:
    """Check whether the values of a swept field are numbers. True and False are not numbers."""
    return all(
        isinstance(arm.value, int | float) and not isinstance(arm.value, bool) for arm in arms
    )
