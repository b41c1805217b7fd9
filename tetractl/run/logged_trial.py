"""Run one trial of a spec and write its log.

In real time, background threads call the observers, so that a slow screen never delays the loop.
The loop's thread calls the writer of the log and, in virtual time, also the observers.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tetractl.core.protocols import LabSupervision, Observer
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
        trial: The number of the trial.
        observers: Objects that are also notified of every event, each in a thread of its own if the
            trial runs in real time.
        interrupt: Ends the trial on request; by default, nothing else does.
        supervision: Supervises the lab; by default this process does.
    """
    interrupt = interrupt or Interrupt()
    real_time = spec.experiment.plant.real_time
    with (
        LogWriter(log_path(folder, trial), real_time=real_time) as log,
        relayed(observers, real_time) as relays,
        ready_trial(
            spec, trial, [log, *relays], interrupt, supervision or supervision_of(log, interrupt)
        ) as ready,
    ):
        return ready.run()


def supervision_of(log: LogWriter, interrupt: Interrupt) -> LabSupervision:
    """Return the supervision of a lab by the process that runs the trial and writes its log."""
    return replace(own_supervision(interrupt), fail_log=log.fail)
