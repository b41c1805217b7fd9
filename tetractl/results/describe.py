"""Describes a batch of trials: errors with intervals, outcomes, and logs to be examined."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats
from tetractl.core.table.table import NONE, digits, lengths
from tetractl.core.tour import STOOD
from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.results.estimate import Distribution, Interval, distributions
from tetractl.results.mean_difference import MeanDifference, welch
from tetractl.results.open_batch import Batch, counts, directions_given, experiment_of
from tetractl.results.outcomes import SAFETY
from tetractl.results.statistic import Value, statistics
from tetractl.results.turning import turned_otherwise

PUBLISHED = "difference from published"
"""Label of the difference from the published result."""


@dataclass(frozen=True, slots=True)
class BatchStatistics:
    """A batch of trials of N robots, with a name; lengths in `unit`.

    `totals` (n,) and `errors` (n, N) are the errors of the n valid trials, those whose outcome the
    controller decided and whose errors are known; `total` and `robots` describe them.
    `values` are the batch's other figures: plant, tail, the published and the scaled error, all
    registered statistics, over all trials, and the logs that are missing.
    """

    name: str
    batch: Batch
    experiment: Experiment = field(repr=False)
    origin: Origin
    totals: Floats = field(repr=False)  # (n,) total errors
    errors: Floats = field(repr=False)  # (n, N) errors of each robot
    total: Distribution
    robots: tuple[Distribution, ...] = field(repr=False)
    values: tuple[Value, ...] = field(repr=False)

    @property
    def unit(self) -> str:
        """The length unit of every error."""
        return self.experiment.units.length

    @property
    def counted(self) -> int:
        """Number of trials in the means."""
        return self.total.n

    @property
    def rows(self) -> dict[str, str]:
        """The figures by their labels in tables."""
        return {label: text for value in self.values for label, text in value.rows}

    @property
    def items(self) -> dict[str, Any]:
        """The figures by their keys in JSON, such as `arrived` and `solve_ms`."""
        return {key: item for value in self.values for key, item in value.items.items()}

    @property
    def record(self) -> dict[str, Any]:
        """The object that `stats --format json` prints for a batch: errors, figures and trials.

        Lengths are in `unit`, times in the unit with which their key ends; unknown values are NaN.
        """
        batch, names = self.batch, self.experiment.setup.names
        return {
            "experiment": self.experiment.name,
            "unit": self.unit,
            "total_error": self.total.as_dict(),
            "robots": [
                {"name": name, **errors.as_dict()}
                for name, errors in zip(names, self.robots, strict=True)
            ],
            **self.items,
            "trials": [trial_items(trial) for trial in batch.trials],
            "attempts": [
                *(trial_items(trial) | {"counted": False} for trial in batch.attempts),
                *batch.lost_attempts,
            ],
            "flagged": flagged(batch),
        }


def trial_items(trial: ResultSummary) -> dict[str, Any]:
    """Return the result of a trial by its keys in JSON."""
    result = trial.result
    return {
        "log": trial.log,
        "trial": trial.trial,
        "seed": trial.seed,
        "total_error": result.total_error,
        "robot_errors": list(result.robot_errors),
        "steps": result.steps,
        "duration_s": result.duration_s,
        "origin": trial.origin.value,
        "outcome": result.outcome.value,
        "reason": result.reason,
        "warnings": trial.warnings,
        "processor": trial.processor,
        **{key: item for one in statistics() for key, item in one.of_trial(trial).items()},
        "counted": counts(trial),
    }


def describe(batch: Batch, name: str = "") -> BatchStatistics:
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
    attempts = len(batch.attempts) + len(batch.lost_attempts)
    return BatchStatistics(
        name=name or experiment.name,
        batch=batch,
        experiment=experiment,
        origin=origin,
        totals=totals,
        errors=errors,
        total=total,
        robots=tuple(distributions(errors.T)),
        values=(
            *_overview(batch, experiment, total, origin),
            _published(experiment, total, origin),
            _scaled(experiment, total, origin),
            *(statistic.of_batch(batch.trials) for statistic in statistics()),
            Value.row(
                "earlier attempts, excluded", str(attempts), not attempts, n_attempts=attempts
            ),
            Value.row(
                "logs that cannot be read", str(len(batch.lost)), not batch.lost, damaged=batch.lost
            ),
        ),
    )


def _overview(
    batch: Batch, experiment: Experiment, total: Distribution, origin: Origin
) -> tuple[Value, ...]:
    """Return the plant, how many trials are valid, and the tail of their errors."""
    assumed = [("disturbances", "assumed in the spec, not measured")]
    tail = total.tail
    plant = {
        "origin": origin.value,
        "kind": "simulated" if origin.simulated else origin.name.lower(),
        "disturbed": origin is not Origin.UNDISTURBED,
        "body_radius": experiment.controller.body_radius or None,
    }
    tiny = total.max * 1e6 < max(experiment.arena.width, experiment.arena.height)
    n = {"n_trials": len(batch.trials), "n_counted": total.n}
    given = Value.row("given directions", "no controller decided; not ranked with controllers")
    return (
        Value.row("plant", str(origin), True, **plant),
        *([given] if directions_given(experiment) else []),
        Value({}, tuple(assumed if origin is Origin.DISTURBED else []), brief=""),
        Value.row("valid trials", f"{total.n} of {len(batch.trials)}", True, **n),
        Value.row(tail.label, tail.text(experiment.units.length), not tail.above or tiny),
    )


def _published(experiment: Experiment, total: Distribution, origin: Origin) -> Value:
    """Return the published result, and the measured mean minus the published mean, tested by
    Welch's t test; `comparable` is false for an undisturbed simulation and an emulated lab.
    """
    if (known := experiment.reference) is None:
        return Value({"reference": None}, ())
    unit = experiment.units.length
    stated = {"source": known.source, "n": known.n, "mean": known.mean, "std": known.std}
    if origin.comparable:
        found = welch(total.n, total.mean, total.std, known.n, known.mean, known.std)
        text = f"{found.text(unit, lengths(found.value), found.p_value)} (Welch's t)"
    else:
        found = MeanDifference.untested(math.nan, "not compared")
        text = f"{NONE} (not real robots)"
    stated |= {"comparable": origin.comparable, **found.as_dict()}
    return Value.row(PUBLISHED, text, True, reference=stated)


def _scaled(experiment: Experiment, total: Distribution, origin: Origin) -> Value:
    """Return the mean error of one robot scaled to another kind of robot by the ratio of speeds:
    (mean total error / N) (scale.speed / mean speed of the N robots), in `scale.unit`, and the
    published mean error scaled by the same factor; NaN if every speed is 0.
    """
    if (scale := experiment.scale) is None or not origin.comparable:
        return Value({"scaled": None}, ())
    speeds = sum(robot.speed for robot in experiment.robots)
    factor = scale.speed / speeds if speeds > 0 else math.nan  # the number of robots cancels
    error = total.mean * factor
    ci95 = Interval(total.ci95.low * factor, total.ci95.high * factor, reason=total.ci95.reason)
    published = experiment.reference.mean * factor if experiment.reference else math.nan
    bodies, published_bodies = error / scale.body_length, published / scale.body_length
    show = lengths(error)
    rows = [
        (f"robot error scaled to {scale.name} [{scale.unit}]", show(error)),
        (f"  its 95 % interval [{scale.unit}]", ci95.text(show)),
        ("  in body lengths", digits(bodies)),
    ]
    if math.isfinite(published):
        text = f"{lengths(published)(published)} ({digits(published_bodies)} body lengths)"
        rows.append((f"  published error scaled [{scale.unit}]", text))
    found = {
        "name": scale.name,
        "unit": scale.unit,
        "mean": error,
        "ci95": ci95.ends,
        "body_lengths": bodies,
        "published_mean": published,
        "published_body_lengths": published_bodies,
    }
    return Value({"scaled": found}, tuple(rows), usual=True)


@dataclass(frozen=True, slots=True)
class Flagged:
    """A log to be examined: its path, the outcome of its trial, and the reasons."""

    log: str
    outcome: str
    notes: tuple[str, ...]


def flagged(batch: Batch) -> list[Flagged]:
    """Return the flagged trials, then the earlier attempts.

    A trial is flagged if it is not valid, its log is damaged, a robot entered an obstacle,
    left the arena, touched another one, was lost, stood while others drove or turned
    otherwise than in the other trials, or the trial ended at `steps max` or `time limit`. Warnings
    flag trials in a lab only, since in a simulation the spec requests the disturbances.
    """
    found, turned = [], turned_otherwise(batch.trials)
    for trial in batch.trials:
        if notes := [*_notes(trial), *turned.get(trial.log, ())]:
            why = () if counts(trial) else ("excluded",)
            found.append(Flagged(trial.log, trial.outcome.value, (*why, *notes)))
    for trial in batch.attempts:
        notes = ("an earlier attempt, excluded", *_notes(trial))
        found.append(Flagged(trial.log, trial.outcome.value, notes))
    for log in batch.lost_attempts:
        notes = ("an earlier attempt, excluded", log.problem)
        found.append(Flagged(log.log, "cannot be read", notes))
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
    if trial.outcome is Outcome.TIME_LIMIT:
        notes.append(f"did not end in {trial.experiment.controller.time_limit:g} s")
    if trial.warnings and not trial.simulated:
        notes.append(f"{trial.warnings} warning{'s' * (trial.warnings > 1)}")
    if trial.recovered:
        notes.append("read from a damaged log")
    if not counts(trial) or trial.result.reason.endswith(STOOD):
        notes.append(trial.result.reason or "its errors are unknown")
    return notes
