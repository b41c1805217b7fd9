"""Compare the means and the ranks of two batches of trials."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from tetractl.core.poses import Floats
from tetractl.statistics.estimate import CONFIDENCE, Distribution, Interval, t_quantile
from tetractl.tools.table.table import format_p_value

_NAN = math.nan


@dataclass(frozen=True, slots=True)
class MeanDifference:
    """A difference of two means, the first minus the second, with its t test.

    Attributes:
        value: The difference.
        ci95: Its 95 % confidence interval.
        p_value: The p-value of the test.
        degrees: Degrees of freedom of the test.
    """

    value: float
    ci95: Interval
    p_value: float
    degrees: float

    @classmethod
    def by_t(cls, value: float, error: float, degrees: float, method: str) -> "MeanDifference":
        """Test a difference of means with Student's t distribution.

        Args:
            value: The difference.
            error: Its standard error.
            degrees: Degrees of freedom.
            method: Name of the test.
        """
        half_width = t_quantile(degrees) * error
        p_value = 2 * float(special.stdtr(degrees, -abs(value) / error))
        return cls(
            value, Interval(value - half_width, value + half_width, method), p_value, degrees
        )

    @classmethod
    def untested(cls, value: float, reason: str, degrees: float = _NAN) -> "MeanDifference":
        """Create a difference of two means without interval and p-value.

        Args:
            value: The difference.
            reason: Why the difference is not tested.
            degrees: Degrees of freedom. NaN if there are none.
        """
        return cls(value, Interval.none(reason), _NAN, degrees)

    def text(self, unit: str, format_number: Callable[[float], str], p_value: float) -> str:
        """Format this difference of two means, with its interval and a p-value.

        Args:
            unit: Unit of the difference.
            format_number: Formats a number.
            p_value: The p-value, corrected or not. NaN if there is none.
        """
        difference = (
            f"{format_number(self.value)} {unit} (95 % interval {self.ci95.text(format_number)})"
        )
        if not p_value >= 0:  # NaN
            return difference
        equals = "" if p_value < 0.001 else "= "
        return f"{difference}, p {equals}{format_p_value(p_value)}"

    def as_dict(self) -> dict[str, object]:
        """Return the difference of means as items of JSON. Without a test, the p-value is NaN."""
        return {
            "difference": self.value,
            **self.ci95.as_dict(),
            "p_value": self.p_value,
            "degrees_of_freedom": self.degrees,
        }


def welch(n1: int, mean1: float, std1: float, n2: int, mean2: float, std2: float) -> MeanDifference:
    """Compare two means with Welch's t test, from summaries alone.

    With v_i = std_i^2 / n_i: t = (mean1 - mean2) / sqrt(v1 + v2), and the degrees of freedom of
    Welch and Satterthwaite are (v1 + v2)^2 / (v1^2 / (n1 - 1) + v2^2 / (n2 - 1)).

    Args:
        n1: Number of values in the first group.
        mean1: Mean of the first group.
        std1: Standard deviation of the first group, with n - 1.
        n2: Number of values in the second group.
        mean2: Mean of the second group.
        std2: Standard deviation of the second group, with n - 1.
    """
    difference = mean1 - mean2
    if min(n1, n2) < 2:
        return MeanDifference.untested(difference, "Welch's t needs two values on each side")
    v1 = std1**2 / n1
    v2 = std2**2 / n2
    if v1 + v2 == 0:
        return MeanDifference.untested(difference, "the values do not vary on either side")
    share = v1 / (v1 + v2)
    degrees = 1 / (share**2 / (n1 - 1) + (1 - share) ** 2 / (n2 - 1))
    return MeanDifference.by_t(difference, math.sqrt(v1 + v2), degrees, "Welch")


def paired_t(differences: Floats) -> MeanDifference:
    """Compare two means from the differences (n,) of pairs with Student's t test.

    For fewer than two pairs, or if all differences are equal, there is no interval and no p-value.
    """
    n = len(differences)
    differences = np.sort(differences)  # the order of the pairs must not matter
    mean = float(differences.mean()) if n else _NAN
    if n < 2:
        return MeanDifference.untested(mean, "an interval needs two pairs")
    error = float(differences.std(ddof=1)) / math.sqrt(n)
    if not error > 0:
        return MeanDifference.untested(mean, "all differences are equal", n - 1)
    return MeanDifference.by_t(mean, error, n - 1, "paired t")


def from_both_intervals(first: Distribution, second: Distribution) -> Interval:
    """Compute the interval of the difference of two means from the intervals of the means.

    With means m, m', lower ends l, l' and upper ends u, u', by Zou and Donner (Statistics in
    Medicine 27, 2008): from m - m' - sqrt((m - l)^2 + (u' - m')^2) to m - m' + sqrt((u - m)^2 + (m'
    - l')^2).
    """
    below, above = _distances_to_ends(first)
    below2, above2 = _distances_to_ends(second)
    if not all(map(math.isfinite, (below, above, below2, above2))):
        unknown = first if not first.ci95.known else second
        return Interval.none(f"the mean of one batch has no interval: {unknown.ci95.reason}")
    if max(below, above, below2, above2) == 0:
        return Interval.none("the values do not vary on either side")
    difference = first.mean - second.mean
    return Interval(
        difference - math.hypot(below, above2),
        difference + math.hypot(above, below2),
        "both intervals",
    )


def _distances_to_ends(values: Distribution) -> tuple[float, float]:
    """Compute the distances from a mean to the lower and the upper end of its interval.

    Both distances are 0 if all values are equal, and NaN if there is no interval.
    """
    if values.n > 1 and values.std == 0:
        return 0.0, 0.0
    return values.mean - values.ci95.low, values.ci95.high - values.mean


POWER = 0.8
"""Probability with which a test finds a difference that counts as detectable."""


def detectable(n: int, m: int | None = None, tests: int = 1) -> float:
    """Compute the difference that a t test finds with probability POWER.

    The level of the test is the strictest one in Holm's correction. For pairs, let N = n and f = n
    - 1. For two groups, let N = m n / (m + n) and f = m + n - 2. The result is (t(1 - level / 2, f)
    + t(POWER, f)) / sqrt(N), which is within 1.5 % of the noncentral t.

    Args:
        n: Number of pairs, or of values in the first group.
        m: Number of values in the second group. None for pairs.
        tests: Number of tests.

    Returns:
        The difference, in standard deviations of the pairs' differences, or of the values. NaN for
        fewer than 2.
    """
    if n < 2 or (m is not None and m < 2):
        return _NAN
    if m is None:
        degrees = n - 1
        effective_n = float(n)
    else:
        degrees = m + n - 2
        effective_n = m * n / (m + n)
    level = (1 - CONFIDENCE) / tests
    # `t_quantile` is two-sided: its bound for 2 POWER - 1 is not exceeded with POWER on one side
    return (t_quantile(degrees, 1 - level) + t_quantile(degrees, 2 * POWER - 1)) / math.sqrt(
        effective_n
    )


EXACT_VALUES_MAX = 60
"""Maximum number of unpaired values for which the rank-sum test is exact, without ties."""


def signed_rank(differences: Floats) -> float:
    """Compute the p-value of Wilcoxon's signed-rank test that differences are centred at 0.

    The p-value is exact for up to 50 differences if no two are equal in size, and otherwise for up
    to 13. Differences of exactly 0 are left out; NaN if none is left.
    """
    from scipy import stats  # slow to import, and needed by comparisons alone

    is_different = differences != 0
    differing = differences[is_different]
    if not len(differing):
        return _NAN
    test: Any = stats.wilcoxon(differing)
    return float(test.pvalue)


def rank_sum(first: Floats, second: Floats) -> float:
    """Compute the p-value of the rank-sum test (Wilcoxon, Mann and Whitney) of two samples.

    The samples have shapes (m,) and (n,). The p-value is exact for up to EXACT values without ties.
    The result is NaN if one side has no values.
    """
    from scipy import stats

    if min(len(first), len(second)) == 0:
        return _NAN
    pooled = np.concatenate([first, second])
    if pooled.min() == pooled.max():
        return 1.0
    has_ties = len(np.unique(pooled)) < len(pooled)
    exact = len(pooled) <= EXACT_VALUES_MAX and not has_ties
    method = "exact" if exact else "asymptotic"
    return float(stats.mannwhitneyu(first, second, use_continuity=False, method=method).pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """Correct p-values for multiple comparisons (Holm, Scand. J. Statist. 6, 1979).

    The i-th smallest of k p-values is multiplied by k - i + 1, and is at least as large as the
    corrected value of the next smaller p-value. NaN stays NaN and is not counted in k.
    """
    order = sorted((p_value, i) for i, p_value in enumerate(p_values) if not math.isnan(p_value))
    corrected = [_NAN] * len(p_values)
    largest = 0.0  # of the corrected values of smaller p-values
    for rank, (p_value, i) in enumerate(order):
        largest = max(largest, min(1.0, p_value * (len(order) - rank)))
        corrected[i] = largest
    return corrected
