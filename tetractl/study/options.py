"""Selects the trials of a study that are run and the logs that are whole."""

import pickle
import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from tetractl.control.build import warm_up
from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.table.table import Table
from tetractl.run.store import Store
from tetractl.run.task import LogKind, Task
from tetractl.study.load_study import LoadedStudy


@dataclass(frozen=True, slots=True)
class Logs:
    """Which logs are whole: those of the first `each` trials of every arm, and of failed trials.
    The others are brief."""

    each: float
    failed: bool

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the rule for `all`, `failed`, `sample:N` or `none`; UsageError otherwise."""
        if text == "all":
            return cls(float("inf"), True)
        if found := re.fullmatch(r"sample:([1-9]\d{0,6})", text):
            return cls(int(found[1]), False)
        if text in ("failed", "none"):
            return cls(0, text == "failed")
        raise UsageError(f"--logs {text}: must be all, failed, sample:N or none")

    def kind(self, trial: int) -> LogKind:
        """Return which log a trial is to leave."""
        if trial < self.each:
            return LogKind.WHOLE
        return LogKind.WHOLE_IF_FAILED if self.failed else LogKind.BRIEF


def lacking(
    loaded: LoadedStudy, store: Store, logs: Logs, rerun_outdated: bool
) -> tuple[list[Task], dict[str, int]]:
    """Return the tasks of trials that are not finished and, by arm, the number of outdated trials
    kept.

    A trial is outdated if another version of the code has run it; with `rerun_outdated`, the tasks
    of such trials are returned too. Tasks are ordered by trial number, so that all arms have about
    equally many trials if the run ends early.
    """
    count = loaded.study.trials.count
    tasks: list[Task] = []
    kept: dict[str, int] = {}
    for arm in loaded.arms:
        spec = pickle.dumps(arm.spec)
        batch = store.batches[arm.name]
        trials = [*batch.lacking, *(batch.outdated if rerun_outdated else ())]
        tasks += [Task(n, count, spec, arm.name, logs.kind(n), arm.code) for n in sorted(trials)]
        if batch.outdated and not rerun_outdated:
            kept[arm.name] = len(batch.outdated)
    return sorted(tasks, key=lambda task: task.trial), kept


def warm_up_arms(loaded: LoadedStudy, announce: Callable[[str], None]) -> None:
    """Compile what the arms need; a failure is reported with its trial."""
    for arm in {arm.controller: arm for arm in loaded.arms}.values():
        with suppress(TetractlError):
            warm_up(arm.spec.experiment, announce)


def dry_run(loaded: LoadedStudy, folder: Path, tasks: Sequence[Task]) -> Table:
    """Return a table of the arms: their differences from the base, and how many trials to run."""
    left = Counter(task.arm for task in tasks)
    rows = [(arm.name, ", ".join(arm.sets), str(left[arm.name])) for arm in loaded.arms]
    count = len(loaded.arms) * loaded.study.trials.count
    title = f"{loaded.study.name} as it would be run, {len(tasks)} of {count} trials into {folder}"
    return Table.of_texts(title, ("arm", "differs from the base in", "trials to run"), rows)
