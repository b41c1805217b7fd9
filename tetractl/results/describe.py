"""Describes a batch of trials: its errors with intervals, and how the trials ended."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.experiment.experiment import Experiment, Reference, Scale
from tetractl.log.read.trial_log import Origin
from tetractl.results.estimate import Distribution, Interval, distributions
from tetractl.results.mean_difference import MeanDifference, welch
from tetractl.results.open_batch import Batch, counts, experiment_of
from tetractl.results.statistic import Value, statistics


@dataclass(frozen=True, slots=True)
class Published:
    """The published result, and the difference from it by Welch's t (measured minus published).

    `difference` is None if the two are not comparable, such as an undisturbed simulation and
    real robots.
    """

    reference: Reference
    difference: MeanDifference | None


@dataclass(frozen=True, slots=True)
class Scaled:
    """The mean error of one robot scaled to another kind of robot by the ratio of speeds.

    error = (total error / N) (scale.speed / mean speed of the N robots), in `scale.unit`; lengths
    are the same in body lengths. NaN if no robot moves. `published` scales the reference.
    """

    scale: Scale
    error: float
    ci95: Interval
    published: float

    def body_lengths(self, error: float) -> float:
        """Convert an error in `scale.unit` to body lengths."""
        return error / self.scale.body_length


@dataclass(frozen=True, slots=True)
class Group:
    """A batch of trials of N robots, described under a name; lengths in `unit`.

    `total` and `robots` describe the errors of the n trials that count: the complete ones, whose
    outcome the controller decided. `statistics` are the values of `results.kinds`, over all trials.
    `published` and `scaled` are None if the spec asks for none; `scaled` too for a simulation
    without disturbances and an emulated lab.
    """

    name: str
    batch: Batch
    experiment: Experiment
    origin: Origin
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
    def n_attempts(self) -> int:
        """Number of earlier attempts, readable or not."""
        return len(self.batch.attempts) + len(self.batch.lost_attempts)

    @property
    def items(self) -> dict[str, Any]:
        """The statistics by their keys in JSON, such as `arrived` and `solve_ms`."""
        return {key: item for value in self.statistics for key, item in value.items.items()}


def describe(batch: Batch, name: str = "") -> Group:
    """Describe the trials of one experiment.

    Raises UsageError if they belong to several, or if a simulated trial occurs twice.
    """
    experiment = experiment_of(batch)
    origin = batch.trials[0].origin
    counted = [trial.result for trial in batch.trials if counts(trial)]
    totals = np.array([result.total_error for result in counted], dtype=float)
    errors = np.array([result.robot_errors for result in counted], dtype=float)
    errors = errors.reshape(len(counted), len(experiment.robots))
    (total,) = distributions(totals[None], experiment.error_bound)
    return Group(
        name=name or experiment.name,
        batch=batch,
        experiment=experiment,
        origin=origin,
        totals=totals,
        errors=errors,
        total=total,
        robots=tuple(distributions(errors.T)),
        statistics=tuple(statistic.of_batch(batch.trials) for statistic in statistics()),
        published=_published(experiment, total, origin),
        scaled=_scaled(experiment, total) if origin.comparable else None,
    )


def _published(experiment: Experiment, total: Distribution, origin: Origin) -> Published | None:
    if (reference := experiment.reference) is None:
        return None
    if not origin.comparable:
        return Published(reference, None)
    known = reference.n, reference.mean, reference.std
    return Published(reference, welch(total.n, total.mean, total.std, *known))


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
