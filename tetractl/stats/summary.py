"""The statistics of a batch of trials."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.experiment.experiment import Experiment, Reference, Scale
from tetractl.log.read.origin import Origin
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.damaged import Damaged
from tetractl.stats.difference import MeanDifference, welch
from tetractl.stats.estimate import Distribution, Interval, describe
from tetractl.stats.kinds import statistics
from tetractl.stats.statistic import Value
from tetractl.stats.trials import counts, one_batch, split_attempts


@dataclass(frozen=True, slots=True)
class Published:
    """The published result, and ours minus it by Welch's t; None where that is no comparison, as
    of an undisturbed simulation with real robots."""

    reference: Reference
    comparison: MeanDifference | None


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
    `attempts` are logs of the same trials that did not count, `damaged` logs that cannot be read;
    `lost_attempts` are those of them that were set aside. `published` and `scaled` are None where
    the spec asks for none; `scaled` too where robots cannot be concluded on.
    """

    experiment: Experiment
    origin: Origin
    trials: tuple[ResultSummary, ...]
    attempts: tuple[ResultSummary, ...]
    damaged: tuple[Damaged, ...]
    lost_attempts: tuple[Damaged, ...]
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
        return len(self.attempts) + len(self.lost_attempts)

    @property
    def items(self) -> dict[str, Any]:
        """The statistics by their keys in JSON, such as `arrived` and `solve_ms`."""
        return {key: item for value in self.statistics for key, item in value.items.items()}

    @property
    def whole(self) -> bool:
        """Whether no log was damaged."""
        return not self.damaged and not any(trial.recovered for trial in self.trials)


def summarise(trials: Sequence[ResultSummary], damaged: Sequence[Damaged] = ()) -> Summary:
    """Summarise the trials of one experiment; attempts among them are told apart.

    Raises UsageError where they belong to several, or where a simulated trial occurs twice.
    """
    trials, attempts = split_attempts(trials)
    experiment = one_batch(trials, attempts)
    origin = trials[0].origin
    counted = [trial.result for trial in trials if counts(trial)]
    robots = len(experiment.robots)
    totals = np.array([result.total_error for result in counted], dtype=float)
    errors = np.array([result.robot_errors for result in counted], dtype=float)
    errors = errors.reshape(len(counted), robots)
    total, *each = describe(np.vstack([totals, errors.T]))
    return Summary(
        experiment=experiment,
        origin=origin,
        trials=tuple(trials),
        attempts=tuple(attempts),
        damaged=tuple(log for log in damaged if not log.set_aside),
        lost_attempts=tuple(log for log in damaged if log.set_aside),
        totals=totals,
        errors=errors,
        total=total,
        robots=tuple(each),
        statistics=tuple(statistic.of_batch(trials) for statistic in statistics()),
        published=_published(experiment, total, origin),
        scaled=_scaled(experiment, total) if origin.comparable else None,
    )


def _published(experiment: Experiment, total: Distribution, origin: Origin) -> Published | None:
    if (reference := experiment.reference) is None:
        return None
    if not origin.comparable:
        return Published(reference, None)
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
