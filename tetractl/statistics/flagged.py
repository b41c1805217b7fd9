"""Find the logs of a batch that a person should examine, with the reasons.

The reasons are trials that do not count, unsafe robots, lost robots, damaged logs, and robots that
turned differently than in the other trials.

The rest of this docstring explains the last reason. If a camera shows a robot turning off course
from the start of a trial, either its poses are wrong or its wheels differ, and no check of a single
trial can decide which. However, a robot has the same wheels in every trial. With its rate x_k and
standard error e_k in trial k of n (`lab.drift_check`), the median m of the rates and e of the
errors, trial k differs if

    |x_k - m| > z sqrt(e_k^2 + max(0, (1 + f / n)^2 s^2 - e^2)),   s = 1.4826 median |x_j - m|,

where s is a standard deviation of the rates that does not change if fewer than half of them are
wrong, and f is FEW_TRIALS. z is a quantile of the normal distribution, chosen such that in the
fraction FALSE_ALARM_FRACTION of batches, one of the N n rates of N robots is beyond it by chance.
With fewer trials, less is known of s. With FEW_TRIALS, normal rates exceed the limit in 1 % of
batches of ten trials or more, and in at most 3 % of smaller batches.

With fewer than COMPARED_TRIALS_MIN trials, there is nothing to compare. The heading of a robot then
counts as confirmed if its rate is 0 within CONFIRMED_ERRORS_MAX standard errors. Otherwise, either
its wheels differ from the spec, which a calibration corrects, or its pose is false. If a pose turns
with its course at the rate x, while the robot drives a distance L in a time T, the pose is off its
robot by at most

    integral of x t dL <= |x| T L / 2.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from statistics import NormalDist
from typing import Any

import numpy as np

from tetractl.core.losses import STOOD_STILL_ENDINGS
from tetractl.core.plan import Outcome
from tetractl.core.setup import MILLIMETRE_M
from tetractl.core.trial import Verdict
from tetractl.log.read.trial_log import ResultSummary
from tetractl.statistics.open_batch import Batch, errors_known, is_counted
from tetractl.tools.table.table import pluralize

ATTEMPT_NOTE = "an earlier attempt, excluded"

ENTERED_OBSTACLE = "entered an obstacle"
LEFT_ARENA = "left the arena"
TOUCHED_EACH_OTHER = "touched one another"
SAFETY: dict[str, Callable[[Verdict, float], list[bool]]] = {
    ENTERED_OBSTACLE: Verdict.in_obstacle,
    LEFT_ARENA: Verdict.over_edge,
    TOUCHED_EACH_OTHER: Verdict.touched,
}
"""Unsafe events by their labels, each with a function that finds the robots that did it.

The function takes the verdict of a trial and the radius of the robots.
"""
FALSE_ALARM_FRACTION = 0.01
"""Fraction of batches in which a rate is beyond its limit by chance."""
COMPARED_TRIALS_MIN = 6
"""Minimum number of trials with a known rate that are compared."""
FEW_TRIALS = 14.0
"""Number n of trials for which the factor 1 + f / n doubles the deviation s; see above."""
CONFIRMED_ERRORS_MAX = 2.0
"""Maximum number of standard errors of a rate that counts as 0, with too few trials to compare."""
DEVIATION_OVER_MEDIAN = 1.4826
"""Standard deviation of normal values over the median of their distances to the median."""


@dataclass(frozen=True, slots=True)
class Flagged:
    """A log that a person should examine: its path, the outcome of its trial, and the reasons."""

    log: str
    outcome: str
    notes: tuple[str, ...]


def flagged(batch: Batch) -> list[Flagged]:
    """List the logs of a batch that a person should examine, followed by the earlier attempts.

    A trial is flagged if one of these is true:

    - It is not valid, or its log is damaged.
    - A robot entered an obstacle, left the arena, touched another one, or was lost.
    - A robot stood still while others drove, turned differently than in the other trials, or has an
      unconfirmed heading.
    - The trial ended at `steps max` or `time limit`.
    - It has warnings and took place in a lab. In a simulation, the spec requests the disturbances.
    """
    logs: list[Flagged] = []
    turned = turning_remarks(batch.trials)
    unconfirmed = unconfirmed_heading_remarks(batch.trials)
    for trial in batch.trials:
        notes = [*trial_notes(trial), *turned.get(trial.log, ()), *unconfirmed.get(trial.log, ())]
        if notes and not is_counted(trial):
            notes.insert(0, "excluded")
        if notes:
            logs.append(Flagged(trial.log, trial.outcome.value, tuple(notes)))
    for trial in batch.attempts:
        notes = (ATTEMPT_NOTE, *trial_notes(trial))
        logs.append(Flagged(trial.log, trial.outcome.value, notes))
    unreadable = [
        Flagged(log.log, "cannot be read", (ATTEMPT_NOTE, log.problem))
        for log in batch.lost_attempts
    ]
    return [*logs, *unreadable]


def trial_notes(trial: ResultSummary) -> list[str]:
    """Return the reasons to flag a trial that follow from this trial alone.

    The result is empty if there are none.
    """
    result = trial.result
    notes = [f"{', '.join(robots)} {label}" for label, robots in unsafe_robots(trial).items()]
    lost_count = sum(result.lost)
    if lost_count:
        notes.append(f"{lost_count} {pluralize('robot', lost_count)} lost")
    if trial.outcome is Outcome.STEPS_MAX:
        notes.append(f"did not end in {result.steps} steps")
    if trial.outcome is Outcome.TIME_LIMIT:
        notes.append(f"did not end in {trial.experiment.controller.time_limit:g} s")
    if trial.warnings and not trial.simulated:
        notes.append(f"{trial.warnings} {pluralize('warning', trial.warnings)}")
    if trial.recovered:
        notes.append("read from a damaged log")
    if not errors_known(trial) or result.reason.endswith(STOOD_STILL_ENDINGS):
        notes.append(result.reason or "its errors are unknown")
    return notes


def unsafe_robots(trial: ResultSummary) -> dict[str, list[str]]:
    """Find the robots of a trial that did something unsafe, by the labels in SAFETY.

    Labels without such a robot are left out.
    """
    names = [robot.name for robot in trial.experiment.robots]
    radius = trial.experiment.controller.body_radius
    robots_by_label: dict[str, list[str]] = {}
    for label, find_unsafe in SAFETY.items():
        was_unsafe = find_unsafe(trial.result.verdict, radius)
        if any(was_unsafe):
            robots_by_label[label] = list(compress(names, was_unsafe))
    return robots_by_label


# ---- Robots that turned differently than in their other trials ----


@dataclass(frozen=True, slots=True)
class TrialTurn:
    """A robot's turning rate off course in one trial, compared with its other trials.

    Attributes:
        log: Path of the trial's log.
        robot: Name of the robot.
        difference_rad_s: The robot's turning rate off course in this trial, minus the median over
            its trials [rad/s].
        limit_rad_s: Maximum difference that chance explains [rad/s].
    """

    log: str
    robot: str
    difference_rad_s: float
    limit_rad_s: float

    @property
    def unusual(self) -> bool:
        """Whether the robot turned differently than in its other trials, beyond chance."""
        return abs(self.difference_rad_s) > self.limit_rad_s


def compare_turns(trials: Sequence[ResultSummary]) -> Iterator[TrialTurn]:
    """Compare each robot's turning rate in each trial with its other trials, robot by robot.

    A robot is left out if its rate is known in fewer than COMPARED_TRIALS_MIN trials.
    """
    for i, robot, compared in _trials_with_turn(trials):
        trial_count = len(compared)
        if trial_count < COMPARED_TRIALS_MIN:
            continue
        rates = np.array([trial.result.verdict.turn[i] for trial in compared])
        errors = np.array([trial.result.verdict.turn_std[i] for trial in compared])
        deviations = rates - np.median(rates)
        rate_std = (
            (1 + FEW_TRIALS / trial_count) * DEVIATION_OVER_MEDIAN * np.median(np.abs(deviations))
        )
        unexplained_variance = max(0.0, rate_std**2 - np.median(errors) ** 2)  # by the errors
        n_robots = len(trials[0].experiment.setup.names)
        chance_of_one_side = FALSE_ALARM_FRACTION / (2 * n_robots * trial_count)
        quantile = NormalDist().inv_cdf(1 - chance_of_one_side)
        limits = quantile * np.sqrt(errors**2 + unexplained_variance)
        for trial, deviation, limit in zip(
            compared, deviations.tolist(), limits.tolist(), strict=True
        ):
            yield TrialTurn(trial.log, robot, deviation, limit)


def _trials_with_turn(
    trials: Sequence[ResultSummary],
) -> Iterator[tuple[int, str, list[ResultSummary]]]:
    """Yield the index and name of each robot, and the trials in which its turning rate is known.

    All robots are yielded, even if their list of trials is empty.
    """
    measured = [trial for trial in trials if trial.result.verdict.turn]
    for i, robot in enumerate(trials[0].experiment.setup.names if trials else ()):
        trials_with_rate = [
            trial for trial in measured if math.isfinite(trial.result.verdict.turn_std[i])
        ]
        yield i, robot, trials_with_rate


def unconfirmed_heading_remarks(trials: Sequence[ResultSummary]) -> dict[str, list[str]]:
    """Describe the robots whose own motion does not confirm their heading, by the log's path.

    Robots with COMPARED_TRIALS_MIN trials or more are compared by `turning_remarks` instead.
    """
    remarks = defaultdict[str, list[str]](list)
    for i, robot, measured_trials in _trials_with_turn(trials):
        if len(measured_trials) >= COMPARED_TRIALS_MIN:
            continue
        for trial in measured_trials:
            result = trial.result
            rate = result.verdict.turn[i]
            if abs(rate) <= CONFIRMED_ERRORS_MAX * result.verdict.turn_std[i]:
                continue
            setup = trial.experiment.setup
            distance_mm = float(setup.speed[i]) * result.duration_s * setup.metres / MILLIMETRE_M
            off_mm = abs(rate) * result.duration_s * distance_mm / 2
            observation = f"{robot} turned by {rate:+.2f} rad/s without a command"
            consequence = (
                f"if its two wheels are the same, its position is wrong by up to {off_mm:.0f} mm"
            )
            remarks[trial.log].append(
                f"the measured heading of {robot} may be wrong: {observation}; {consequence}"
            )
    return remarks


def turning_remarks(trials: Sequence[ResultSummary]) -> dict[str, list[str]]:
    """Describe the robots that turned differently than in their other trials, as {log: texts}.

    Logs without such a robot are left out.
    """
    remarks = defaultdict[str, list[str]](list)
    for turn in compare_turns(trials):
        if turn.unusual:
            remark = (
                f"{turn.robot} turned at a rate that differs by {turn.difference_rad_s:+.2f} rad/s "
                "from its other trials"
            )
            remarks[turn.log].append(remark)
    return remarks


def turn_columns(trial: ResultSummary) -> dict[str, Any]:
    """Return the rate at which each robot turned off course [rad/s], and its standard error.

    Each robot has two columns, whose values are None if they are unknown. There is no column if the
    trial was simulated or if the robots have no wheels.
    """
    if trial.simulated or not trial.experiment.setup.on_wheels:
        return {}
    names = trial.experiment.setup.names
    verdict = trial.result.verdict
    unknown = (math.inf,) * len(names)
    rates = verdict.turn or unknown
    errors = verdict.turn_std or unknown
    items = dict[str, Any]()
    for name, rate, error in zip(names, rates, errors, strict=True):
        is_measured = math.isfinite(error)
        items[f"turn_{name}_rad_s"] = rate if is_measured else None
        items[f"turn_std_{name}_rad_s"] = error if is_measured else None
    return items
