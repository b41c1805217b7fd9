"""The plans with which the first trials of an experiment would begin, without a deadline."""

from collections.abc import Iterator

import numpy as np

from tetractl.control.methods.algorithm2_section import SearchFields
from tetractl.control.methods.mpc_section import Collision, RecommendedMpc
from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.core.plan import Plan
from tetractl.core.poses import Observation
from tetractl.core.setup import Setup
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.controller import Host
from tetractl.spec.experiment import Experiment

POINTS = Collision(walls=False, adaptive=False, stop_before_collision=False)
"""How robots are steered whose controller has no margins: as points that may leave the arena."""
UNHURRIED = Host(timer=lambda: 0)
"""A host of controllers whose searches have no deadline.

On a busy machine, a deadline would end searches earlier, and the predictions would differ.
"""


def planner(experiment: Experiment) -> RecommendedMpc:
    """Return the section of the model predictive control that searches an experiment's plans.

    This is the spec's `controller` if its type is mpc, otherwise mpc with the spec's period, number
    of steps and, if it has them, motion and longest sequence. The optimiser is multistart, which
    has a tolerance.
    """
    control = experiment.controller
    if isinstance(control, RecommendedMpc):
        optimizer = control.optimizer
        if not isinstance(optimizer, Multistart):
            optimizer = Multistart()
        return control.model_copy(update={"optimizer": optimizer, "arrival_tolerance": 0.0})
    shared = {"period": control.period, "time_limit": control.time_limit, "signal_periods": 1}
    if isinstance(control, SearchFields):
        shared |= control.model_dump(include={"motion", "horizon_max", "obstacle_weight"})
    setup = experiment.setup
    section = RecommendedMpc(estimate=False, collision=POINTS, **shared)
    return section.fitted(setup.on_wheels, float(setup.speed.sum()))


def tolerance(section: RecommendedMpc) -> float:
    """Return the cost up to which a plan reaches the targets [length unit].

    It is the larger of the optimiser's tolerance and the accepted error.
    """
    return max(section.optimizer.good_enough or 0.0, section.accept_error)


def plans(section: RecommendedMpc, setup: Setup, seed: int, count: int) -> Iterator[Plan | None]:
    """Yield the plans with which the first trials of a batch would begin.

    A plan reaches the targets if its cost is at most the tolerance. If a robot starts within a
    margin, the cost of obstacles does not count.

    Args:
        section: The section of the controller.
        setup: The constants of the experiment.
        seed: Seed of the batch.
        count: Number of trials.

    Yields:
        The plan of each trial. None if it does not reach the targets.
    """
    all_seen = np.ones(len(setup.names), dtype=np.bool_)
    observation = Observation(0, 0, 0, setup.starts, all_seen)
    problem = section.problem(setup)
    # robots that start within a margin are steered out of it; no plan avoids that cost
    within = bool(problem.obstacles.contains(setup.starts.x, setup.starts.y).any())
    for trial in range(count):
        key, _ = trial_seeds(seed, trial)
        plan = section.build(setup, key, UNHURRIED).plan(observation)
        if isinstance(plan, Plan):
            cost = plan.target_cost if within else plan.cost
            yield plan if cost <= tolerance(section) else None
