"""Compares the total errors of pairs of batches, such as two folders or the arms of a study."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results import mean_difference
from tetractl.results.describe import BatchStatistics
from tetractl.results.estimate import CONFIDENCE, Interval
from tetractl.results.mean_difference import MeanDifference, from_both_intervals
from tetractl.results.open_batch import counts, differences, directions_given

ENOUGH = 8
"""Least number of pairs or, without pairs, of trials on each side, for a verdict."""
_NOT_THE_WORLD = {"controller", "name", "description", "trials", "reference", "scale", "lab"}


@dataclass(frozen=True, slots=True)
class Contrast:
    """Comparison of the total errors of two batches; differences are `one` minus `other`.

    `pairs` is the number of pairs of trials with the same disturbances; without pairs,
    `why_unpaired` is the reason. `difference` is tested by the paired t test, or without pairs by
    Welch's t test; `both` is another interval of this difference, computed from the intervals of
    the two means. `rank_p` is the p-value of Wilcoxon's signed-rank test or, without pairs,
    rank-sum test. `p_holm` and `rank_p_holm` are the p-values for means and ranks, corrected for
    the number of contrasts. `detects` is the difference that the test finds in 80 % of all studies
    of this size, in standard deviations of the paired differences or, without pairs, of the values.
    `differs` lists the fields in which both specs differ. `verdict` is "lower", "higher" or
    "undecided", or None with a `reason`. Groups with different plants (`alike` False) are not
    tested: their p-values are NaN. Nor are batches of which one had its directions `given`, perhaps
    with hindsight: it has no rank among controllers.
    """

    one: BatchStatistics
    other: BatchStatistics
    alike: bool
    given: bool
    pairs: int
    why_unpaired: str
    difference: MeanDifference
    both: Interval
    rank_p: float
    detects: float
    differs: tuple[str, ...]
    p_holm: float = math.nan
    rank_p_holm: float = math.nan

    @property
    def verdict(self) -> str | None:
        """The verdict, None if there is none."""
        return self.judged[0]

    @property
    def reason(self) -> str | None:
        """Why there is no verdict."""
        return self.judged[1]

    @property
    def judged(self) -> tuple[str | None, str | None]:
        """The verdict and None, or None and the reason why there is no verdict.

        "lower" or "higher" needs ENOUGH pairs (or trials on each side), every interval of the
        difference below or above 0, and a corrected p below 0.05.
        """
        if not self.alike:
            return None, "plants are not alike"
        if self.given:
            return None, "directions were given: no controller decided"
        if (self.pairs or min(self.one.counted, self.other.counted)) < ENOUGH:
            what = "pairs" if self.pairs else "complete trials on each side"
            return None, f"a verdict needs {ENOUGH} {what}"
        intervals = [self.difference.ci95] if self.pairs else [self.difference.ci95, self.both]
        for interval in intervals:
            if not interval.known:
                return None, f"no interval: {interval.reason}"
        if self.p_holm < 1 - CONFIDENCE:
            if all(interval.high < 0 for interval in intervals):
                return "lower", None
            if all(interval.low > 0 for interval in intervals):
                return "higher", None
        return "undecided", None

    @property
    def name(self) -> str:
        """Names of the batches as "one - other"."""
        return f"{self.one.name} - {self.other.name}"

    @property
    def tests(self) -> str:
        """Names of the tests of means and of ranks, as "paired t, signed rank"."""
        return "paired t, signed rank" if self.pairs else "Welch's t, rank sum"

    @property
    def counted(self) -> str:
        """Number of trials compared, as "20 pairs" or "20 and 9"."""
        return (
            f"{self.pairs} pairs" if self.pairs else f"{self.one.counted} and {self.other.counted}"
        )

    @property
    def record(self) -> dict[str, Any]:
        """The comparison by its keys in JSON."""
        sides = {
            f"{side}_{key}": value
            for side, group in (("one", self.one), ("other", self.other))
            for key, value in (
                ("origin", group.origin.value),
                ("n", group.counted),
                ("mean", group.total.mean),
                ("std", group.total.std),
                ("tail", group.total.tail.as_dict()),
            )
        }
        return {
            "one": self.one.name,
            "other": self.other.name,
            "unit": self.one.unit,
            **sides,
            "comparable": self.alike,
            "pairs": self.pairs,
            "unpaired_reason": self.why_unpaired or None,
            **self.difference.as_dict(),
            "both": self.both.as_dict(),
            "p_holm": self.p_holm,
            "rank_p": self.rank_p,
            "rank_p_holm": self.rank_p_holm,
            "tests": self.tests,
            "detects_sd": self.detects,
            "verdict": self.verdict,
            "verdict_reason": self.reason,
            "differs": list(self.differs),
        }


@dataclass(frozen=True, slots=True)
class BatchComparison:
    """Batches, and the contrasts of every two batches or of each batch with a baseline."""

    groups: tuple[BatchStatistics, ...]
    contrasts: tuple[Contrast, ...] = field(default=(), repr=False)

    @property
    def unit(self) -> str:
        """The length unit of every error."""
        return self.groups[0].unit

    @property
    def record(self) -> dict[str, Any]:
        """The object that `stats --format json` prints: of one batch its record, of several
        `groups` and `comparisons`. Numbers are not rounded; unknown values are NaN.
        """
        if len(self.groups) == 1:
            return self.groups[0].record
        return {
            "unit": self.unit,
            "groups": [{"name": group.name, **group.record} for group in self.groups],
            "comparisons": [one.record for one in self.contrasts],
        }

    @property
    def whole(self) -> bool:
        """Whether no log of any batch is damaged."""
        return all(group.batch.whole for group in self.groups)


def contrast(
    groups: Sequence[BatchStatistics], baseline: BatchStatistics | None = None
) -> BatchComparison:
    """Compare each pair of batches or, with a baseline, each batch with the baseline.

    Raises UsageError if batches have different units of length.
    """
    every = (*groups, baseline) if baseline else tuple(groups)
    first = every[0]
    for group in every:
        if group.unit != first.unit:
            units = f"{group.name} has errors in {group.unit}, {first.name} in {first.unit}"
            raise UsageError(units, "compare groups with the same length unit")
    two = [(group, baseline) for group in groups] if baseline else list(combinations(groups, 2))
    tests = sum(one.origin is other.origin for one, other in two)
    found = [_contrast(one, other, max(tests, 1)) for one, other in two]
    means = mean_difference.holm([one.difference.p_value for one in found])
    ranks = mean_difference.holm([one.rank_p for one in found])
    corrected = (
        replace(one, p_holm=p, rank_p_holm=rank)
        for one, p, rank in zip(found, means, ranks, strict=True)
    )
    return BatchComparison(every, tuple(corrected))


def _contrast(one: BatchStatistics, other: BatchStatistics, tests: int) -> Contrast:
    """Compare two batches; p-values are not corrected yet, and there is no verdict."""
    a, b = one.total, other.total
    alike = one.origin is other.origin
    paired, why = paired_differences(one, other)
    if len(paired):
        difference = mean_difference.paired_t(paired)
        rank_p = mean_difference.signed_rank(paired)
        detects = mean_difference.detectable(len(paired), tests=tests)
    else:
        difference = mean_difference.welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
        rank_p = mean_difference.rank_sum(one.totals, other.totals)
        detects = mean_difference.detectable(a.n, b.n, tests)
    given = directions_given(one.experiment) or directions_given(other.experiment)
    if given or not alike:
        rank_p = detects = math.nan
        difference = replace(difference, p_value=math.nan)
    return Contrast(
        one=one,
        other=other,
        alike=alike,
        given=given,
        pairs=len(paired),
        why_unpaired=why,
        difference=difference,
        both=from_both_intervals(a, b),
        rank_p=rank_p,
        detects=detects,
        differs=tuple(differences(one.experiment, other.experiment)),
    )


def paired_differences(one: BatchStatistics, other: BatchStatistics) -> tuple[Floats, str]:
    """Return the differences (n,) between the total errors of paired trials, `one` minus `other`,
    and "" or the reason why there are no pairs.

    A pair is two simulated trials with the same seed, number and disturbances, which do not depend
    on the controller.
    """
    if not (one.origin.simulated and other.origin.simulated):
        return np.zeros(0), "no two trials in a lab have the same disturbances"
    ours, theirs = (
        group.experiment.model_dump(mode="json", exclude=_NOT_THE_WORLD) for group in (one, other)
    )
    if ours != theirs:
        return np.zeros(0), "the batches differ in more than the controller"
    others = _by_world(other.batch.trials)
    own = _by_world(one.batch.trials)
    pairs = [error - others[world] for world, error in own.items() if world in others]
    if not pairs:
        return np.zeros(0), "the batches have no seed and trial in common"
    return np.array(pairs), ""


def _by_world(trials: Sequence[ResultSummary]) -> dict[tuple[int, int], float]:
    """Return the total error of each counted trial by the trial's seed and number."""
    return {
        (trial.seed, trial.trial): trial.result.total_error for trial in trials if counts(trial)
    }
