"""Run one trial of a spec and write its log.

In real time, background threads call the observers, so that a slow screen never delays the loop.
The loop's thread calls the writer of the log and, in virtual time, also the observers.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tetractl.core.protocols import Controller, LabSupervision, Observer
from tetractl.core.trial import Result
from tetractl.log.write.writer import LogWriter
from tetractl.run.interrupt import Interrupt
from tetractl.run.observer_relay import relayed
from tetractl.run.spec_trial import own_supervision, ready_trial
from tetractl.spec.loaded_spec import LoadedSpec


def log_path(folder: Path, trial: int) -> Path:
    """Return the path of a trial's log in the folder of a batch or of an arm."""
    return folder / f"trial-{trial:03d}.mcap"


def run_logged(
    spec: LoadedSpec,
    folder: Path,
    trial: int = 0,
    observers: Sequence[Observer] = (),
    interrupt: Interrupt | None = None,
    supervision: LabSupervision | None = None,
) -> Result:
    """Run a trial of a spec, and write its log meanwhile.

    Args:
        spec: The spec.
        folder: The folder of the log.
        trial: Index of the trial, from 0.
        observers: Objects that are also notified of every event. Each has a thread of its own if
            the trial runs in real time.
        interrupt: Ends the trial on request. By default, nobody can request that.
        supervision: How people supervise a lab. By default, nobody does.
    """
    with LogWriter(log_path(folder, trial), real_time=spec.experiment.plant.real_time) as log:
        return run_with_log(log, spec, trial, observers, interrupt, supervision)


def run_with_log(
    log: LogWriter,
    spec: LoadedSpec,
    trial: int,
    observers: Sequence[Observer],
    interrupt: Interrupt | None,
    supervision: LabSupervision | None,
    recorders: Sequence[Observer] = (),
    controller: Controller | None = None,
) -> Result:
    """Run a trial of a spec, and write it to a log that has been opened.

    Args:
        log: The writer of the log.
        spec: The spec.
        trial: Index of the trial, from 0.
        observers: See `run_logged`.
        interrupt: See `run_logged`.
        supervision: See `run_logged`.
        recorders: Observers that the loop's own thread calls, after the writer of the log.
        controller: Steers the robots. By default, the spec's controller does.
    """
    interrupt = interrupt or Interrupt()
    supervision = supervision or replace(own_supervision(interrupt), fail_log=log.fail)
    with (
        relayed(observers, spec.experiment.plant.real_time) as relays,
        ready_trial(
            spec, trial, [log, *recorders, *relays], interrupt, supervision, controller
        ) as control_loop,
    ):
        return control_loop.run()
