"""The trials of a batch that somebody should look at, and why."""

from dataclasses import dataclass

from tetractl.core.plan import Outcome
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.summary import Summary
from tetractl.stats.trials import counts


@dataclass(frozen=True, slots=True)
class Notable:
    """One log to look at; `outcome` is a word for people."""

    path: str
    outcome: str
    notes: tuple[str, ...]


def to_look_at(summary: Summary) -> list[Notable]:
    """Return the trials to look at, then the earlier attempts.

    A trial is to be looked at where it did not count, its log is damaged, a robot entered an
    obstacle, it ended at `steps max`, or in a lab its log holds warnings. In a simulation these
    tell of the spec's own disturbances.
    """
    found = []
    for trial in summary.trials:
        notes = _notes(trial)
        if notes:
            means = "in the means" if counts(trial) else "not in the means"
            found.append(Notable(trial.path, trial.outcome.value, (means, *notes)))
    for trial in summary.attempts:
        notes = ("an earlier attempt, not counted", *_notes(trial))
        found.append(Notable(trial.path, trial.outcome.value, notes))
    for log in summary.lost_attempts:
        notes = ("an earlier attempt, not counted", log.problem)
        found.append(Notable(log.path, "cannot be read", notes))
    return found


def _notes(trial: ResultSummary) -> list[str]:
    """Return what makes a trial notable, nothing where it is not."""
    notes = []
    if trial.result.entered_obstacle:
        names = (robot.name for robot in trial.experiment.robots)
        inside = [n for n, e in zip(names, trial.result.verdict.entered, strict=True) if e]
        notes.append(f"{', '.join(inside)} entered an obstacle")
    if trial.outcome is Outcome.STEPS_MAX:
        notes.append(f"not over after {trial.result.steps} steps")
    if trial.warnings and not trial.simulated:
        notes.append(f"{trial.warnings} warning{'s' * (trial.warnings > 1)}")
    if trial.recovered:
        notes.append("read from a damaged log")
    if not counts(trial):
        notes.append(trial.result.reason or "its errors are not known")
    return notes
