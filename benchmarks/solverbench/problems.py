"""The problems everybody has to solve, and the cost as a NumPy user would write it."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tetractl.control.optimizers.pso import Pso
from tetractl.control.stop import BudgetStop
from tetractl.core.clock import VirtualClock
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.protocols import Controller, LabSupervision, Observer, Plant
from tetractl.core.trial import EPOCH_NS, PlantInfo, Result
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import load_spec
from tetractl.experiment.loaded_spec import LoadedSpec, start_of
from tetractl.run.checked_controller import build_controller
from tetractl.run.control_loop import Trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import trial_seeds

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
PAPER = "three_m3pi_paper.yaml"
OURS = "three_m3pi.yaml"
PARTICLES = 128
SIGNALS = 41
ITERATIONS = 100
LENGTH = 44
SWARM = Pso(particles=PARTICLES, iterations=ITERATIONS, stop=BudgetStop(type="budget"))


def experiment(name: str, *settings: str) -> Experiment:
    return load_spec(EXPERIMENTS / name, settings).experiment


Build = Callable[[Experiment, int, Plant], Controller]
"""Returns the controller of a spec, with its key, for a plant."""


def as_specified(spec: Experiment, key: int, plant: Plant) -> Controller:
    return build_controller(spec, key)


def played(
    spec: Experiment, trial: int, build: Build = as_specified, observers: Sequence[Observer] = ()
) -> tuple[Result, Plant]:
    """Run a trial in virtual time without any log; return its result, and its plant."""
    key, seed = trial_seeds(spec.trials.seed, trial)
    clock = VirtualClock()
    plant = spec.plant.build(spec.setup, clock, seed, LabSupervision())
    not_open = PlantInfo("", True, 0.0, {})
    start = start_of(LoadedSpec(spec, "", ""), trial, not_open, EPOCH_NS)
    controller = build(spec, key, plant)
    return Trial(start, plant, controller, clock, observers, Interrupt()).run(), plant


def run(spec: Experiment, trials: int) -> list[Result]:
    """Run trials in virtual time without any log; return their results."""
    return [played(spec, trial)[0] for trial in range(trials)]


def _problem(name: str) -> Problem:
    spec = experiment(name)
    return spec.controller.problem(spec.setup)


def printed() -> Problem:
    """Step 0 of the reference experiment as printed: Euler, obstacle tested at the samples."""
    return _problem(PAPER)


def recommended() -> Problem:
    """The same as we recommend it: exact motion, obstacle and walls swept, with a margin."""
    return _problem(OURS)


Cost = Callable[[Floats], Floats]
"""J (P,) of sequences (P, L)."""


def tuned_cost(problem: Problem) -> Cost:
    """J of the printed problem in NumPy: particles contiguous, sums in place."""
    assert problem.motion == "euler" and not problem.swept
    turn = problem.a[:, None] * problem.period
    step = problem.speed[:, None] * problem.period
    (box,) = problem.obstacles.shapes
    west, south, east, north = box.box
    start = problem.poses
    target = problem.targets[:, :, None]
    weight = problem.obstacle_weight

    def cost(signals: Floats) -> Floats:
        shape = (len(step), len(signals))
        x, y, heading = (
            np.repeat(s[:, None], shape[1], 1) for s in (start.x, start.y, start.heading)
        )
        hits = np.zeros(shape)
        for u in np.ascontiguousarray(signals.T):
            x += step * np.cos(heading)
            y += step * np.sin(heading)
            heading += turn * np.sin(u - heading)
            hits += (x >= west) & (x <= east) & (y >= south) & (y <= north)
        miss = np.hypot(x - target[:, 0], y - target[:, 1])
        return (miss + weight * hits).sum(0)

    return cost
