"""Says how large the errors of a batch of trials are: `describe` returns errors with intervals, the
difference from the published result, and statistics, which `tables` and `as_json` write."""

import math
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.poses import Floats
from tetractl.core.shown import Shown
from tetractl.experiment.experiment import Experiment, Scale
from tetractl.log.read.trial_log import Origin
from tetractl.results.estimate import Distribution, Interval, distributions
from tetractl.results.mean_difference import MeanDifference, welch
from tetractl.results.open_batch import (
    Batch,
    counts,
    experiment_of,
)
from tetractl.results.statistic import Figure, statistics


@dataclass(frozen=True, slots=True)
class ScaledError:
    """The mean error of one robot, scaled to robots of another kind by the ratio of speeds.

    With total error E and speeds v_i of N robots it is (mean of E / N) (scale.speed / mean of v_i),
    hence the mean of E times scale.speed / sum of v_i, in the unit of `scale`; NaN if every speed
    is 0.
    """

    scale: Scale
    """The robot of another kind: its speed and body length."""
    mean: float
    ci95: Interval
    published_mean: float
    """The published mean error, scaled by the same factor; NaN if none was published."""

    @property
    def body_lengths(self) -> float:
        """The mean in body lengths."""
        return self.mean / self.scale.body_length

    @property
    def published_body_lengths(self) -> float:
        """The published mean in body lengths."""
        return self.published_mean / self.scale.body_length


@dataclass(frozen=True, slots=True)
class BatchStatistics(Shown):
    """A batch of trials of N robots, with a name; lengths in `unit`.

    Its n valid trials are those whose outcome the controller decided and whose errors are known.
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
    """How `totals` are distributed."""
    robots: tuple[Distribution, ...] = field(repr=False)
    """How the errors of each robot are distributed, N of them."""
    from_published: MeanDifference | None = field(repr=False)
    """The mean total error minus the published one; None if the spec names no published result."""
    scaled: ScaledError | None = field(repr=False)
    """The error of a robot of another kind; None if the spec names no such robot."""
    figures: tuple[Figure, ...] = field(repr=False)
    """The figures of all registered statistics, over all trials."""

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

    Raises UsageError if there are none but earlier attempts, if they belong to several experiments,
    or if a simulated trial occurs twice; LogError if no log can be read.
    """
    experiment = experiment_of(batch)
    origin = batch.trials[0].origin
    valid = [trial.result for trial in batch.trials if counts(trial)]
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
        scaled=_scaled(experiment, total, origin),
        figures=tuple(figures),
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
    sum_of_speeds = sum(robot.speed for robot in experiment.robots)
    factor = scale.speed / sum_of_speeds if sum_of_speeds > 0 else math.nan
    ci95 = total.ci95
    published = experiment.reference
    return ScaledError(
        scale=scale,
        mean=total.mean * factor,
        ci95=Interval(ci95.low * factor, ci95.high * factor, reason=ci95.reason),
        published_mean=published.mean * factor if published else math.nan,
    )
