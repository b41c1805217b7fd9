"""A batch: many trials of one experiment, each in its own log, over one or more processes."""

import gc
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Protocol

from tetractl.control.build import build_controller
from tetractl.core.clock import Clock
from tetractl.core.commands import PlantInfo
from tetractl.core.errors import AbortError, TetractlError
from tetractl.core.operators import Operators
from tetractl.core.plan import Outcome
from tetractl.core.protocols import Observer
from tetractl.core.trial import EPOCH_NS, Result
from tetractl.experiment.load import LoadedSpec, start_of
from tetractl.log.write.writer import LogWriter
from tetractl.run.interrupt import SIGNALS, Interrupt
from tetractl.run.relay import Relay
from tetractl.run.seeds import trial_seeds
from tetractl.run.trial import Trial

TELL_AGAIN_S = 1.0


class Watcher(Protocol):
    """Is told of the trials of a batch; `index` counts from 0, trials may end in any order."""

    def trial_started(self, index: int, n: int) -> None:
        """Trial `index` of `n` starts."""
        ...

    def trial_finished(self, index: int, result: Result) -> None:
        """Trial `index` has ended."""
        ...


@dataclass(slots=True)
class Report:
    """What came of a batch: results by trial, and the trials that were never run."""

    results: dict[int, Result] = field(default_factory=dict)
    not_run: list[int] = field(default_factory=list)
    asked_to_stop: bool = False
    refused: TetractlError | None = None  # why a plant would not start a trial

    @property
    def interrupted(self) -> bool:
        """Whether somebody stopped the batch, in a trial or between two."""
        in_trial = any(r.outcome is Outcome.INTERRUPTED for r in self.results.values())
        return in_trial or (self.asked_to_stop and bool(self.not_run))

    @property
    def aborted(self) -> dict[int, Result]:
        """The trials that a fault ended."""
        return {i: r for i, r in self.results.items() if r.outcome is Outcome.ABORTED}


def log_path(folder: Path, trial: int) -> Path:
    """Return where the log of a trial goes."""
    return folder / f"trial-{trial:03d}.mcap"


def run_lab_trial(
    spec: LoadedSpec,
    folder: Path,
    trial: int,
    observers: Sequence[Observer],
    interrupt: Interrupt,
    operators: Operators,
) -> Result:
    """Run one trial in real time and write its log; no observer can hold it up."""
    clock, start_ns = spec.experiment.plant.clock(), time.time_ns()
    with ExitStack() as stack:
        log = stack.enter_context(LogWriter(log_path(folder, trial), real_time=True))
        relays = [log, *(stack.enter_context(Relay(observer)) for observer in observers)]
        return _made(spec, trial, clock, start_ns, relays, interrupt, operators).run()


def run_trial(
    spec: LoadedSpec, folder: Path, trial: int, observers: Sequence[Observer], interrupt: Interrupt
) -> Result:
    """Run one trial in virtual time and write its log."""
    with LogWriter(log_path(folder, trial)) as writer:
        watching = (writer, *observers)
        clock = spec.experiment.plant.clock()
        return _made(spec, trial, clock, EPOCH_NS, watching, interrupt).run()


def _made(
    spec: LoadedSpec,
    trial: int,
    clock: Clock,
    start_unix_ns: int,
    observers: Sequence[Observer],
    interrupt: Interrupt,
    operators: Operators | None = None,
) -> Trial:
    """Make a trial from its spec and its number; `operators` are for the lab."""
    experiment = spec.experiment
    key, seed = trial_seeds(experiment.trials.seed, trial)
    return Trial(
        start=start_of(
            spec, trial, PlantInfo("", experiment.plant.simulated, 0.0, {}), start_unix_ns
        ),
        plant=experiment.plant.build(experiment.setup, clock, seed, operators or Operators()),
        controller=build_controller(experiment, key),
        first_plan=experiment.controller.first_plan,
        clock=clock,
        observers=observers,
        interrupt=interrupt,
    )


def run_lab_batch(
    spec: LoadedSpec,
    folder: Path,
    trials: Sequence[int],
    interrupt: Interrupt,
    watcher: Watcher,
    observers: Sequence[Observer],
    operators: Callable[[int], AbstractContextManager[Operators]],
) -> Report:
    """Run trials in the lab, one after another, in this process.

    `operators` gives, for each trial, the people and files at it. A lab that refuses to start a
    trial ends the batch, as does an interruption or an aborted trial.
    """
    report = Report()
    gc.collect()
    gc.freeze()  # so that no collection of all that was imported ever holds the inner loop up
    for trial in trials:
        if interrupt.requested or report.aborted:
            break
        watcher.trial_started(trial, spec.experiment.trials.count)
        try:
            with operators(trial) as mine:
                result = run_lab_trial(spec, folder, trial, observers, interrupt, mine)
        except TetractlError as error:
            report.refused = error
            break
        report.results[trial] = result
        watcher.trial_finished(trial, result)
    report.not_run = [trial for trial in trials if trial not in report.results]
    report.asked_to_stop = interrupt.requested
    return report


def run_batch(
    spec: LoadedSpec,
    folder: Path,
    trials: Sequence[int],
    jobs: int,
    interrupt: Interrupt,
    watcher: Watcher,
    observers: Sequence[Observer] = (),
) -> Report:
    """Run trials, `jobs` at a time; an interruption or an aborted trial ends the batch.

    `observers` watch every trial, which only works in this process: jobs must be 1 to have any.
    """
    report = Report()
    if min(jobs, len(trials)) <= 1:
        for trial in trials:
            if interrupt.requested or report.aborted:
                break
            watcher.trial_started(trial, spec.experiment.trials.count)
            result = run_trial(spec, folder, trial, observers, interrupt)
            report.results[trial] = result
            watcher.trial_finished(trial, result)
    else:
        _run_processes(spec, folder, trials, jobs, interrupt, watcher, report)
    report.not_run = [trial for trial in trials if trial not in report.results]
    report.asked_to_stop = interrupt.requested
    return report


def _run_processes(
    spec: LoadedSpec,
    folder: Path,
    trials: Sequence[int],
    jobs: int,
    interrupt: Interrupt,
    watcher: Watcher,
    report: Report,
) -> None:
    context = multiprocessing.get_context("spawn")  # a fork would copy threads half-way
    ending = context.Event()
    waiting = list(reversed(trials))
    running: dict[Future[Result], int] = {}
    count = min(jobs, len(trials))
    again = 0.0  # when workers may be told once more to stop at once
    with ProcessPoolExecutor(count, context, _start_worker, (ending,)) as pool:
        while running or (waiting and not ending.is_set()):
            while waiting and len(running) < count and not ending.is_set():
                trial = waiting.pop()
                watcher.trial_started(trial, spec.experiment.trials.count)
                with _signals_held_back():  # a worker starts inside submit
                    running[pool.submit(_work, spec, folder, trial)] = trial
            done, _ = wait(running, timeout=0.1, return_when=FIRST_COMPLETED)
            for future in done:
                trial = running.pop(future)
                try:
                    report.results[trial] = result = future.result()
                except BrokenProcessPool:
                    raise AbortError(
                        "the process of a trial was killed, perhaps for want of memory",
                        f"with fewer --jobs, go on by --out {folder} --resume",
                    ) from None
                watcher.trial_finished(trial, result)
            if interrupt.requested or report.aborted:
                ending.set()
            if interrupt.count > 1 and time.monotonic() >= again:
                for process in multiprocessing.active_children():
                    if process.pid:
                        os.kill(process.pid, signal.SIGTERM)
                # once is not always enough: an exception raised in a finaliser is lost
                again = time.monotonic() + TELL_AGAIN_S


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """Let a process that is started inside begin with the signals blocked: see `_start_worker`."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _SharedInterrupt(Interrupt):
    """An interrupt of a worker: the parent asks first by an event, then by SIGTERM."""

    def __init__(self, ending: Event) -> None:
        super().__init__()
        self.ending = ending

    @property
    def requested(self) -> bool:
        return self.count > 0 or self.ending.is_set()

    def request(self) -> None:
        """SIGTERM reaches a worker only as the second request."""
        self.count = 2
        if self._breakable:
            raise KeyboardInterrupt


_worker_interrupt: Interrupt


def _start_worker(ending: Event) -> None:
    """Leave Ctrl-C, which the terminal sends to all, to the parent."""
    global _worker_interrupt
    _worker_interrupt = interrupt = _SharedInterrupt(ending)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: interrupt.request())
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)  # one that came too early comes now


def _work(spec: LoadedSpec, folder: Path, trial: int) -> Result:
    return run_trial(spec, folder, trial, (), _worker_interrupt)
