"""Searches the plans with which the first trials of an experiment would begin."""

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

POINT_COLLISION = Collision(walls=False, adaptive=False, stop_before_collision=False)
"""Collision settings without margins: robots are points and may leave the arena."""
HOST_WITHOUT_DEADLINE = Host(timer=lambda: 0)
"""A host of controllers whose searches have no deadline.

On a busy machine, a deadline would end searches earlier, and the predictions would differ.
"""


def select_planner(experiment: Experiment) -> RecommendedMpc:
    """Select the section of the model predictive control that searches an experiment's plans.

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
    section = RecommendedMpc(estimate=False, collision=POINT_COLLISION, **shared)
    return section.fitted(setup.on_wheels, float(setup.speed.sum()))


def compute_cost_tolerance(section: RecommendedMpc) -> float:
    """Compute the maximum cost of a plan that reaches the targets [length unit].

    It is the larger of the optimiser's tolerance and the accepted error.
    """
    return max(section.optimizer.good_enough or 0.0, section.accept_error)


def search_first_plans(
    section: RecommendedMpc, setup: Setup, seed: int, count: int
) -> Iterator[Plan | None]:
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
        plan = section.build(setup, key, HOST_WITHOUT_DEADLINE).plan(observation)
        if isinstance(plan, Plan):
            cost = plan.target_cost if within else plan.cost
            yield plan if cost <= compute_cost_tolerance(section) else None
