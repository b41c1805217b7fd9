"""The statistics of a batch of trials, and the comparison of two batches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.experiment.experiment import Experiment, Reference, Scale
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.estimate import (
    ENOUGH,
    Distribution,
    Effect,
    Interval,
    MeanDifference,
    bootstrap_difference,
    cliffs_delta,
    describe,
    welch,
)
from tetractl.stats.kinds import statistics
from tetractl.stats.statistic import Value
from tetractl.stats.trials import Damaged, counts, differences, one_batch


@dataclass(frozen=True, slots=True)
class Published:
    """The published result, and ours minus it by Welch's t."""

    reference: Reference
    comparison: MeanDifference


@dataclass(frozen=True, slots=True)
class Scaled:
    """The mean error of one robot scaled to another kind of robot by the ratio of speeds.

    error = (total error / N) (scale.speed / mean speed of the N robots), in `scale.unit`; lengths
    are the same in body lengths. NaN where no robot moves. `published` scales the reference.
    """

    scale: Scale
    error: float
    ci95: Interval
    published: float

    def body_lengths(self, error: float) -> float:
        """Convert an error in `scale.unit` to body lengths."""
        return error / self.scale.body_length


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of one batch of N robots; lengths in `unit`.

    `total` and `robots` describe the errors of the n trials that count: the complete ones, whose
    outcome the controller decided. `statistics` are the values of `stats.kinds`, over all trials.
    """

    experiment: Experiment
    trials: tuple[ResultSummary, ...]
    damaged: tuple[Damaged, ...]
    totals: Floats  # (n,) total errors
    errors: Floats  # (n, N) errors of each robot
    total: Distribution
    robots: tuple[Distribution, ...]
    statistics: tuple[Value, ...]
    published: Published | None
    scaled: Scaled | None

    @property
    def unit(self) -> str:
        """The length unit of every error."""
        return self.experiment.units.length

    @property
    def counted(self) -> int:
        """Number of trials behind the means."""
        return self.total.n

    @property
    def items(self) -> dict[str, Any]:
        """The statistics by their keys in JSON, such as `arrived` and `solve_ms`."""
        return {key: item for value in self.statistics for key, item in value.items.items()}

    @property
    def whole(self) -> bool:
        """Whether no log was damaged."""
        return not self.damaged and not any(trial.recovered for trial in self.trials)


def summarise(trials: Sequence[ResultSummary], damaged: Sequence[Damaged] = ()) -> Summary:
    """Summarise the trials of one experiment.

    Raises UsageError where they belong to several, or where a simulated trial occurs twice.
    """
    experiment = one_batch(trials)
    counted = [trial.result for trial in trials if counts(trial)]
    robots = len(experiment.robots)
    totals = np.array([result.total_error for result in counted], dtype=float)
    errors = np.array([result.robot_errors for result in counted], dtype=float)
    errors = errors.reshape(len(counted), robots)
    total, *each = describe(np.vstack([totals, errors.T]))
    return Summary(
        experiment=experiment,
        trials=tuple(trials),
        damaged=tuple(damaged),
        totals=totals,
        errors=errors,
        total=total,
        robots=tuple(each),
        statistics=tuple(statistic.of_batch(trials) for statistic in statistics()),
        published=_published(experiment, total),
        scaled=_scaled(experiment, total),
    )


def _published(experiment: Experiment, total: Distribution) -> Published | None:
    if (reference := experiment.reference) is None:
        return None
    comparison = welch(total.n, total.mean, total.std, reference.n, reference.mean, reference.std)
    return Published(reference, comparison)


def _scaled(experiment: Experiment, total: Distribution) -> Scaled | None:
    if (scale := experiment.scale) is None:
        return None
    speeds = sum(robot.speed for robot in experiment.robots)
    # (total / N) (scale.speed / mean speed): the number of robots cancels
    factor = scale.speed / speeds if speeds > 0 else math.nan
    interval = total.ci95
    if interval.known:
        interval = Interval(interval.low * factor, interval.high * factor, interval.method)
    published = experiment.reference.mean * factor if experiment.reference else math.nan
    return Scaled(scale, total.mean * factor, interval, published)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two batches of total errors: `ours` against `theirs`, differences being ours minus theirs.

    `verdict` is "lower", "higher" or "undecided" as the two intervals of the difference say
    together, and None, with the reason, where the trials are too few to tell.
    """

    ours: Summary
    theirs: Summary
    differs: tuple[str, ...]
    welch: MeanDifference
    bootstrap: Interval
    effect: Effect
    verdict: str | None
    reason: str | None


def compare(ours: Summary, theirs: Summary) -> Comparison:
    """Compare the total errors of two batches; they must share the unit of length."""
    if ours.unit != theirs.unit:
        raise UsageError(f"cannot compare errors in {ours.unit} with errors in {theirs.unit}")
    a, b = ours.total, theirs.total
    difference = welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
    bootstrap = bootstrap_difference(ours.totals, theirs.totals)
    verdict, reason = _verdict(min(a.n, b.n), difference.ci95, bootstrap)
    return Comparison(
        ours,
        theirs,
        tuple(differences(ours.experiment, theirs.experiment)),
        difference,
        bootstrap,
        cliffs_delta(ours.totals, theirs.totals),
        verdict,
        reason,
    )


def _verdict(n: int, *intervals: Interval) -> tuple[str | None, str | None]:
    if n < ENOUGH:
        return None, f"a verdict needs {ENOUGH} complete trials on each side"
    if not all(interval.known for interval in intervals):
        return None, "no interval of the difference"
    if all(interval.high < 0 for interval in intervals):
        return "lower", None
    if all(interval.low > 0 for interval in intervals):
        return "higher", None
    return "undecided", None
