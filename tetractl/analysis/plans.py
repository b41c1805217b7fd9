"""Good plans of an experiment's first step, as the trials' controllers would decide them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tetractl.control.mpc import MpcSection
from tetractl.control.optimizers.multistart import Multistart
from tetractl.core.plan import Plan
from tetractl.core.poses import Observation
from tetractl.core.problem import Problem
from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment
from tetractl.run.seeds import trial_seeds


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan of the robots at their starts, and the problem that it solves.

    `reaches` tells whether its cost is good enough for the optimiser; `shortest` is the fewest
    signals whose cost is, None for none.
    """

    plan: Plan
    problem: Problem
    reaches: bool
    shortest: int | None


def planner(experiment: Experiment) -> MpcSection:
    """Return the model predictive control that the experiment is analysed with.

    It is the spec's own where it has one, with the multistart optimiser, which tells when a
    sequence is good enough, and without limits; else the default one.
    """
    control = experiment.controller
    if not isinstance(control, MpcSection):
        period = {"period": control.period, "steps_max": control.steps_max}
        return MpcSection(motion="exact", optimizer=Multistart(), **period)
    optimizer = control.optimizer
    found = {
        "optimizer": optimizer if isinstance(optimizer, Multistart) else Multistart(),
        "evaluations_max": None,
        "deadline": None,
        "arrival_tolerance": 0.0,
    }
    return control.model_copy(update=found)


def plans(section: MpcSection, setup: Setup, seed: int, count: int) -> Iterator[Planned]:
    """Yield the plans with which the first trials of a root seed would begin."""
    every = np.ones(len(setup.names), dtype=np.bool_)
    observation = Observation(0, 0, 0, setup.starts, every)
    problem = section.problem(setup)
    enough = section.optimizer.good_enough or 0.0
    for trial in range(count):
        key, _ = trial_seeds(seed, trial)
        plan = section.build(setup, key).plan(observation)
        if isinstance(plan, Plan):
            good = [one.length for one in plan.searches if one.cost <= enough]
            yield Planned(plan, problem, plan.cost <= enough, min(good, default=None))
