"""Runs one trial of a spec: builds its clock, plant and controller, and leaves its log.

    run_logged      writes the log while the trial runs
      ready_trial   builds the trial, with any observers
      Trial.run     is the control loop (`tetractl.run.control_loop`)

In real time, a background thread calls the observers, so that a slow screen never delays the loop;
the writers of logs are called in the loop's thread. In simulation, all are.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.commands import Command
from tetractl.core.errors import TetractlError
from tetractl.core.protocols import Controller, LabSupervision, Observer, Plant
from tetractl.core.trial import EPOCH_NS, PlantInfo, Result, Start
from tetractl.log.write.writer import LogWriter
from tetractl.run.checked_controller import build_controller
from tetractl.run.control_loop import Trial, abandon
from tetractl.run.interrupt import Interrupt
from tetractl.run.model_changes import stated_model
from tetractl.spec.experiment import packages
from tetractl.spec.loaded_spec import LoadedSpec, start_of
from tetractl.tools.plugin_fault import plugins_named
from tetractl.tools.worker import Relay, Worker

if TYPE_CHECKING:
    from tetractl.spec.plants import Prepare

QUEUED_CALLS_MAX = 2000
"""Largest number of queued calls of an observer: over two minutes of a trial."""
LAST_CALLS_S = 30.0
"""Time for the last calls of an observer after the robots were stopped [s]."""


class ObserverRelay(Relay):
    """Passes calls to an observer that may be slow, in a thread of its own.

    After an exception of the observer, or with a full queue, the next call raises an exception and
    later calls are dropped.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._worker = Worker(
            "observer",
            size=QUEUED_CALLS_MAX,
            wait_s=0.0,
            patience_s=LAST_CALLS_S,
            too_slow=TetractlError("an observer is too slow for the trial"),
        )

    def put(self, call: Callable[[Observer], object]) -> None:
        """Queue a call of the observer."""
        self._worker.put(call, self._observer)

    def on_start(self, start: Start) -> None:
        """Pass the start to the observer directly, since no robot moves yet."""
        self._observer.on_start(start)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Queue the stop and the result; wait until the observer has received everything."""
        super().on_stop(stop, result)
        self._worker.drain()

    def close(self) -> None:
        """Make the queued calls, and end the thread."""
        self._worker.close()


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


def run_logged(
    spec: LoadedSpec,
    folder: Path,
    trial: int = 0,
    observers: Sequence[Observer] = (),
    interrupt: Interrupt | None = None,
    supervision: LabSupervision | None = None,
) -> Result:
    """Run a trial and write its log to `folder` meanwhile."""
    interrupt = interrupt or Interrupt()
    with (
        LogWriter(log_path(folder, trial), real_time=spec.experiment.plant.real_time) as log,
        ready_trial([log], spec, trial, observers, interrupt, supervision) as ready,
    ):
        return ready.run()


@contextmanager
def ready_trial(
    writers: Sequence[Observer],
    spec: LoadedSpec,
    trial: int,
    observers: Sequence[Observer],
    interrupt: Interrupt,
    supervision: LabSupervision | None = None,
    controller: Controller | None = None,
) -> Iterator[Trial]:
    """Give a trial that is ready to run. The `writers` of logs are called in the control loop's
    thread, the `observers` in threads of their own if the trial runs in real time. Without a
    `supervision`, this process supervises the lab; without a `controller`, the spec's decides."""
    section = spec.experiment.plant
    clock = section.clock()
    start_unix_ns = _unix_ns() if section.real_time else EPOCH_NS
    key, seed = trial_seeds(spec.experiment.trials.seed, trial)
    supervisor = supervision or _own_supervision(writers, interrupt)
    with plugins_named(packages(spec.experiment)), ExitStack() as relays:
        if section.real_time:
            observers = [
                relays.enter_context(closing(ObserverRelay(observer))) for observer in observers
            ]
        full_spec, plant = _spec_and_plant(spec, clock, seed, supervisor)
        try:
            # the trial asks the plant about itself once it is open
            not_open = PlantInfo("", section.simulated, camera_rate_hz=0.0, facts={})
            ready = Trial(
                start=start_of(full_spec, trial, not_open, start_unix_ns),
                plant=plant,
                controller=controller or build_controller(full_spec.experiment, key),
                clock=clock,
                observers=[*writers, *observers],
                interrupt=interrupt,
                stated=stated_model(full_spec.experiment),
            )
        except BaseException:
            # a plant whose cells are chosen among more is open already: its field turns, for them
            # to respond; from here on, `Trial.run` closes it
            abandon(plant)
            raise
        yield ready


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
