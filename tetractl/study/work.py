"""One trial of a study, as a worker runs it: a row, and a log where one is asked for."""

import pickle
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from tetractl.control.build import warm_up
from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.plan import Outcome
from tetractl.experiment.load import LoadedSpec
from tetractl.log.read.origin import Origin
from tetractl.log.read.rows import SIMULATED
from tetractl.log.read.trial_log import ResultSummary
from tetractl.log.write.recorder import Recorder
from tetractl.log.write.writer import LogWriter
from tetractl.run.batch import log_path, run_with
from tetractl.run.interrupt import Interrupt
from tetractl.study.arm import code_of
from tetractl.study.row import Row


@dataclass(frozen=True, slots=True)
class Task:
    """One trial to run: `spec` is the arm's, pickled; a log is kept always, or if it fails."""

    arm: int  # index in the study
    trial: int
    arm_hash: str
    code: str  # that the worker must have
    spec: bytes
    log: bool
    log_if_failed: bool


class OtherCodeError(UsageError):
    """A worker whose trials would differ; no trial of the study can be run there."""


def run_task(task: Task, folder: Path, interrupt: Interrupt) -> Row | None:
    """Run a trial, its log in `folder` where one is kept; None where it was interrupted.

    Raises OtherCodeError where this process has other code than the task says, and whatever keeps
    the trial from its end and is no outcome of it, such as a full disk.
    A log for a failure is that of the trial run again: it repeats.
    """
    try:
        row = _run(task, folder, interrupt, task.log)
    except Exception:
        if task.log_if_failed and not task.log:
            _run(task, folder, interrupt, True)
        raise
    if row is None or row.complete or task.log or not task.log_if_failed:
        return row
    return _run(task, folder, interrupt, True)


def _run(task: Task, folder: Path, interrupt: Interrupt, log: bool) -> Row | None:
    spec = _ready(task.spec, task.code)
    path, weighed = log_path(folder, task.trial), Recorder()
    with ExitStack() as stack:
        writer = stack.enter_context(LogWriter(path)) if log else None
        began = time.perf_counter(), time.process_time()
        writers = [writer, weighed] if writer else [weighed]
        result = run_with(writers, spec, task.trial, (), interrupt)
    took_s = time.perf_counter() - began[0], time.process_time() - began[1]
    if writer and writer.failure:
        raise writer.failure
    if result.outcome is Outcome.INTERRUPTED:
        path.unlink(missing_ok=True)
        return None
    experiment = spec.experiment
    found = ResultSummary(
        path=str(path),
        experiment=experiment,
        seed=experiment.trials.seed,
        trial=task.trial,
        origin=Origin.of(experiment, SIMULATED),
        result=result,
        recovered=False,
        digest=None,
        warnings=weighed.warnings,
    )
    return Row.of(found, task.arm_hash, task.code, weighed.trial_digest, log, took_s)


@lru_cache(maxsize=64)
def _ready(spec: bytes, code: str) -> LoadedSpec:
    """Return an arm's spec, its controller compiled; by the same bytes the same object."""
    loaded: LoadedSpec = pickle.loads(spec)
    if code_of(loaded) != code:
        raise OtherCodeError(
            "the worker has other code than the machine that runs the study",
            "install the same tetractl, numpy, numba, llvmlite, scipy and packages there",
        )
    with suppress(TetractlError):  # the trial meets it again, and says so in its row
        warm_up(loaded.experiment, lambda text: None)
    return loaded
