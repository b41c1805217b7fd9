"""Run the trials of a batch or a study, one by one, in several processes or on a cluster."""

from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Protocol

from tetractl.core.errors import TetractlError
from tetractl.core.plan import Outcome
from tetractl.core.trial import EMULATED_PLANT, Result
from tetractl.run.executors import Executor
from tetractl.run.store import Store
from tetractl.run.task import Finished, OtherCodeError, Task
from tetractl.spec.plant import PlantSection


@dataclass(frozen=True, slots=True)
class Ending:
    """How a trial of a batch ended, with an estimate of the remaining time.

    Attributes:
        task: The trial.
        result: Its result. None if the trial has no outcome.
        failure: Why the trial was aborted or has no result, in one line. None if it did not fail.
        left_s: Estimated time for the remaining trials [s]. None until a trial has been timed.
        every_arm: Whether a trial of each arm has been timed. The trials of some arms take far
            longer than those of others.
    """

    task: Task
    result: Result | None
    failure: str | None
    left_s: float | None
    every_arm: bool = True


class RunObserver(Protocol):
    """An object that is notified when trials start and end; trials may end in any order.

    A method that a subclass does not define does nothing.
    """

    def trial_started(self, task: Task) -> None:
        """Called when a trial starts."""

    def trial_ended(self, ending: Ending) -> None:
        """Called when a trial has ended, also if it has failed."""


@dataclass(slots=True)
class Report:
    """The results of a finished batch of trials.

    The trials may belong to several specs, which are called the *arms* of a study.

    Attributes:
        results: The result of each trial that has one, by the name of its arm and its index.
        errors: The errors of the other trials that were run, by the same keys.
        left: Number of trials that have neither a result nor an error.
    """

    results: dict[tuple[str, int], Result] = field(default_factory=dict)
    errors: dict[tuple[str, int], Exception] = field(default_factory=dict)
    left: int = 0

    @property
    def interrupted(self) -> bool:
        """Whether any trial was interrupted, by Ctrl-C or another signal."""
        return any(r.outcome is Outcome.INTERRUPTED for r in self.results.values())

    @property
    def aborted(self) -> dict[tuple[str, int], Result]:
        """The results of the trials that were aborted because of a fault."""
        return {key: r for key, r in self.results.items() if r.outcome is Outcome.ABORTED}


class OnFailure(Enum):
    """What a batch does after a trial has failed: the trial was aborted, or has no outcome."""

    GO_ON = "run all other trials"
    GO_ON_IF_CLEAR = "run them after an abort, unless somebody has to touch a robot or a device"
    END = "run no other trial"

    def ends_run(self, result: Result | None) -> bool:
        """Decide whether a failed trial ends the whole run.

        Args:
            result: The result of the trial, which is aborted. None if the trial has no outcome.
        """
        if self is OnFailure.GO_ON_IF_CLEAR:
            return result is None or not result.verdict.can_restart
        return self is OnFailure.END

    @classmethod
    def of_batch(cls, plant: PlantSection, keep_going: bool | None = None) -> "OnFailure":
        """Choose GO_ON_IF_CLEAR if the batch continues after an abort, otherwise END.

        Args:
            plant: The section of the plant.
            keep_going: Whether the batch continues after an abort. By default, it continues in an
                emulated lab that does not run in real time, where every trial has its own lab,
                with the
                robots at their starts.
        """
        if keep_going is None:
            keep_going = plant.type == EMULATED_PLANT and not plant.real_time
        return cls.GO_ON_IF_CLEAR if keep_going else cls.END


class TrialTimes:
    """The wall times of the finished trials of a batch, and the number of remaining trials.

    Both are kept for each arm of a study, because the trials of some arms take longer.
    """

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._left = Counter(task.arm for task in tasks)
        self._timed = Counter[str]()
        self._spent_s = dict.fromkeys(self._left, 0.0)

    def note_end(self, arm: str, wall_s: float | None) -> None:
        """Count the end of a trial of an arm.

        `wall_s` is its wall time [s], None without a result.
        """
        self._left[arm] -= 1
        if wall_s is not None:
            self._timed[arm] += 1
            self._spent_s[arm] += wall_s

    @property
    def of_every_arm(self) -> bool:
        """Whether the duration of at least one trial of each arm is known."""
        return all(self._timed[arm] for arm in self._left)

    def left_s(self, workers: int) -> float | None:
        """Estimate how long the remaining trials take [s].

        The result is None before any trial was timed.

        Each trial is expected to take the mean time of its arm. If no trial of the arm has been
        timed, the mean time of all trials is used.

        Args:
            workers: Number of trials that run at the same time.
        """
        if not self._timed:
            return None
        mean_s = sum(self._spent_s.values()) / self._timed.total()
        left_s = 0.0
        for arm, count in self._left.items():
            of_arm_s = self._spent_s[arm] / self._timed[arm] if self._timed[arm] else mean_s
            left_s += count * of_arm_s
        return left_s / workers


def run_batch(
    tasks: Sequence[Task],
    store: Store,
    executor: Executor,
    observer: RunObserver,
    on_failure: OnFailure = OnFailure.GO_ON,
) -> Report:
    """Run the trials of one spec, and store their logs in a folder.

    Args:
        tasks: The trials to run.
        store: The folder of their logs.
        executor: What runs the trials, one by one or several at a time.
        observer: It is notified when a trial starts and ends.
        on_failure: Whether a trial that is aborted or has no outcome ends the run.

    Raises:
        OtherCodeError: If the code on a worker differs from the code of this process.
    """
    report = Report(left=len(tasks))
    times = TrialTimes(tasks)

    def start_task(task: Task) -> Path:
        observer.trial_started(task)
        return store.place(*task.key)

    with closing(executor.run(tasks, start_task)) as ended:
        for task, ended_by in ended:
            result = failure = None
            report.left -= 1
            if isinstance(ended_by, OtherCodeError):
                executor.end()
                raise ended_by
            if isinstance(ended_by, Finished):
                store.add(*task.key)
                report.results[task.key] = result = ended_by.result
                if result.outcome is Outcome.ABORTED:
                    failure = f"aborted: {result.reason}"
            else:
                report.errors[task.key] = ended_by
                failure = _one_line(ended_by)
            if failure is not None and on_failure.ends_run(result):
                executor.end()
            times.note_end(task.arm, ended_by.wall_s if isinstance(ended_by, Finished) else None)
            left_s = times.left_s(executor.workers)
            observer.trial_ended(Ending(task, result, failure, left_s, times.of_every_arm))
    return report


def _one_line(error: Exception) -> str:
    """Return an error's message in one line, after the class of an unexpected error."""
    if isinstance(error, TetractlError):
        return " ".join(error.message.split())
    words = str(error).split()
    return f"{type(error).__name__}: {' '.join(words)}"
