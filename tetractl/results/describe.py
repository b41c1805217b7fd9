"""Describes a batch of trials in numbers: errors with intervals, the published result, statistics.

`batch_rows` makes rows of text for tables of a description, and `as_json` JSON.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.poses import Floats
from tetractl.experiment.experiment import Experiment, Scale
from tetractl.log.read.trial_log import Origin
from tetractl.results.estimate import Distribution, Interval, distributions
from tetractl.results.mean_difference import MeanDifference, welch
from tetractl.results.open_batch import Batch, counts, experiment_of
from tetractl.results.statistic import statistics
from tetractl.results.statistic_value import StatisticValue


@dataclass(frozen=True, slots=True)
class ScaledError:
    """The mean error of one robot, scaled to robots of another kind by the ratio of speeds.

    It is (mean total error / N) (scale.speed / mean speed of the N robots), in the unit of `scale`;
    `published_mean` is the published mean error scaled by the same factor, NaN without one. All are
    NaN if every speed is 0. `body_lengths` are in body lengths of the other robots.
    """

    scale: Scale
    mean: float
    ci95: Interval
    published_mean: float

    @property
    def body_lengths(self) -> float:
        """The mean in body lengths."""
        return self.mean / self.scale.body_length

    @property
    def published_body_lengths(self) -> float:
        """The published mean in body lengths."""
        return self.published_mean / self.scale.body_length


@dataclass(frozen=True, slots=True)
class BatchStatistics:
    """A batch of trials of N robots, with a name; lengths in `unit`.

    `totals` (n,) and `errors` (n, N) are the errors of the n valid trials, those whose outcome the
    controller decided and whose errors are known; `total` and `robots` describe them.
    `from_published` is the mean minus the published mean, and `scaled` the error of a robot of
    another kind; they are None if the spec names no published result, or no such robot. `values`
    are those of all registered statistics, over all trials.
    """

    name: str
    batch: Batch
    experiment: Experiment = field(repr=False)
    origin: Origin
    totals: Floats = field(repr=False)  # (n,) total errors
    errors: Floats = field(repr=False)  # (n, N) errors of each robot
    total: Distribution
    robots: tuple[Distribution, ...] = field(repr=False)
    from_published: MeanDifference | None = field(repr=False)
    scaled: ScaledError | None = field(repr=False)
    values: tuple[StatisticValue, ...] = field(repr=False)

    @property
    def unit(self) -> str:
        """The length unit of every error."""
        return self.experiment.units.length

    @property
    def counted(self) -> int:
        """Number of trials in the means."""
        return self.total.n

    @property
    def attempts(self) -> int:
        """Number of earlier attempts, which are excluded."""
        return len(self.batch.attempts) + len(self.batch.lost_attempts)


def describe(batch: Batch, name: str = "") -> BatchStatistics:
    """Describe the trials of one experiment.

    Raises UsageError if they belong to several experiments, or if a simulated trial occurs twice.
    """
    experiment = experiment_of(batch)
    origin = batch.trials[0].origin
    valid = [trial.result for trial in batch.trials if counts(trial)]
    totals = np.array([result.total_error for result in valid], dtype=float)
    errors = np.array([result.robot_errors for result in valid], dtype=float)
    errors = errors.reshape(len(valid), len(experiment.robots))
    (total,) = distributions(totals[None], experiment.error_bound)
    values = [value for one in statistics() for value in one.of_batch(batch.trials)]
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
        scaled=_scaled(experiment, total, origin),
        values=tuple(values),
    )


def _from_published(
    experiment: Experiment, total: Distribution, origin: Origin
) -> MeanDifference | None:
    """Return the measured mean minus the published mean, tested by Welch's t test; unknown for an
    undisturbed simulation and an emulated lab. None if nothing was published.
    """
    published = experiment.reference
    if published is None:
        return None
    if not origin.comparable:
        return MeanDifference.untested(math.nan, "not compared")
    return welch(total.n, total.mean, total.std, published.n, published.mean, published.std)


def _scaled(experiment: Experiment, total: Distribution, origin: Origin) -> ScaledError | None:
    """Return the error of a robot of another kind; None if the spec names none, or the trials
    cannot be compared with those of real robots.
    """
    scale = experiment.scale
    if scale is None or not origin.comparable:
        return None
    speeds = sum(robot.speed for robot in experiment.robots)
    factor = scale.speed / speeds if speeds > 0 else math.nan  # the number of robots cancels
    ci95 = total.ci95
    published = experiment.reference
    return ScaledError(
        scale=scale,
        mean=total.mean * factor,
        ci95=Interval(ci95.low * factor, ci95.high * factor, reason=ci95.reason),
        published_mean=published.mean * factor if published else math.nan,
    )
