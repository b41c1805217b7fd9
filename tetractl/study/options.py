"""Which trials of a study are run, and which logs they leave."""

import pickle
import re
from dataclasses import dataclass
from typing import Self

from tetractl.core.errors import UsageError
from tetractl.run.task import Task
from tetractl.study.load_study import LoadedStudy
from tetractl.study.row_store import Store


@dataclass(frozen=True, slots=True)
class Logs:
    """The trials whose logs are kept: the first `each` of every arm, and those that fail."""

    each: float
    failed: bool

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the rule for `all`, `failed`, `sample:N` or `none`; UsageError for another."""
        if text == "all":
            return cls(float("inf"), True)
        if found := re.fullmatch(r"sample:([1-9]\d{0,6})", text):
            return cls(int(found[1]), False)
        if text in ("failed", "none"):
            return cls(0, text == "failed")
        raise UsageError(f"--logs {text}: must be all, failed, sample:N or none")


@dataclass(frozen=True, slots=True)
class Shard:
    """One of `of` shares of the trials, of about equal size; `index` counts from 1."""

    index: int = 1
    of: int = 1

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the share for `i/n`; UsageError for another text."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise UsageError(f"--shard {text}: must be i/n with i from 1 to n, such as 2/8")
        return cls(int(found[1]), int(found[2]))

    def has(self, number: int) -> bool:
        """Whether the trial of a number, counted over all arms from 0, is in this share."""
        return number % self.of == self.index - 1


def lacking(
    loaded: LoadedStudy, store: Store, logs: Logs, shard: Shard, rerun_outdated: bool
) -> tuple[list[Task], dict[str, int]]:
    """Return the trials without a row, and how many rows of outdated code are kept, by arm.

    With `rerun_outdated` the trials of outdated code are returned too. The order is trial by trial
    over all arms, so that after an early end all arms have as many.
    """
    count = loaded.study.trials.count
    tasks: list[Task] = []
    kept: dict[str, int] = {}
    for i, arm in enumerate(loaded.arms):
        spec = pickle.dumps(arm.spec)
        for trial in range(count):
            if not shard.has(i * count + trial):
                continue
            row = store.rows[arm.name].get(trial)
            outdated = row is not None and row.code != arm.code
            if row is None or (outdated and rerun_outdated):
                keep = trial < logs.each
                tasks.append(Task(trial, count, spec, arm.name, keep, logs.failed, True, arm.code))
            elif outdated:
                kept[arm.name] = kept.get(arm.name, 0) + 1
    return sorted(tasks, key=lambda task: task.trial), kept
