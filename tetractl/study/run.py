"""Runs the trials that a study lacks, whatever becomes of each of them."""

import pickle
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Protocol

from tetractl.core.errors import TetractlError
from tetractl.study.arm import Arm
from tetractl.study.load import LoadedStudy
from tetractl.study.local import Ended
from tetractl.study.options import Logs, Shard
from tetractl.study.row import Row
from tetractl.study.store import Store
from tetractl.study.work import OtherCodeError, Task

FIRST = 3  # trials that the expected duration is computed from


class Executor(Protocol):
    """What runs tasks: `local.Local` or `cluster.Cluster`."""

    @property
    def workers(self) -> int:
        """The number of trials that run at a time."""
        ...

    def run(self, tasks: Sequence[Task]) -> Generator[Ended]:
        """Yield the tasks in the order in which they end."""
        ...

    def end(self) -> None:
        """Start no further trial, and let those that run end early."""
        ...


class StudyObserver(Protocol):
    """Watches a study."""

    def expected(self, seconds: float, trials: int) -> None:
        """Tell how long the study still takes, as far as the first `trials` show."""
        ...

    def ended(self, left_s: float | None) -> None:
        """A trial has ended; `left_s` is the time that the others take [s]."""
        ...

    def failed(self, arm: str, trial: int, why: str) -> None:
        """A trial has failed."""
        ...


@dataclass(slots=True)
class Report:
    """What became of the trials to run: those with a row, those without any outcome, the rest."""

    done: int = 0
    failed: int = 0
    left: int = 0


@dataclass(frozen=True, slots=True)
class Plan:
    """The trials to run, trial by trial over all arms; `older` counts the rows of older code that
    are kept."""

    tasks: Sequence[Task]
    older: dict[str, int] = field(default_factory=dict)  # by the name of the arm


def planned(loaded: LoadedStudy, store: Store, logs: Logs, shard: Shard, again: bool) -> Plan:
    """Return the trials that have no row, and with `again` those of older code too."""
    count = loaded.study.trials.count
    specs = [pickle.dumps(arm.spec) for arm in loaded.arms]
    tasks: list[Task] = []
    kept: dict[str, int] = {}
    for i, arm in enumerate(loaded.arms):
        rows = store.rows[arm.name]
        for trial in range(count):
            if not shard.has(i * count + trial):
                continue
            row = rows.get(trial)
            older = row is not None and (row.code != arm.code or not row.result)
            if row is None or (older and again):
                keep = trial < logs.each
                tasks.append(Task(i, trial, arm.hash, arm.code, specs[i], keep, logs.failed))
            elif older:
                kept[arm.name] = kept.get(arm.name, 0) + 1
    tasks.sort(key=lambda task: task.trial)  # stable: an early end leaves all arms with as many
    return Plan(tasks, kept)


def run_study(
    arms: Sequence[Arm],
    store: Store,
    executor: Executor,
    tasks: Sequence[Task],
    fail_fast: bool,
    observer: StudyObserver,
) -> Report:
    """Run tasks and store their rows; a failed trial ends the study only with `fail_fast`.

    A trial that aborts has a row, which says so. One that could not be run to any outcome has none
    and is run again the next time. Raises OtherCodeError of a worker.
    """
    report = Report()
    took_s: list[float] = []
    told = False
    with closing(executor.run(tasks)) as ended:
        for task, found in ended:
            arm, why = arms[task.arm], None
            if isinstance(found, OtherCodeError):
                executor.end()
                raise found
            if isinstance(found, Row):
                store.add(arm, found)
                took_s.append(found.times["wall_s"])
                report.done += 1
                if not found.complete:
                    why = f"aborted: {found.columns['reason']}"
            elif found is not None:
                why = _told(found)
            else:
                continue
            left = len(tasks) - report.done - report.failed
            left_s = sum(took_s) / len(took_s) * left / executor.workers if took_s else None
            if why is not None:
                report.failed += not isinstance(found, Row)
                observer.failed(arm.name, task.trial, why)
                if fail_fast:
                    executor.end()
            if not told and len(took_s) >= FIRST and left_s is not None and left > 0:
                told = True
                observer.expected(left_s, len(took_s))
            observer.ended(left_s)
    report.left = len(tasks) - report.done - report.failed
    return report


def _told(error: Exception) -> str:
    """Return in one line why a trial could not be run; what is no user's error is named too."""
    text = " ".join(str(error).split())
    return text if isinstance(error, TetractlError) else f"{type(error).__name__}: {text}"
