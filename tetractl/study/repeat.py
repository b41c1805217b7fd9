"""One trial of a study run again to its full log, and checked against its row."""

from dataclasses import replace
from pathlib import Path

from tetractl.core.errors import LogError, UsageError
from tetractl.experiment.yaml.problems import did_you_mean
from tetractl.log.format.metadata import result_metadata
from tetractl.log.format.trial_digest import trial_digest
from tetractl.log.provenance import host, processor
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.rows import Row
from tetractl.replay.difference import first_difference
from tetractl.run.interrupt import Interrupt, interrupted_once
from tetractl.run.store import set_aside
from tetractl.run.task import log_path, run_trial
from tetractl.study.arm import Arm
from tetractl.study.load_study import LoadedStudy, spec_of
from tetractl.study.row_store import Store


def repeat(loaded: LoadedStudy, store: Store, which: str) -> str:
    """Run the trial `ARM/N` again and keep its log; return in one line that the digests agree.

    Raises UsageError for a trial that the study does not have, has no row of, or has a log of, and
    LogError if the digests differ; the log is then set aside as an attempt.
    """
    arm, row = _found(loaded, store, which)
    path = log_path(store.arm_folder(arm), row.trial)
    if row.logged and path.exists():
        raise UsageError(f"{path}: has its log", f"check it with: tetractl verify {path}")
    folder = store.place(arm.name, row.trial)
    with interrupted_once():
        result = run_trial(spec_of(arm, row.count), folder, row.trial, (), Interrupt())
    digest = trial_digest(read_trial(path))
    if digest != row.trial_digest:
        text = _difference(path, row)
        set_aside(folder, row.trial)
        hint, here = None, processor(host())
        if row.processor != here:
            hint = f"the row is of another type of processor: {row.processor}, this one is {here}"
        if row.code != arm.code:
            hint = "the row is of outdated code"
        raise LogError(
            f"{which}: the digest of its log is {digest}, that of its row {row.trial_digest}{text}",
            hint,
        )
    store.add_row(arm, replace(row, logged=True))
    return f"{path}: {result.summary}, digest as in its row: {digest}"


def _difference(log: Path, row: Row) -> str:
    """Return the first difference between the results of log and row; "" if these agree."""
    now = read_result(log)
    unit = now.experiment.units.length
    ours, stated = (result_metadata(of.result, unit, of.warnings) for of in (now, row))
    found = first_difference(ours, stated, name="result")
    return "; {}: {}".format(*found) if found else ""


def _found(loaded: LoadedStudy, store: Store, which: str) -> tuple[Arm, Row]:
    name, slash, number = which.rpartition("/")
    if not slash or not number.isdecimal():
        raise UsageError(f"--trial {which}: must be ARM/N, as in the columns arm and trial")
    arm = next((arm for arm in loaded.arms if arm.name == name), None)
    if arm is None:
        close = did_you_mean(name, [arm.name for arm in loaded.arms])
        raise UsageError(f"--trial {which}: the study has no arm '{name}'{close}")
    row = store.rows[arm.name].get(int(number))
    if row is None:
        raise UsageError(f"--trial {which}: it has no row in {store.folder}", "run the study first")
    return arm, row
