"""Predicts how accurately the robots of a setup can be steered together, along several good plans.

The plans are those that the controllers of the first trials would find in their first step, if
these had all the time that their searches take.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tetractl.analysis.closed_loop import (
    Noise,
    end_covariance,
    linearise,
    mean_errors,
    of_each,
)
from tetractl.control.mpc_section import Collision, RecommendedMpc, SearchFields
from tetractl.control.optimizers.multistart import Multistart
from tetractl.core.plan import Plan
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.experiment.controller import Host
from tetractl.experiment.experiment import Experiment
from tetractl.run.spec_trial import trial_seeds

POINTS = Collision(walls=False, adaptive=False, stop_before_collision=False)
"""How robots are steered whose controller has no margins: as points that may leave the arena."""
UNHURRIED = Host(timer=lambda: 0)
"""The host of controllers whose searches no deadline ends: on a busy machine it would end them
earlier, and the predictions would be others."""


def planner(experiment: Experiment) -> RecommendedMpc:
    """Return the section of the model predictive control by which an experiment is analysed.

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
    """Return the cost up to which a plan reaches the targets [length unit]: the larger of the
    optimiser's tolerance and the accepted error.
    """
    return max(section.optimizer.good_enough or 0.0, section.accept_error)


def plans(section: RecommendedMpc, setup: Setup, seed: int, count: int) -> Iterator[Plan | None]:
    """Yield the plans with which the first `count` trials of a batch with this seed would begin,
    None for one that does not reach the targets.

    It does if its cost is at most the tolerance, without the cost of obstacles if a robot starts
    within a margin.
    """
    all_seen = np.ones(len(setup.names), dtype=np.bool_)
    observation = Observation(0, 0, 0, setup.starts, all_seen)
    problem = section.problem(setup)
    # robots that start within a margin are steered out of it; no plan avoids that cost
    within = bool(problem.obstacles.contain(setup.starts.x, setup.starts.y).any())
    for trial in range(count):
        key, _ = trial_seeds(seed, trial)
        plan = section.build(setup, key, UNHURRIED).plan(observation)
        if isinstance(plan, Plan):
            cost = plan.target_cost if within else plan.cost
            yield plan if cost <= tolerance(section) else None


@dataclass(frozen=True, slots=True)
class Steering:
    """The analysis of N robots along M plans that reach the targets; lengths in the spec's unit.

    `shortest` is the least number of signals with which a search reached the targets. `errors` (M,)
    are the predicted mean total errors with feedback, `open_loop` (M,) without feedback; `planned`
    (M,) are the total errors without noise. The other fields describe the plan of the median
    predicted error: `signals` is its length, `singular` (2N,) the singular values of the derivative
    of the ends with respect to the signals [length unit/rad], descending, `weakest` (N,) each
    robot's fraction of the squared unit vector that belongs to the least singular value,
    `robot_errors` (N,) the predicted mean errors, `covariance` (N, 2, 2) the covariance of each
    end, and `free_covariance` that covariance without feedback.
    """

    shortest: int
    signal_s: float
    errors: Floats
    open_loop: Floats
    planned: Floats
    signals: int
    singular: Floats
    weakest: Floats
    robot_errors: Floats
    covariance: Floats
    free_covariance: Floats

    @property
    def error(self) -> float:
        """The predicted mean total error with feedback, the median over the plans.

        The median is used because a controller replaces a plan that is hard to follow by a better
        one.
        """
        return float(np.median(self.errors))


def _shortest(plan: Plan, enough: float) -> int:
    """Return the least length of the sequences found for a plan that cost `enough` or less, and of
    the plan itself."""
    lengths = [search.length for search in plan.searches if search.cost <= enough]
    return min([len(plan.signals), *lengths])


def steering(
    section: RecommendedMpc, setup: Setup, noise: Noise, seed: int, count: int
) -> Steering | None:
    """Search `count` plans for the robots of a setup, and analyse the plans that reach the targets;
    None if no plan reaches them.
    """
    reaching = [plan for plan in plans(section, setup, seed, count) if plan is not None]
    if not reaching:
        return None
    problem = section.problem(setup)
    linears = [linearise(problem, plan.signals) for plan in reaching]
    covariances: list[Floats] = []  # of the ends, (2N, 2N)
    errors_of_plans: list[Floats] = []
    free_covariances: list[Floats] = []  # without feedback
    open_loop: list[float] = []
    for linear in linears:
        covariance = end_covariance(linear, noise, corrects=True, identifies=section.estimate)
        covariances.append(covariance)
        errors_of_plans.append(mean_errors(covariance, linear.miss))
        free_covariance = end_covariance(linear, noise, corrects=False)
        free_covariances.append(free_covariance)
        open_loop.append(mean_errors(free_covariance, linear.miss).sum())
    errors = np.array([of_plan.sum() for of_plan in errors_of_plans])
    median = int(np.argsort(errors)[(len(errors) - 1) // 2])
    directions, spread, _ = np.linalg.svd(linears[median].by_signal, full_matrices=False)
    singular = np.zeros(2 * len(setup.names))
    singular[: len(spread)] = spread  # with fewer signals than coordinates, some values stay 0
    weakest = directions[:, -1].reshape(-1, 2)
    return Steering(
        shortest=min(_shortest(plan, tolerance(section)) for plan in reaching),
        signal_s=section.signal_periods * section.period,
        errors=errors,
        open_loop=np.array(open_loop),
        planned=np.array([linear.miss.sum() for linear in linears]),
        signals=len(reaching[median].signals),
        singular=singular,
        weakest=(weakest**2).sum(axis=1),
        robot_errors=errors_of_plans[median],
        covariance=of_each(covariances[median]),
        free_covariance=of_each(free_covariances[median]),
    )
