"""Says which trials of a study are still to be run, and which of them leave a whole log."""

import math
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
from tetractl.run.store import Store
from tetractl.run.task import LogKind, Task
from tetractl.study.load_study import LoadedStudy
from tetractl.tools.table.table import Table

SAMPLE = re.compile(r"sample:([1-9]\d{0,6})")
"""The rule `sample:N`."""


@dataclass(frozen=True, slots=True)
class Logs:
    """Which logs are whole: those of the first `whole_trials` trials of every arm and, if
    `failed`, those of failed trials. The others are brief."""

    whole_trials: float
    failed: bool

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the rule for `all`, `failed`, `sample:N` or `none`; UsageError otherwise."""
        if text == "all":
            return cls(whole_trials=math.inf, failed=True)
        if text == "failed":
            return cls(whole_trials=0, failed=True)
        if text == "none":
            return cls(whole_trials=0, failed=False)
        sample = SAMPLE.fullmatch(text)
        if sample is None:
            raise UsageError(f"--logs {text}: must be all, failed, sample:N or none")
        return cls(whole_trials=int(sample[1]), failed=False)

    def kind(self, trial: int) -> LogKind:
        """Return which log a trial is to leave."""
        if trial < self.whole_trials:
            return LogKind.WHOLE
        return LogKind.WHOLE_IF_FAILED if self.failed else LogKind.BRIEF


def lacking(
    loaded: LoadedStudy, store: Store, logs: Logs, rerun_outdated: bool
) -> tuple[list[Task], dict[str, int]]:
    """Return the tasks of trials that are not finished and, by arm, the number of outdated trials
    that are kept as they are.

    A trial is outdated if another version of the code has run it; with `rerun_outdated`, the tasks
    of such trials are returned too. Tasks are ordered by trial number, so that all arms have about
    equally many trials if the run ends early.
    """
    count = loaded.study.trials.count
    tasks: list[Task] = []
    outdated: dict[str, int] = {}
    for arm in loaded.arms:
        spec = pickle.dumps(arm.spec)
        batch = store.batches[arm.name]
        numbers = list(batch.lacking)
        if rerun_outdated:
            numbers += batch.outdated
        elif batch.outdated:
            outdated[arm.name] = len(batch.outdated)
        tasks += [
            Task(number, count, spec, arm.name, logs.kind(number), arm.code)
            for number in sorted(numbers)
        ]
    return sorted(tasks, key=lambda task: task.trial), outdated


def warm_up_arms(loaded: LoadedStudy, announce: Callable[[str], None]) -> None:
    """Compile what the arms need; a failure is reported with its trial."""
    for arm in {arm.controller: arm for arm in loaded.arms}.values():
        with suppress(TetractlError):
            warm_up(arm.spec.experiment, announce)


def dry_run(loaded: LoadedStudy, folder: Path, tasks: Sequence[Task]) -> Table:
    """Return a table of the arms: their differences from the base, and how many trials to run."""
    to_run = Counter(task.arm for task in tasks)
    rows = [(arm.name, ", ".join(arm.sets), str(to_run[arm.name])) for arm in loaded.arms]
    count = len(loaded.arms) * loaded.study.trials.count
    title = f"{loaded.study.name} as it would be run, {len(tasks)} of {count} trials into {folder}"
    return Table.of_texts(title, ("arm", "differs from the base in", "trials to run"), rows)
