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
from tetractl.run.task import FinishedTrial, OtherCodeError, Task
from tetractl.spec.plant import PlantSection


@dataclass(frozen=True, slots=True)
class Ending:
    """How a trial of a batch ended, with an estimate of the remaining time.

    Attributes:
        task: The trial.
        result: Its result. None if the trial has no outcome.
        failure: Why the trial was aborted or has no result, in one line. None if it did not fail.
        remaining_s: Estimated time for the remaining trials [s]. None until a trial has been timed.
        has_time_of_each_arm: Whether a trial of each arm has been timed. The trials of some arms
            take far longer than the trials of others.
    """

    task: Task
    result: Result | None
    failure: str | None
    remaining_s: float | None
    has_time_of_each_arm: bool = True


class RunObserver(Protocol):
    """An object that is notified when trials start and end. Trials may end in any order.

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
        remaining: Number of trials that have neither a result nor an error.
    """

    results: dict[tuple[str, int], Result] = field(default_factory=dict)
    errors: dict[tuple[str, int], Exception] = field(default_factory=dict)
    remaining: int = 0

    @property
    def interrupted(self) -> bool:
        """Whether any trial was interrupted, by Ctrl-C or another signal."""
        return any(result.outcome is Outcome.INTERRUPTED for result in self.results.values())

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
                emulated lab that does not run in real time, because every trial there has its own
                lab, with the robots at their starts.
        """
        if keep_going is None:
            keep_going = plant.type == EMULATED_PLANT and not plant.real_time
        return cls.GO_ON_IF_CLEAR if keep_going else cls.END


class TrialTimes:
    """The wall times of the finished trials of a batch, and the number of remaining trials.

    Both are kept for each arm of a study, because the trials of some arms take longer.
    """

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._remaining = Counter(task.arm for task in tasks)
        self._timed_count = Counter[str]()
        self._spent_s = dict.fromkeys(self._remaining, 0.0)

    def record_end(self, arm: str, wall_s: float | None) -> None:
        """Record that a trial of an arm has ended.

        Args:
            arm: Name of the arm.
            wall_s: Wall time of the trial [s]. None if the trial has no result.
        """
        self._remaining[arm] -= 1
        if wall_s is not None:
            self._timed_count[arm] += 1
            self._spent_s[arm] += wall_s

    @property
    def has_each_arm(self) -> bool:
        """Whether the wall time of at least one trial of each arm is known."""
        return all(self._timed_count[arm] for arm in self._remaining)

    def remaining_s(self, workers: int) -> float | None:
        """Estimate how long the remaining trials take [s].

        The result is None before any trial was timed.

        Each trial is expected to take the mean time of its arm. If no trial of the arm has been
        timed, the mean time of all trials is used.

        Args:
            workers: Number of trials that run at the same time.
        """
        if not self._timed_count:
            return None
        mean_s = sum(self._spent_s.values()) / self._timed_count.total()
        left_s = 0.0
        for arm, remaining_count in self._remaining.items():
            arm_mean_s = (
                self._spent_s[arm] / self._timed_count[arm] if self._timed_count[arm] else mean_s
            )
            left_s += remaining_count * arm_mean_s
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
        executor: Runs the trials, one by one or several at a time.
        observer: Is notified when a trial starts and ends.
        on_failure: Whether a trial that is aborted or has no outcome ends the run.

    Raises:
        OtherCodeError: If the code on a worker differs from the code of this process.
    """
    report = Report(remaining=len(tasks))
    times = TrialTimes(tasks)

    def start_task(task: Task) -> Path:
        observer.trial_started(task)
        return store.prepare_folder(*task.key)

    with closing(executor.run(tasks, start_task)) as task_ends:
        for task, outcome in task_ends:
            result = failure = None
            report.remaining -= 1
            if isinstance(outcome, OtherCodeError):
                executor.end()
                raise outcome
            if isinstance(outcome, FinishedTrial):
                store.add_result(*task.key)
                report.results[task.key] = result = outcome.result
                if result.outcome is Outcome.ABORTED:
                    failure = f"aborted: {result.reason}"
            else:
                report.errors[task.key] = outcome
                failure = one_line_message(outcome)
            if failure is not None and on_failure.ends_run(result):
                executor.end()
            times.record_end(
                task.arm, outcome.wall_s if isinstance(outcome, FinishedTrial) else None
            )
            left_s = times.remaining_s(executor.workers)
            observer.trial_ended(Ending(task, result, failure, left_s, times.has_each_arm))
    return report


def one_line_message(error: Exception) -> str:
    """Return an error's message in one line. An unexpected error's class comes before it."""
    if isinstance(error, TetractlError):
        return " ".join(error.message.split())
    message_words = str(error).split()
    return f"{type(error).__name__}: {' '.join(message_words)}"
