"""Which logs of a batch should be examined, and why: trials that do not count, unsafe robots, lost
robots, damage, and robots that turned otherwise than in the other trials.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import compress

from tetractl.core.losses import STOOD
from tetractl.core.plan import Outcome
from tetractl.core.trial import Verdict
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.open_batch import Batch, counts, errors_known
from tetractl.results.turning import turned_otherwise
from tetractl.tools.table.table import plural

ATTEMPT = "an earlier attempt, excluded"

ENTERED = "entered an obstacle"
LEFT = "left the arena"
TOUCHED_EACH_OTHER = "touched one another"
SAFETY: dict[str, Callable[[Verdict, float], list[bool]]] = {
    ENTERED: Verdict.in_obstacle,
    LEFT: Verdict.over_edge,
    TOUCHED_EACH_OTHER: Verdict.touched,
}
"""What must not happen, with a function that returns which robots of a given radius did it."""


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
    logs: list[Flagged] = []
    turned = turned_otherwise(batch.trials)
    for trial in batch.trials:
        notes = [*trial_notes(trial), *turned.get(trial.log, ())]
        if notes and not counts(trial):
            notes.insert(0, "excluded")
        if notes:
            logs.append(Flagged(trial.log, trial.outcome.value, tuple(notes)))
    for trial in batch.attempts:
        notes = (ATTEMPT, *trial_notes(trial))
        logs.append(Flagged(trial.log, trial.outcome.value, notes))
    lost = [
        Flagged(log.log, "cannot be read", (ATTEMPT, log.problem)) for log in batch.lost_attempts
    ]
    return [*logs, *lost]


def trial_notes(trial: ResultSummary) -> list[str]:
    """Return the reasons to flag a trial, without regard to the other ones."""
    result = trial.result
    notes = [f"{', '.join(robots)} {label}" for label, robots in unsafe(trial).items()]
    lost = sum(result.lost)
    if lost:
        notes.append(f"{lost} {plural('robot', lost)} lost")
    if trial.outcome is Outcome.STEPS_MAX:
        notes.append(f"did not end in {result.steps} steps")
    if trial.outcome is Outcome.TIME_LIMIT:
        notes.append(f"did not end in {trial.experiment.controller.time_limit:g} s")
    if trial.warnings and not trial.simulated:
        notes.append(f"{trial.warnings} {plural('warning', trial.warnings)}")
    if trial.recovered:
        notes.append("read from a damaged log")
    if not errors_known(trial) or result.reason.endswith(STOOD):
        notes.append(result.reason or "its errors are unknown")
    return notes


def unsafe(trial: ResultSummary) -> dict[str, list[str]]:
    """Return which robots of a trial did what must not happen, by its label in SAFETY."""
    names = [robot.name for robot in trial.experiment.robots]
    radius = trial.experiment.controller.body_radius
    robots_by_label: dict[str, list[str]] = {}
    for label, robots_that_did in SAFETY.items():
        did = robots_that_did(trial.result.verdict, radius)
        if any(did):
            robots_by_label[label] = list(compress(names, did))
    return robots_by_label
