"""Selects the trials of a study that are run and the logs that are kept.

It also repeats a trial to compare it with its row in the table.
"""

import pickle
import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from tetractl.control.build import warm_up
from tetractl.core.errors import LogError, TetractlError, UsageError
from tetractl.core.table.table import Table
from tetractl.experiment.yaml.problems import did_you_mean
from tetractl.log.format.run_records import encode_result
from tetractl.log.provenance import host, processor
from tetractl.log.read.reader import content_digest, read_result
from tetractl.replay.comparison import first_difference
from tetractl.run.interrupt import interrupted_once
from tetractl.run.rows import Row
from tetractl.run.store import BatchFolder, Store, set_aside
from tetractl.run.task import Task, log_path, run_trial
from tetractl.study.load_study import Arm, LoadedStudy, spec_of


@dataclass(frozen=True, slots=True)
class Logs:
    """Which logs are kept: those of the first `each` trials of every arm, and of failed trials."""

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
        spec, batch = pickle.dumps(arm.spec), store.batches[arm.name]
        trials = [*batch.lacking, *(batch.outdated if rerun_outdated else ())]
        tasks += [
            Task(n, count, spec, arm.name, n < logs.each, logs.failed, True, arm.code)
            for n in sorted(trials)
        ]
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


def repeat(loaded: LoadedStudy, store: Store, which: str) -> str:
    """Run the trial `ARM/N` again and keep its log; return a line with the digest if it equals that
    of the trial's row.

    Raises UsageError if the study lacks the trial or its row, or already has its log. Raises
    LogError if the digests differ; the log is then set aside as an attempt.
    """
    arm, batch, row = _found(loaded, store, which)
    path = log_path(batch.folder, row.trial)
    if row.logged and path.exists():
        raise UsageError(
            f"{path}: the trial has a log already", f"check it with: tetractl verify {path}"
        )
    folder = store.place(arm.name, row.trial)
    with interrupted_once():
        result = run_trial(spec_of(arm, row.count), folder, row.trial)
    digest = content_digest(path)
    if digest != row.digest:
        text = _difference(path, row)
        set_aside(folder, row.trial)
        hint, here = None, processor(host())
        if row.processor != here:
            hint = f"the row was computed on another type of processor: {row.processor}, not {here}"
        if row.code != arm.code:
            hint = "the row was computed by outdated code"
        raise LogError(
            f"{which}: the digest of its log is {digest}, that of its row {row.digest}{text}",
            hint,
        )
    batch.add_row(replace(row, logged=True))
    return f"{path}: {result.summary}, with the digest of its row: {digest}"


def _difference(log: Path, row: Row) -> str:
    """Return the first difference between the results in the log and in the row, "" if none."""
    now = read_result(log)
    unit = now.experiment.units.length
    ours, stated = (encode_result(of.result, unit, of.warnings) for of in (now, row))
    found = first_difference(ours, stated, name="result")
    return "; {}: {}".format(*found) if found else ""


def _found(loaded: LoadedStudy, store: Store, which: str) -> tuple[Arm, BatchFolder, Row]:
    name, slash, number = which.rpartition("/")
    if not slash or not number.isdecimal():
        raise UsageError(f"--trial {which}: must be ARM/N, as in the columns arm and trial")
    arm = next((arm for arm in loaded.arms if arm.name == name), None)
    if arm is None:
        close = did_you_mean(name, [arm.name for arm in loaded.arms])
        raise UsageError(f"--trial {which}: the study has no arm '{name}'{close}")
    batch = store.batches[arm.name]
    row = batch.rows.get(int(number))
    if row is None:
        raise UsageError(f"--trial {which}: it has no row in {store.folder}", "run the study first")
    return arm, batch, row
