"""A batch: many trials of one experiment, each in its own log, over one or more processes."""

import multiprocessing
import os
import signal
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Protocol

from tetractl.clock import VirtualClock
from tetractl.control.build import build_controller
from tetractl.control.plan import Outcome
from tetractl.log.records import EPOCH_NS, Observer, Result, Start
from tetractl.log.writer import LogWriter
from tetractl.plant.build import build_plant
from tetractl.plant.protocol import PlantInfo
from tetractl.run.interrupt import Interrupt
from tetractl.run.seeds import trial_seeds
from tetractl.run.trial import Trial
from tetractl.spec.load import LoadedSpec


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

    @property
    def interrupted(self) -> bool:
        """Whether somebody stopped the batch."""
        return any(r.outcome is Outcome.INTERRUPTED for r in self.results.values())

    @property
    def aborted(self) -> dict[int, Result]:
        """The trials that a fault ended."""
        return {i: r for i, r in self.results.items() if r.outcome is Outcome.ABORTED}


def log_path(folder: Path, trial: int) -> Path:
    """Return where the log of a trial goes."""
    return folder / f"trial-{trial:03d}.mcap"


def run_trial(
    spec: LoadedSpec, folder: Path, trial: int, observers: Sequence[Observer], interrupt: Interrupt
) -> Result:
    """Run one trial in virtual time and write its log."""
    experiment = spec.experiment
    key, seed = trial_seeds(experiment.trials.seed, trial)
    clock = VirtualClock()
    nothing_yet = PlantInfo("", True, 0.0, {})
    start = Start(experiment, spec.text, spec.name, trial, nothing_yet, EPOCH_NS)
    with LogWriter(log_path(folder, trial)) as writer:
        return Trial(
            start=start,
            plant=build_plant(experiment, clock, seed),
            controller=build_controller(experiment, key),
            clock=clock,
            observers=(writer, *observers),
            interrupt=interrupt,
        ).run()


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
    if jobs == 1:
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
    with ProcessPoolExecutor(count, context, _start_worker, (ending,)) as pool:
        while running or (waiting and not ending.is_set()):
            while waiting and len(running) < count and not ending.is_set():
                trial = waiting.pop()
                watcher.trial_started(trial, spec.experiment.trials.count)
                running[pool.submit(_work, spec, folder, trial)] = trial
            done, _ = wait(running, timeout=0.1, return_when=FIRST_COMPLETED)
            for future in done:
                trial = running.pop(future)
                report.results[trial] = result = future.result()
                watcher.trial_finished(trial, result)
            if interrupt.requested or report.aborted:
                ending.set()
            if interrupt.count > 1:
                for process in multiprocessing.active_children():
                    if process.pid:
                        os.kill(process.pid, signal.SIGTERM)
                interrupt.count = 1  # told once is enough; a third request tells again


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


def _work(spec: LoadedSpec, folder: Path, trial: int) -> Result:
    return run_trial(spec, folder, trial, (), _worker_interrupt)
