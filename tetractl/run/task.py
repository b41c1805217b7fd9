"""Runs one trial, with its log and result.

    run_task              runs a task of an executor: one trial, with the kind of log that it asks
      _prepared           loads its spec, and compiles what it needs, once in a process
      _run_whole          with a whole log: every frame and control step, while the trial runs
      _run_brief          with a brief one: the result alone, after the trial
        run_observed      builds clock, plant and controller, and runs the trial
          Trial.run       is the control loop (`tetractl.run.run_trial`)
    run_trial             runs one trial of a spec that is loaded, with a whole log

In real time, a background thread calls the observers, so that a slow screen never delays the loop;
the writers of logs are called in the loop's thread. In simulation, all are.
"""

import gc
import pickle
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from pathlib import Path
from pkgutil import resolve_name

import numpy as np

from tetractl.control.build import warm_up
from tetractl.core.clock import Clock
from tetractl.core.commands import PlantInfo
from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.plan import Outcome
from tetractl.core.plugin_fault import plugins_blamed
from tetractl.core.protocols import LabSupervision, Observer, Plant
from tetractl.core.trial import EPOCH_NS, Result
from tetractl.core.worker import Relay, Worker
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import LoadedSpec, start_of
from tetractl.experiment.prepared import Prepare
from tetractl.experiment.registry_fields import packages
from tetractl.log.provenance import trial_code
from tetractl.log.write.brief import BriefLog
from tetractl.log.write.writer import LogWriter
from tetractl.run.checked_controller import build_controller
from tetractl.run.interrupt import Interrupt
from tetractl.run.model_news import stated_delay
from tetractl.run.run_trial import Trial, abandon

QUEUED_CALLS_MAX = 2000
"""Largest number of queued calls of an observer: over two minutes of a trial."""
LAST_CALLS_S = 30.0
"""Time for the last calls of an observer after the robots were stopped [s]."""
SPECS_KEPT = 64
"""Number of specs that a process keeps loaded and compiled, the latest ones."""


class ObserverRelay(Relay):
    """A relay for an observer that may be slow."""

    def __init__(self, observer: Observer) -> None:
        self.observer = observer
        self.worker = Worker(
            "observer",
            size=QUEUED_CALLS_MAX,
            wait_s=0.0,
            patience_s=LAST_CALLS_S,
            too_slow=TetractlError("an observer is too slow for the trial"),
        )


class LogKind(Enum):
    """Which log a task is to leave."""

    WHOLE = "whole"
    BRIEF = "brief"
    WHOLE_IF_FAILED = "whole if failed"
    """Brief; but a trial that fails is run again, to write its whole log. Only for simulations,
    whose trials repeat to the bit."""


@dataclass(frozen=True, slots=True)
class Task:
    """Trial number `trial` of `count`, counted from 0; in a study, of the arm named `arm`.

    `spec` is the pickled LoadedSpec. `code` is the hash, by `code_of`, of the code with which the
    trial must be run, "" for any code.
    """

    trial: int
    count: int
    spec: bytes
    arm: str = ""
    log: LogKind = LogKind.WHOLE
    code: str = ""

    @property
    def key(self) -> tuple[str, int]:
        """Arm and trial number, which identify the task in a run."""
        return self.arm, self.trial


@dataclass(frozen=True, slots=True)
class Finished:
    """The result of a trial, and its wall time."""

    result: Result
    wall_s: float
    """Time from the building of the plant to the end of the log [s]."""


class OtherCodeError(UsageError):
    """A worker's code differs from that of the study's machine, so trials could differ."""


def batch_tasks(spec: LoadedSpec, trials: Sequence[int]) -> list[Task]:
    """Return the tasks of a batch: trials of one spec, all with whole logs."""
    pickled = pickle.dumps(spec)
    return [Task(trial, spec.experiment.trials.count, pickled) for trial in trials]


def code_of(experiment: Experiment) -> str:
    """Return the hash of the code that runs the trials of an experiment on this machine."""
    versions = packages(experiment)
    return trial_code(tuple(sorted(versions.items())))


def trial_seeds(root: int, trial: int) -> tuple[int, np.random.SeedSequence]:
    """Return the key of the controller's random numbers and the seed of the plant's disturbances.

    They come from children of SeedSequence(root) with the spawn keys (trial, 0) and (trial, 1), so
    they do not depend on the number or order of the trials.
    """
    controller = np.random.SeedSequence(root, spawn_key=(trial, 0))
    plant = np.random.SeedSequence(root, spawn_key=(trial, 1))
    return int(controller.generate_state(1, np.uint64)[0]), plant


def log_path(folder: Path, trial: int) -> Path:
    """Return the path of a trial's log in the folder of a batch or of an arm."""
    return folder / f"trial-{trial:03d}.mcap"


def run_task(
    task: Task,
    folder: Path,
    interrupt: Interrupt,
    observers: Sequence[Observer] = (),
    supervision: LabSupervision | None = None,
) -> Finished:
    """Run a trial and write its log to `folder`; an interrupted trial has no brief log.

    Raises OtherCodeError if the code of this process is not the task's, and any error that leaves
    the trial without an outcome, such as a camera that does not answer.
    """
    match task.log:
        case LogKind.WHOLE:
            return _run_whole(task, folder, interrupt, observers, supervision)
        case LogKind.BRIEF:
            return _run_brief(task, folder, interrupt, observers)
        case LogKind.WHOLE_IF_FAILED:
            finished = _run_unless_failed(task, folder, interrupt)
            if finished is not None:
                return finished
            log_path(folder, task.trial).unlink(missing_ok=True)  # the brief log
            return _run_whole(task, folder, interrupt, observers, supervision)


def _run_unless_failed(task: Task, folder: Path, interrupt: Interrupt) -> Finished | None:
    """Run a trial with a brief log, which no observer watches; return None if it failed."""
    try:
        finished = _run_brief(task, folder, interrupt)
    except Exception:  # the trial that is run again raises the same error
        return None
    return None if finished.result.outcome is Outcome.ABORTED else finished


def _run_whole(
    task: Task,
    folder: Path,
    interrupt: Interrupt,
    observers: Sequence[Observer],
    supervision: LabSupervision | None,
) -> Finished:
    """Run a trial and write its whole log meanwhile."""
    spec = _prepared(task.spec, task.code)
    began_s = time.perf_counter()
    with _log_writer(spec, folder, task.trial) as log:
        result = run_observed([log], spec, task.trial, observers, interrupt, supervision)
    return Finished(result, time.perf_counter() - began_s)


def _run_brief(
    task: Task, folder: Path, interrupt: Interrupt, observers: Sequence[Observer] = ()
) -> Finished:
    """Run a trial, and write its brief log afterwards unless it was interrupted."""
    spec = _prepared(task.spec, task.code)
    began_s = time.perf_counter()
    brief = BriefLog()
    result = run_observed([brief], spec, task.trial, observers, interrupt)
    if result.outcome is not Outcome.INTERRUPTED:
        brief.save(log_path(folder, task.trial))
    return Finished(result, time.perf_counter() - began_s)


@lru_cache(maxsize=SPECS_KEPT)
def _prepared(spec: bytes, code: str) -> LoadedSpec:
    """Load a task's spec and compile what its trials need; return the spec.

    This is done once in a process for each spec: later calls with the same bytes return the same.
    """
    loaded: LoadedSpec = pickle.loads(spec)
    if code and code_of(loaded.experiment) != code:
        raise OtherCodeError(
            "the worker's code differs from the code of the machine that runs the study",
            "install the same tetractl, numpy, numba, llvmlite, scipy and plug-ins on the worker",
        )
    with suppress(TetractlError):  # the trial raises the same error
        warm_up(loaded.experiment, lambda text: None)
    gc.freeze()  # exempts loaded objects from garbage collection, which would delay control steps
    return loaded


def run_trial(
    spec: LoadedSpec,
    folder: Path,
    trial: int = 0,
    observers: Sequence[Observer] = (),
    interrupt: Interrupt | None = None,
) -> Result:
    """Run one trial and write its whole log."""
    with _log_writer(spec, folder, trial) as log:
        return run_observed([log], spec, trial, observers, interrupt or Interrupt())


def _log_writer(spec: LoadedSpec, folder: Path, trial: int) -> LogWriter:
    """Return the writer of a trial's whole log."""
    return LogWriter(log_path(folder, trial), real_time=spec.experiment.plant.real_time)


def run_observed(
    writers: Sequence[Observer],
    spec: LoadedSpec,
    trial: int,
    observers: Sequence[Observer],
    interrupt: Interrupt,
    supervision: LabSupervision | None = None,
) -> Result:
    """Run one trial. The `writers` of logs are called in the control loop's thread; in real time,
    background threads call the `observers`, so that they do not delay the loop."""
    section = spec.experiment.plant
    clock = section.clock()
    start_unix_ns = _unix_ns() if section.real_time else EPOCH_NS
    key, seed = trial_seeds(spec.experiment.trials.seed, trial)
    supervision = supervision or _own_supervision(writers, interrupt)
    with plugins_blamed(packages(spec.experiment)), ExitStack() as stack:
        if section.real_time:
            relays = [ObserverRelay(observer) for observer in observers]
            observers = [stack.enter_context(closing(relay)) for relay in relays]
        spec, plant = _spec_and_plant(spec, clock, seed, supervision)
        try:
            controller = build_controller(spec.experiment, key)
        except BaseException:
            abandon(plant)  # to choose cells it was opened, and its field turns
            raise
        # the trial asks the plant about itself once it is open
        not_open = PlantInfo("", section.simulated, camera_rate_hz=0.0, facts={})
        return Trial(
            start=start_of(spec, trial, not_open, start_unix_ns),
            plant=plant,
            controller=controller,
            first_plan=spec.experiment.controller.first_plan,
            clock=clock,
            observers=[*writers, *observers],
            interrupt=interrupt,
            delay=stated_delay(spec.experiment),
        ).run()


def _own_supervision(writers: Sequence[Observer], interrupt: Interrupt) -> LabSupervision:
    """Return the supervision of a lab by the process that runs the trial."""

    def fail_log(error: OSError) -> None:
        for writer in writers:
            if isinstance(writer, LogWriter):
                writer.fail(error)

    return LabSupervision(
        cancelled=lambda: interrupt.requested, signalled=interrupt.request, fail_log=fail_log
    )


def _spec_and_plant(
    spec: LoadedSpec, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
) -> tuple[LoadedSpec, Plant]:
    """Return the spec, completed with the robots that the plant has found, and the plant."""
    experiment = spec.experiment
    rule = experiment.chosen  # how robots are chosen from more, None if the spec names them
    if rule is None or rule.are_found:
        return spec, experiment.plant.build(experiment.setup, clock, seed, supervision)
    prepare: Prepare = resolve_name(rule.prepare)
    prepared = prepare(experiment, clock, seed, supervision)
    return replace(spec, experiment=prepared.experiment), prepared.plant


def _unix_ns() -> int:
    """Return the Unix time [ns]; TetractlError before 1970, which logs cannot hold."""
    now_ns = time.time_ns()
    if now_ns < 0:
        raise TetractlError(
            "this computer's clock is before 1970", "set the computer's date, then run again"
        )
    return now_ns
