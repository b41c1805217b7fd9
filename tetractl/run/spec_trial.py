"""Build one trial of a spec: its clock, plant and controller.

    ready_trial   builds the trial
    Trial.run     is the control loop (`tetractl.run.control_loop`)

`run_logged` of `tetractl.run.logged_trial` also writes a log.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.protocols import Controller, LabSupervision, Observer, Plant
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo
from tetractl.run.checked_controller import build_controller
from tetractl.run.control_loop import EstimateMonitor, Trial, abandon
from tetractl.run.interrupt import Interrupt
from tetractl.spec.experiment import Experiment, find_packages
from tetractl.spec.loaded_spec import LoadedSpec, create_start
from tetractl.tools.plugin_fault import name_plugins_in_errors

if TYPE_CHECKING:
    from tetractl.spec.plants import Prepare


def trial_seeds(root_seed: int, trial: int) -> tuple[int, np.random.SeedSequence]:
    """Derive the seeds of a trial from the root seed of a batch.

    They come from children of SeedSequence(root) with the spawn keys (trial, 0) and (trial, 1), so
    they do not depend on the number or order of the trials.

    Returns:
        The seed of the controller, and the seed sequence of the plant's disturbances.
    """
    controller = np.random.SeedSequence(root_seed, spawn_key=(trial, 0))
    plant = np.random.SeedSequence(root_seed, spawn_key=(trial, 1))
    return int(controller.generate_state(1, np.uint64)[0]), plant


@contextmanager
def ready_trial(
    spec: LoadedSpec,
    trial: int,
    observers: Sequence[Observer],
    interrupt: Interrupt,
    supervision: LabSupervision | None = None,
    controller: Controller | None = None,
) -> Iterator[Trial]:
    """Prepare a trial of a spec, and yield it when it is ready to run.

    Args:
        spec: The spec.
        trial: Index of the trial, from 0.
        observers: Objects that are notified of every event, in the thread of the control loop.
        interrupt: Ends the trial on request.
        supervision: How people supervise a lab. By default, nobody does.
        controller: The controller. By default, the spec's controller.
    """
    section = spec.experiment.plant
    clock = section.clock()
    start_unix_ns = time.time_ns() if section.real_time else SIMULATED_START_NS
    key, seed = trial_seeds(spec.experiment.trials.seed, trial)
    supervisor = supervision or own_supervision(interrupt)
    with name_plugins_in_errors(find_packages(spec.experiment)):
        full_spec, plant = _spec_and_plant(spec, clock, seed, supervisor)
        with ExitStack() as unless_ready:
            # a plant that has chosen its robots is open already, and nobody else would stop it
            unless_ready.callback(abandon, plant)
            # the trial asks the plant about itself once it is open
            not_open = PlantInfo("", section.simulated, camera_rate_hz=0.0, facts={})
            control_loop = Trial(
                start=create_start(full_spec, trial, not_open, start_unix_ns),
                plant=plant,
                controller=controller or build_controller(full_spec.experiment, key),
                clock=clock,
                observers=observers,
                interrupt=interrupt,
                model_monitor=_model_monitor(full_spec.experiment),
            )
            unless_ready.pop_all()  # from here on, `Trial.run` closes the plant
        yield control_loop


def own_supervision(interrupt: Interrupt) -> LabSupervision:
    """Create the supervision of a lab by this process alone: the interrupt cancels its waits."""
    return LabSupervision(cancelled=lambda: interrupt.requested, signalled=interrupt.request)


def _model_monitor(experiment: Experiment) -> EstimateMonitor | None:
    """Create the monitor of the controller's estimates.

    The result is None if the controller makes no estimates.
    """
    function = experiment.controller.model_monitor
    return resolve_name(function)(experiment) if function else None


def _spec_and_plant(
    spec: LoadedSpec, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
) -> tuple[LoadedSpec, Plant]:
    """Build the plant. Return it with the spec, which is completed by the robots that it found."""
    experiment = spec.experiment
    rule = experiment.chosen  # the rule that finds the robots, None if the spec lists them
    if rule is None or rule.are_found:
        return spec, experiment.plant.build(experiment.setup, clock, seed, supervision)
    prepare: Prepare = resolve_name(rule.prepare)
    prepared = prepare(experiment, clock, seed, supervision)
    return replace(spec, experiment=prepared.experiment), prepared.plant
