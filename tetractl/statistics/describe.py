"""Describe batches of trials: how large their errors are, and whether one batch is better.

`describe` returns the errors of a batch with intervals, the difference from the published result,
and statistics. `contrast` compares the total errors of each pair of batches. If their trials have
the same seeds, it compares pairs of trials. A verdict needs `PAIRS_MIN` pairs or trials. The
modules `tables` and `as_json` format the results.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.core.shown import NotebookDisplay
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.spec.experiment import FIELDS_WITHOUT_EFFECT, Experiment
from tetractl.statistics import mean_difference
from tetractl.statistics.estimate import CONFIDENCE, Distribution, Interval, distributions
from tetractl.statistics.mean_difference import MeanDifference, from_both_intervals
from tetractl.statistics.open_batch import (
    Batch,
    differences,
    is_counted,
    shared_experiment,
)
from tetractl.statistics.statistic import Figure, statistics

PAIRS_MIN = 8
"""Minimum number of pairs for a verdict. Without pairs, the minimum number of trials per batch."""
NO_PAIRS: Floats = np.zeros(0)
_FIELDS_OUTSIDE_WORLD = FIELDS_WITHOUT_EFFECT | {"controller", "name", "reference", "lab"}
"""Fields of a spec that do not change the disturbances of a trial."""


# ---- One batch ----


@dataclass(frozen=True, slots=True)
class BatchStatistics(NotebookDisplay):
    """The statistics of a batch of trials of N robots.

    Lengths are in `unit`. A trial is valid, and counts in the means, if the controller decided its
    outcome and its errors are known.
    """

    name: str
    batch: Batch
    experiment: Experiment = field(repr=False)
    origin: Origin
    totals: Floats = field(repr=False)
    """The total error of each valid trial (n,)."""
    errors: Floats = field(repr=False)
    """The error of each robot in each valid trial (n, N)."""
    total: Distribution
    """The distribution of `totals`."""
    robots: tuple[Distribution, ...] = field(repr=False)
    """The distribution of each robot's errors, N of them."""
    from_published: MeanDifference | None = field(repr=False)
    """The mean total error minus the published mean. None if the spec names no published result."""
    figures: tuple[Figure, ...] = field(repr=False)
    """The figures of all registered statistics, over all trials."""

    @property
    def unit(self) -> str:
        """The length unit of every error in the batch."""
        return self.experiment.units.length

    @property
    def counted(self) -> int:
        """The number of trials that count in the means.

        They are complete, their errors are known, and their logs are intact.
        """
        return self.total.n

    @property
    def attempts(self) -> int:
        """Number of earlier attempts at trials, which do not count in the means."""
        return len(self.batch.attempts) + len(self.batch.lost_attempts)


def describe(batch: Batch, name: str = "") -> BatchStatistics:
    """Compute the statistics of the trials of one experiment.

    Args:
        batch: The trials.
        name: Name to show. The name of the experiment if it is empty.

    Raises:
        UsageError: If the trials belong to several experiments, if a simulated trial occurs twice,
            or if every log is an attempt that was later repeated.
        LogError: If no log can be read.
    """
    experiment = shared_experiment(batch)
    origin = batch.trials[0].origin
    valid = [trial.result for trial in batch.trials if is_counted(trial)]
    totals = np.array([result.total_error for result in valid], dtype=float)
    errors = np.array([result.robot_errors for result in valid], dtype=float)
    errors = errors.reshape(len(valid), len(experiment.robots))
    (total,) = distributions(totals[None], experiment.error_bound)
    figures: list[Figure] = []
    for statistic in statistics():
        figures += statistic.of_batch(batch.trials)
    return BatchStatistics(
        name=name or experiment.name,
        batch=batch,
        experiment=experiment,
        origin=origin,
        totals=totals,
        errors=errors,
        total=total,
        robots=tuple(distributions(errors.T)),
        from_published=_from_published(experiment, total, origin),
        figures=tuple(figures),
    )


def _from_published(
    experiment: Experiment, total: Distribution, origin: Origin
) -> MeanDifference | None:
    """Compare the mean with the published mean of real robots by Welch's t test.

    Only trials of a real lab are compared. The difference of a simulation or an emulated lab is
    unknown, because it would say nothing about real robots. The result is None if nothing was
    published.
    """
    published = experiment.reference
    if published is None:
        return None
    if not origin.comparable:
        return MeanDifference.untested(math.nan, "not compared")
    return mean_difference.welch(
        total.n, total.mean, total.std, published.n, published.mean, published.std
    )


# ---- Comparisons ----


@dataclass(frozen=True, slots=True)
class Contrast(NotebookDisplay):
    """The comparison of the total errors of two batches. Differences are `first` minus `second`.

    Batches with different plants (`same_origin` is False) are not tested, and their p-values are
    NaN. The same applies if the directions of one batch were given in advance (`no_controller`),
    because such a batch has no rank among controllers.

    Attributes:
        first: The first batch.
        second: The second batch.
        pairs: Number of pairs of trials with the same disturbances.
        why_unpaired: Why there are no pairs. Empty if there are.
        difference: Difference of the means, with the paired t test or, without pairs, Welch's t
            test.
        from_both_means: Another interval of the difference, from the intervals of the two means.
        rank_p: p-value of Wilcoxon's signed-rank test or, without pairs, rank-sum test.
        detects: Difference that the test finds in 80 % of all studies of this size, in standard
            deviations of the paired differences or, without pairs, of the values.
        differs: Fields in which both specs differ.
        p_holm: p-value of the difference, corrected for the number of contrasts.
        rank_p_holm: p-value of the ranks, corrected for the number of contrasts.
    """

    first: BatchStatistics
    second: BatchStatistics
    pairs: int
    why_unpaired: str
    difference: MeanDifference
    from_both_means: Interval
    rank_p: float
    detects: float
    differs: tuple[str, ...]
    p_holm: float = math.nan
    rank_p_holm: float = math.nan

    @property
    def same_origin(self) -> bool:
        """Whether both batches come from the same kind of plant, such as a simulation."""
        return self.first.origin is self.second.origin

    @property
    def no_controller(self) -> bool:
        """Whether the directions of at least one batch were given, instead of chosen."""
        return self.first.experiment.gives_directions or self.second.experiment.gives_directions

    @property
    def reason(self) -> str | None:
        """Why there is no verdict on the two batches.

        The value is None if there is one. The first reason is given.
        """
        if not self.same_origin:
            return "the plants differ"
        if self.no_controller:
            return "the directions were given, so there was no controller to compare"
        if self.compared < PAIRS_MIN:
            needed = "pairs of trials" if self.pairs else "complete trials in each batch"
            return f"a verdict needs at least {PAIRS_MIN} {needed}"
        for interval in self.intervals:
            if not interval.known:
                return f"no interval: {interval.reason}"
        return None

    @property
    def verdict(self) -> str | None:
        """Whether the first batch's error is lower or higher.

        The value is None if there is a `reason` for no verdict.

        "lower" or "higher" requires that every interval of the difference is below or above 0, and
        that the corrected p is below 0.05. Otherwise, the verdict is "undecided".
        """
        if self.reason is not None:
            return None
        if self.p_holm < 1 - CONFIDENCE:
            if all(interval.high < 0 for interval in self.intervals):
                return "lower"
            if all(interval.low > 0 for interval in self.intervals):
                return "higher"
        return "undecided"

    @property
    def intervals(self) -> tuple[Interval, ...]:
        """The intervals of the difference on which the verdict is based.

        For paired trials, this is one interval. Otherwise, there are two: the one of Welch's test,
        and the one computed from the intervals of both means.
        """
        if self.pairs:
            return (self.difference.ci95,)
        return (self.difference.ci95, self.from_both_means)

    @property
    def compared(self) -> int:
        """The number of pairs. Without pairs, the number of counted trials of the smaller batch."""
        return self.pairs or min(self.first.counted, self.second.counted)

    @property
    def name(self) -> str:
        """Names of the two batches that are compared, as "one - other"."""
        return f"{self.first.name} - {self.second.name}"

    @property
    def test_of_means(self) -> str:
        """The test that compares the means: "paired t" for paired trials, otherwise "Welch's t"."""
        return "paired t" if self.pairs else "Welch's t"

    @property
    def tests(self) -> str:
        """Names of the tests of means and of ranks, as "paired t, signed rank"."""
        return f"{self.test_of_means}, {'signed rank' if self.pairs else 'rank sum'}"

    @property
    def counted(self) -> str:
        """Number of trials compared, as "20 pairs" or "20 and 9"."""
        if self.pairs:
            return f"{self.pairs} pairs"
        return f"{self.first.counted} and {self.second.counted}"


@dataclass(frozen=True, slots=True)
class BatchComparison(NotebookDisplay):
    """Several batches, and the comparison of every pair or of each batch with a baseline.

    A single batch has no contrasts.
    """

    groups: tuple[BatchStatistics, ...]
    contrasts: tuple[Contrast, ...] = field(default=(), repr=False)

    @property
    def unit(self) -> str:
        """The length unit of every error in the comparison."""
        return self.groups[0].unit

    @property
    def whole(self) -> bool:
        """Whether all logs of all batches are intact."""
        return all(group.batch.whole for group in self.groups)


def contrast(
    groups: Sequence[BatchStatistics], baseline: BatchStatistics | None = None
) -> BatchComparison:
    """Compare each pair of batches or, if there is a baseline, each batch with the baseline.

    Raises UsageError if batches have different units of length.
    """
    batches = (*groups, baseline) if baseline else tuple(groups)
    for group in batches:
        if group.unit != batches[0].unit:
            raise UsageError(
                f"{group.name} has errors in {group.unit}, but {batches[0].name} in "
                f"{batches[0].unit}",
                "compare only groups with the same length unit",
            )
    if baseline is None:
        group_pairs = list(combinations(groups, 2))
    else:
        group_pairs = [(group, baseline) for group in groups]
    test_count = sum(_is_tested(first, second) for first, second in group_pairs)
    contrasts = [_contrast(first, second, max(test_count, 1)) for first, second in group_pairs]
    mean_p_values = mean_difference.holm(
        [comparison.difference.p_value for comparison in contrasts]
    )
    rank_p_values = mean_difference.holm([comparison.rank_p for comparison in contrasts])
    corrected = [
        replace(comparison, p_holm=p_holm, rank_p_holm=rank_p_holm)
        for comparison, p_holm, rank_p_holm in zip(
            contrasts, mean_p_values, rank_p_values, strict=True
        )
    ]
    return BatchComparison(batches, tuple(corrected))


def _is_tested(first: BatchStatistics, second: BatchStatistics) -> bool:
    """Check whether the difference of two batches is tested.

    The plants must be of the same kind, and controllers must have decided the directions.
    """
    no_controller = first.experiment.gives_directions or second.experiment.gives_directions
    return first.origin is second.origin and not no_controller


def _contrast(first: BatchStatistics, second: BatchStatistics, test_count: int) -> Contrast:
    """Compare two batches: the difference is the mean of the first minus the mean of the second.

    The p-values are not yet corrected for several comparisons. They are NaN if the batches are not
    tested.
    """
    first_errors = first.total
    second_errors = second.total
    paired_differences, why_unpaired = pair_up(first, second)
    pairs = len(paired_differences)
    if pairs:
        difference = mean_difference.paired_t(paired_differences)
        rank_p = mean_difference.signed_rank(paired_differences)
        detects = mean_difference.detectable(pairs, tests=test_count)
    else:
        difference = mean_difference.welch(
            first_errors.n,
            first_errors.mean,
            first_errors.std,
            second_errors.n,
            second_errors.mean,
            second_errors.std,
        )
        rank_p = mean_difference.rank_sum(first.totals, second.totals)
        detects = mean_difference.detectable(first_errors.n, second_errors.n, test_count)
    if not _is_tested(first, second):
        difference = replace(difference, p_value=math.nan)
        rank_p = math.nan
        detects = math.nan
    return Contrast(
        first=first,
        second=second,
        pairs=pairs,
        why_unpaired=why_unpaired,
        difference=difference,
        from_both_means=from_both_intervals(first_errors, second_errors),
        rank_p=rank_p,
        detects=detects,
        differs=tuple(differences(first.experiment, second.experiment)),
    )


def pair_up(first: BatchStatistics, second: BatchStatistics) -> tuple[Floats, str]:
    """Find the pairs of trials in two batches, and compute the differences of their total errors.

    A pair is two simulated trials with the same seed, number and disturbances, which do not depend
    on the controller.

    Returns:
        The differences, first batch minus second batch, shape (n,). Then the reason why there are
        no pairs, or "" if there are pairs.
    """
    if not (first.origin.simulated and second.origin.simulated):
        return NO_PAIRS, "no two trials in a lab have the same disturbances"
    if _world_fields(first) != _world_fields(second):
        return NO_PAIRS, "the specs of the batches differ in more than the controller"
    first_errors = _errors_by_trial(first.batch.trials)
    second_errors = _errors_by_trial(second.batch.trials)
    paired_differences = [
        error - second_errors[trial]
        for trial, error in first_errors.items()
        if trial in second_errors
    ]
    if not paired_differences:
        return NO_PAIRS, "the batches have no seed and trial in common"
    return np.array(paired_differences), ""


def _world_fields(group: BatchStatistics) -> dict[str, object]:
    """Return a batch's spec without its controller and fields that do not affect a trial."""
    return group.experiment.model_dump(mode="json", exclude=set(_FIELDS_OUTSIDE_WORLD))


def _errors_by_trial(trials: Sequence[ResultSummary]) -> dict[tuple[int, int], float]:
    """Return the total error of each counted trial, keyed by (seed, number of the trial)."""
    return {
        (trial.seed, trial.trial): trial.result.total_error for trial in trials if is_counted(trial)
    }
