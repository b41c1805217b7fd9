"""Runs the trials of a batch or a study, with any store, executor and observer."""

from collections import Counter
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
    """How a trial ended, and the estimated time [s] of the remaining trials.

    `result` is None if the trial has no outcome. `failure` is the reason, in one line, why it was
    aborted or has no result. `every_arm` is True if at least one trial has been timed in each arm
    that has trials left.
    """

    task: Task
    result: Result | None
    failure: str | None
    left_s: float | None
    every_arm: bool = True


class TimeLeft:
    """Estimates the time of the remaining trials from the mean time of previous trials, separately
    for each arm.

    Trials of some arms end after ten steps, of others at the last step. The time for compiling is
    not counted.
    """

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._left = Counter(task.arm for task in tasks)
        self._spent: dict[str, tuple[float, int]] = {}  # time [s] and number of trials
        self._known_s = 0.0  # estimated time of the trials left in arms whose time is known
        self._unknown = len(tasks)  # number of trials left in the other arms

    @property
    def known(self) -> bool:
        """Whether at least one trial has been timed in each arm that has trials left."""
        return self._unknown == 0

    def count(self, arm: str, wall_s: float | None) -> None:
        """Add a trial that has ended after `wall_s` [s], None if its time is unknown."""
        self._add(arm, -1)
        self._left[arm] -= 1
        if wall_s is not None:
            spent_s, n = self._spent.get(arm, (0.0, 0))
            self._spent[arm] = spent_s + wall_s, n + 1
        self._add(arm, 1)

    def _add(self, arm: str, sign: int) -> None:
        """Add or subtract the trials left in an arm."""
        spent_s, n = self._spent.get(arm, (0.0, 0))
        if n:
            self._known_s += sign * spent_s / n * self._left[arm]
        else:
            self._unknown += sign * self._left[arm]

    def of(self, workers: int) -> float | None:
        """Return the remaining time [s] with `workers` parallel trials; None until a trial has been
        timed."""
        if not self._spent:
            return None
        mean_s = 0.0
        if self._unknown:
            spent_s, n = map(sum, zip(*self._spent.values(), strict=True))
            mean_s = spent_s / n
        return max(self._known_s + self._unknown * mean_s, 0.0) / workers


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
    """Run trials and store their logs and records.

    With `fail_fast` the first trial that is aborted or has no outcome ends the run. Raises
    OtherCodeError if the code on a worker differs from that of this process.
    """
    report, time_left = Report(left=len(tasks)), TimeLeft(tasks)

    def ready(task: Task) -> Path:
        observer.trial_started(task)
        return store.place(*task.key)

    with closing(executor.run(tasks, ready)) as ended:
        for task, found in ended:
            result = failure = None
            report.left -= 1
            if isinstance(found, OtherCodeError):
                executor.end()
                raise found
            if isinstance(found, Finished):
                store.add(task, found)
                report.results[task.key] = result = found.result
                if result.outcome is Outcome.ABORTED:
                    failure = f"aborted: {result.reason}"
            else:
                report.errors[task.key] = found
                failure = _one_line(found)
            if failure is not None and fail_fast:
                executor.end()
            time_left.count(task.arm, found.wall_s if isinstance(found, Finished) else None)
            left_s = time_left.of(executor.workers)
            observer.trial_ended(Ending(task, result, failure, left_s, time_left.known))
    return report


def _one_line(error: Exception) -> str:
    """Return an error's message in one line, after the class of an unexpected error."""
    if isinstance(error, TetractlError):
        return " ".join(error.message.split())
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
