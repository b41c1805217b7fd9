"""The problems that all solvers have to solve."""

from collections.abc import Sequence
from pathlib import Path

from tetractl.core.clock import VirtualClock
from tetractl.core.plan import Problem
from tetractl.core.protocols import LabSupervision, Observer, Plant
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo, Result
from tetractl.run.checked_controller import build_controller
from tetractl.run.control_loop import EstimateMonitor, Trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import load_spec
from tetractl.spec.loaded_spec import LoadedSpec, create_start

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
PAPER = "three_m3pi_paper.yaml"
OURS = "three_m3pi.yaml"
PARTICLES = 128
LENGTH = 44


def experiment(name: str, *settings: str) -> Experiment:
    return load_spec(EXPERIMENTS / name, settings).experiment


def played(
    spec: Experiment,
    trial: int,
    observers: Sequence[Observer] = (),
    model: EstimateMonitor | None = None,
) -> tuple[Result, Plant]:
    """Run a trial in virtual time without a log.

    Args:
        spec: The experiment.
        trial: Index of the trial.
        observers: Objects that are notified of everything that happens.
        model: Reports what is new in the controller's estimates. None to report nothing.

    Returns:
        The result of the trial, and its plant.
    """
    key, seed = trial_seeds(spec.trials.seed, trial)
    clock = VirtualClock()
    plant = spec.plant.build(spec.setup, clock, seed, LabSupervision())
    not_open = PlantInfo("", True, 0.0, {})
    start = create_start(LoadedSpec(spec, "", ""), trial, not_open, SIMULATED_START_NS)
    controller = build_controller(spec, key)
    return Trial(start, plant, controller, clock, observers, Interrupt(), model).run(), plant


def run(spec: Experiment, trials: int) -> list[Result]:
    """Run trials in virtual time without logs, and return their results."""
    return [played(spec, trial)[0] for trial in range(trials)]


def _problem(name: str) -> Problem:
    spec = experiment(name)
    return spec.controller.problem(spec.setup)


def printed() -> Problem:
    """Return step 0 of the reference experiment as printed: Euler, obstacles at the samples."""
    return _problem(PAPER)


def recommended() -> Problem:
    """Return step 0 as we recommend it: exact motion, obstacles and walls swept, with a margin."""
    return _problem(OURS)
