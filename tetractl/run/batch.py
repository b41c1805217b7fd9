"""Runs the trials of a batch or a study, with any store, executor and observer."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from tetractl.core.errors import TetractlError
from tetractl.core.plan import Outcome
from tetractl.core.trial import Result
from tetractl.run.executors import Executor
from tetractl.run.store import Store
from tetractl.run.task import Finished, OtherCodeError, Task


@dataclass(frozen=True, slots=True)
class Ending:
    """How a trial ended, and the estimated time [s] of the remaining trials, from the mean time of
    those before.

    `result` is None if the trial has no outcome. `failure` is the reason, in one line, why it was
    aborted or has no result. `left_s` is None until a trial has been timed. `every_arm` is True if
    as many trials have been timed as there are arms: arms take turns, and trials of some take far
    longer than those of others.
    """

    task: Task
    result: Result | None
    failure: str | None
    left_s: float | None
    every_arm: bool = True


class RunObserver(Protocol):
    """An object that is notified when trials start and end; trials may end in any order."""

    def trial_started(self, task: Task) -> None:
        """Called when a trial starts."""
        ...

    def trial_ended(self, ending: Ending) -> None:
        """Called when a trial has ended."""
        ...


@dataclass(slots=True)
class Report:
    """The outcome of each trial, by arm and number: a result, or an error if there is none."""

    results: dict[tuple[str, int], Result] = field(default_factory=dict)
    errors: dict[tuple[str, int], Exception] = field(default_factory=dict)
    left: int = 0
    """Number of trials with neither result nor error."""

    @property
    def interrupted(self) -> bool:
        """Whether any trial was interrupted."""
        return any(r.outcome is Outcome.INTERRUPTED for r in self.results.values())

    @property
    def aborted(self) -> dict[tuple[str, int], Result]:
        """The results of aborted trials."""
        return {key: r for key, r in self.results.items() if r.outcome is Outcome.ABORTED}


def run_batch(
    tasks: Sequence[Task],
    store: Store,
    executor: Executor,
    observer: RunObserver,
    fail_fast: bool = False,
) -> Report:
    """Run trials and store their logs.

    With `fail_fast` the first trial that is aborted or has no outcome ends the run. Raises
    OtherCodeError if the code on a worker differs from that of this process.
    """
    report = Report(left=len(tasks))
    arms = len({task.arm for task in tasks})
    spent_s = 0.0
    timed = 0

    def ready(task: Task) -> Path:
        observer.trial_started(task)
        return store.place(*task.key)

    with closing(executor.run(tasks, ready)) as ended:
        for task, ended_by in ended:
            result = failure = None
            report.left -= 1
            if isinstance(ended_by, OtherCodeError):
                executor.end()
                raise ended_by
            if isinstance(ended_by, Finished):
                store.add(*task.key)
                report.results[task.key] = result = ended_by.result
                spent_s += ended_by.wall_s
                timed += 1
                if result.outcome is Outcome.ABORTED:
                    failure = f"aborted: {result.reason}"
            else:
                report.errors[task.key] = ended_by
                failure = _one_line(ended_by)
            if failure is not None and fail_fast:
                executor.end()
            left_s = spent_s / timed * report.left / executor.workers if timed else None
            observer.trial_ended(Ending(task, result, failure, left_s, timed >= arms))
    return report


def _one_line(error: Exception) -> str:
    """Return an error's message in one line, after the class of an unexpected error."""
    if isinstance(error, TetractlError):
        return " ".join(error.message.split())
    words = str(error).split()
    return f"{type(error).__name__}: {' '.join(words)}"
