"""Describes a batch of trials: errors with intervals, outcomes, and logs to be examined."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tetractl.core.commands import STOOD
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats
from tetractl.experiment.experiment import Experiment, Reference, Scale
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.results.estimate import Distribution, Interval, distributions
from tetractl.results.mean_difference import MeanDifference, welch
from tetractl.results.open_batch import Batch, counts, experiment_of
from tetractl.results.outcomes import SAFETY
from tetractl.results.statistic import Value, statistics


@dataclass(frozen=True, slots=True)
class Published:
    """The published result, and the measured mean minus the published mean, tested by Welch's t
    test.

    `difference` is None if the two results cannot be compared, such as those of an undisturbed
    simulation and of real robots.
    """

    reference: Reference
    difference: MeanDifference | None


@dataclass(frozen=True, slots=True)
class Scaled:
    """The mean error of one robot scaled to another kind of robot by the ratio of speeds.

    `error` = (mean total error / N) (scale.speed / mean speed of the N robots), in `scale.unit`;
    NaN if every speed is 0. `published` is the published mean error, scaled by the same factor.
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
    """A batch of trials of N robots, with a name; lengths in `unit`.

    Only complete trials count, those whose outcome the controller decided. `totals` (n,) and
    `errors` (n, N) are the errors of the n trials that count; `total` and `robots` describe them.
    `statistics` are the values of all registered statistics, over all trials. `published` and
    `scaled` are None if the spec requests none; `scaled` is also None for a simulation without
    disturbances and for an emulated lab.
    """

    name: str
    batch: Batch
    experiment: Experiment = field(repr=False)
    origin: Origin
    totals: Floats = field(repr=False)  # (n,) total errors
    errors: Floats = field(repr=False)  # (n, N) errors of each robot
    total: Distribution
    robots: tuple[Distribution, ...] = field(repr=False)
    statistics: tuple[Value, ...] = field(repr=False)
    published: Published | None = field(repr=False)
    scaled: Scaled | None = field(repr=False)

    @property
    def unit(self) -> str:
        """The length unit of every error."""
        return self.experiment.units.length

    @property
    def counted(self) -> int:
        """Number of trials in the means."""
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

    Raises UsageError if they belong to several experiments, or if a simulated trial occurs twice.
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


@dataclass(frozen=True, slots=True)
class Flagged:
    """A log to be examined: its path, the outcome of its trial, and the reasons."""

    path: str
    outcome: str
    notes: tuple[str, ...]


def flagged(batch: Batch) -> list[Flagged]:
    """Return the flagged trials, then the earlier attempts.

    A trial is flagged if it is not in the means, its log is damaged, a robot entered an obstacle,
    left the arena, touched another one, was lost or stood though commanded to move, or the trial
    ended at `steps max`. Warnings flag trials in a lab only, since in a simulation the spec
    requests the disturbances.
    """
    found = []
    for trial in batch.trials:
        if notes := _notes(trial):
            means = "in the means" if counts(trial) else "not in the means"
            found.append(Flagged(trial.path, trial.outcome.value, (means, *notes)))
    for trial in batch.attempts:
        notes = ("an earlier attempt, not counted", *_notes(trial))
        found.append(Flagged(trial.path, trial.outcome.value, notes))
    for log in batch.lost_attempts:
        notes = ("an earlier attempt, not counted", log.problem)
        found.append(Flagged(log.path, "cannot be read", notes))
    return found


def _notes(trial: ResultSummary) -> list[str]:
    """Return the reasons to flag a trial."""
    names = [robot.name for robot in trial.experiment.robots]
    notes = [
        f"{', '.join(name for name, one in zip(names, found, strict=True) if one)} {what}"
        for what, of in SAFETY.items()
        if any(found := of(trial.result.verdict, trial.experiment.controller.body_radius))
    ]
    if gone := sum(trial.result.lost):
        notes.append(f"{gone} robot{'s' * (gone > 1)} lost")
    if trial.outcome is Outcome.STEPS_MAX:
        notes.append(f"did not end in {trial.result.steps} steps")
    if trial.warnings and not trial.simulated:
        notes.append(f"{trial.warnings} warning{'s' * (trial.warnings > 1)}")
    if trial.recovered:
        notes.append("read from a damaged log")
    if not counts(trial) or trial.result.reason.endswith(STOOD):
        notes.append(trial.result.reason or "its errors are unknown")
    return notes
