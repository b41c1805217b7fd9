"""What a batch of trials amounts to, and how two batches compare."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import MILLISECOND
from tetractl.core.errors import UsageError
from tetractl.core.plan import Outcome
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
    proportion_interval,
    welch,
)
from tetractl.stats.trials import Damaged, counts, differences, one_batch


@dataclass(frozen=True, slots=True)
class SolveTimes:
    """Wall time the controller spent on a step, over every step of every trial [ms]."""

    p50: float
    p99: float
    max: float


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
    """Statistics of one batch; lengths in `unit`.

    `total` and `robots` describe the errors of the counted trials: the complete ones, whose
    outcome the controller decided. The other counts are over all trials.
    """

    experiment: Experiment
    trials: tuple[ResultSummary, ...]
    damaged: tuple[Damaged, ...]
    totals: Floats  # (n,) total errors of the counted trials
    errors: Floats  # (n, N) errors of each robot in them
    total: Distribution
    robots: tuple[Distribution, ...]
    obstacle_violations: int
    violations_ci95: Interval
    arrived: int
    arrived_ci95: Interval
    aborted: int
    interrupted: int
    solve_ms: SolveTimes
    deadline_misses: int
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
    def whole(self) -> bool:
        """Whether no log was damaged."""
        return not self.damaged and not any(trial.recovered for trial in self.trials)


def summarise(trials: Sequence[ResultSummary], damaged: Sequence[Damaged] = ()) -> Summary:
    """Summarise the trials of one experiment.

    Raises UsageError where they belong to several, or where a simulated trial occurs twice.
    """
    experiment = one_batch(trials)
    results = [trial.result for trial in trials]
    counted = [trial.result for trial in trials if counts(trial)]
    robots = len(experiment.robots)
    totals = np.array([result.total_error for result in counted], dtype=float)
    errors = np.array([result.robot_errors for result in counted], dtype=float)
    errors = errors.reshape(len(counted), robots)
    total, *each = describe(np.vstack([totals, errors.T]))
    outcomes = [trial.outcome for trial in trials]
    violations = sum(result.entered_obstacle for result in results)
    arrived = outcomes.count(Outcome.ARRIVED)
    return Summary(
        experiment=experiment,
        trials=tuple(trials),
        damaged=tuple(damaged),
        totals=totals,
        errors=errors,
        total=total,
        robots=tuple(each),
        obstacle_violations=violations,
        violations_ci95=proportion_interval(violations, len(results)),
        arrived=arrived,
        arrived_ci95=proportion_interval(arrived, len(results)),
        aborted=outcomes.count(Outcome.ABORTED),
        interrupted=outcomes.count(Outcome.INTERRUPTED),
        solve_ms=_solve_times([ns for result in results for ns in result.solve_ns]),
        deadline_misses=sum(result.deadline_misses for result in results),
        published=_published(experiment, total),
        scaled=_scaled(experiment, total),
    )


def _solve_times(solve_ns: Sequence[int]) -> SolveTimes:
    if not solve_ns:
        return SolveTimes(math.nan, math.nan, math.nan)
    p50, p99, most = np.percentile(np.asarray(solve_ns, dtype=float) / MILLISECOND, [50, 99, 100])
    return SolveTimes(float(p50), float(p99), float(most))


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
