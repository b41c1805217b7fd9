"""The trials of a batch that should be examined, each with the reason."""

from dataclasses import dataclass

from tetractl.core.plan import Outcome
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.open_batch import Batch, counts


@dataclass(frozen=True, slots=True)
class Flagged:
    """One log to read; `outcome` is the word for how its trial ended."""

    path: str
    outcome: str
    notes: tuple[str, ...]


def flagged(batch: Batch) -> list[Flagged]:
    """Return the flagged trials, then the earlier attempts.

    A trial is flagged if it does not count, its log is damaged, a robot entered an obstacle, it
    ended at `steps max`, or in a lab its log holds warnings. In a simulation warnings come from the
    disturbances that the spec asks for.
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
    notes = []
    if trial.result.entered_obstacle:
        names = (robot.name for robot in trial.experiment.robots)
        inside = [n for n, e in zip(names, trial.result.verdict.entered, strict=True) if e]
        notes.append(f"{', '.join(inside)} entered an obstacle")
    if gone := sum(trial.result.lost):
        notes.append(f"{gone} robot{'s' * (gone > 1)} lost")
    if trial.outcome is Outcome.STEPS_MAX:
        notes.append(f"not over after {trial.result.steps} steps")
    if trial.warnings and not trial.simulated:
        notes.append(f"{trial.warnings} warning{'s' * (trial.warnings > 1)}")
    if trial.recovered:
        notes.append("read from a damaged log")
    if not counts(trial):
        notes.append(trial.result.reason or "its errors are not known")
    return notes
