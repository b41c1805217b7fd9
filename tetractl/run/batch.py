"""A batch: the trials of one experiment, each with its own log, in one or more processes."""

import gc
import time
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol

from tetractl.control.build import build_controller
from tetractl.core.commands import PlantInfo
from tetractl.core.errors import AbortError, TetractlError
from tetractl.core.operators import Operators
from tetractl.core.plan import Outcome
from tetractl.core.protocols import Observer
from tetractl.core.trial import EPOCH_NS, Result
from tetractl.experiment.load import LoadedSpec, start_of
from tetractl.log.write.writer import LogWriter
from tetractl.run.interrupt import Interrupt
from tetractl.run.pool import Pool, worker_interrupt
from tetractl.run.relay import Relay
from tetractl.run.seeds import trial_seeds
from tetractl.run.trial import Trial


class BatchObserver(Protocol):
    """Watches a batch; `index` counts trials from 0, and trials may end in any order."""

    def trial_started(self, index: int, n: int) -> None:
        """Trial `index` of `n` starts."""
        ...

    def trial_finished(self, index: int, result: Result) -> None:
        """Trial `index` has ended."""
        ...


@dataclass(slots=True)
class Report:
    """The outcome of a batch: results by trial, and the trials that were not run."""

    results: dict[int, Result] = field(default_factory=dict)
    not_run: list[int] = field(default_factory=list)
    asked_to_stop: bool = False
    refused: TetractlError | None = None  # why a trial could not start

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
    """Return the file of a trial's log."""
    return folder / f"trial-{trial:03d}.mcap"


def run_trial(
    spec: LoadedSpec,
    folder: Path,
    trial: int,
    observers: Sequence[Observer],
    interrupt: Interrupt,
    operators: Operators | None = None,
) -> Result:
    """Run one trial and write its log.

    In real time a background thread calls the observers, so that none of them delays the loop.
    """
    log = LogWriter(log_path(folder, trial), real_time=not spec.experiment.plant.simulated)
    with log:
        return run_with([log], spec, trial, observers, interrupt, operators)


def run_with(
    writers: Sequence[Observer],
    spec: LoadedSpec,
    trial: int,
    observers: Sequence[Observer],
    interrupt: Interrupt,
    operators: Operators | None = None,
) -> Result:
    """Run one trial as `run_trial` does, with other writers in the place of its log's."""
    experiment = spec.experiment
    plant, real_time = experiment.plant, not experiment.plant.simulated
    clock, start_unix_ns = plant.clock(), _unix_ns() if real_time else EPOCH_NS
    key, seed = trial_seeds(experiment.trials.seed, trial)
    with ExitStack() as stack:
        if real_time:
            observers = [stack.enter_context(Relay(observer)) for observer in observers]
        return Trial(
            start=start_of(spec, trial, PlantInfo("", plant.simulated, 0.0, {}), start_unix_ns),
            plant=plant.build(experiment.setup, clock, seed, operators or Operators()),
            controller=build_controller(experiment, key),
            first_plan=experiment.controller.first_plan,
            clock=clock,
            observers=[*writers, *observers],
            interrupt=interrupt,
        ).run()


def _unix_ns() -> int:
    """Return the hour [ns since 1970]; a log holds none before."""
    if (now := time.time_ns()) < 0:
        raise TetractlError("this computer's clock is before 1970", "set its date, then run again")
    return now


def _nobody(trial: int) -> AbstractContextManager[Operators | None]:
    return nullcontext()


def run_batch(
    spec: LoadedSpec,
    folder: Path,
    trials: Sequence[int],
    jobs: int,
    interrupt: Interrupt,
    watcher: BatchObserver,
    observers: Sequence[Observer] = (),
    operators: Callable[[int], AbstractContextManager[Operators | None]] = _nobody,
) -> Report:
    """Run trials, `jobs` at a time; an interruption or an aborted trial ends the batch.

    `observers` are called in every trial, and `operators` returns the people and files at a trial
    in the lab; both need `jobs` to be 1. A trial that cannot start ends the batch too.
    """
    report = Report()
    if min(jobs, len(trials)) > 1:
        _run_processes(spec, folder, trials, jobs, interrupt, watcher, report)
    else:
        if not spec.experiment.plant.simulated:
            gc.collect()
            gc.freeze()  # so that collecting what was imported never delays the inner loop
        for trial in trials:
            if interrupt.requested or report.aborted:
                break
            watcher.trial_started(trial, spec.experiment.trials.count)
            try:
                with operators(trial) as mine:
                    result = run_trial(spec, folder, trial, observers, interrupt, mine)
            except TetractlError as error:
                report.refused = error
                break
            report.results[trial] = result
            watcher.trial_finished(trial, result)
    report.not_run = [trial for trial in trials if trial not in report.results]
    report.asked_to_stop = interrupt.requested
    return report


def _run_processes(
    spec: LoadedSpec,
    folder: Path,
    trials: Sequence[int],
    jobs: int,
    interrupt: Interrupt,
    watcher: BatchObserver,
    report: Report,
) -> None:
    def started(trial: int) -> None:
        watcher.trial_started(trial, spec.experiment.trials.count)

    with Pool(min(jobs, len(trials)), interrupt) as pool:
        for trial, future in pool.run(partial(_work, spec, folder), trials, started):
            try:
                report.results[trial] = result = future.result()
            except BrokenProcessPool:
                raise AbortError(
                    "the process of a trial was killed, perhaps for want of memory",
                    f"with fewer --jobs, go on by --out {folder} --resume",
                ) from None
            watcher.trial_finished(trial, result)
            if report.aborted:
                pool.end()


def _work(spec: LoadedSpec, folder: Path, trial: int) -> Result:
    return run_trial(spec, folder, trial, (), worker_interrupt())
