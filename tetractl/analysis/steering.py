"""Predicts how accurately the robots of a setup can be steered together, along several good plans.

The plans are those that the controllers of the first trials would find in their first step, if
these had all the time that their searches take.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tetractl.analysis.closed_loop import Noise, end_covariance, linearise, mean_errors, of_each
from tetractl.control.collision import Collision
from tetractl.control.mpc_section import RecommendedMpc, SearchFields
from tetractl.control.optimizers.multistart import Multistart
from tetractl.core.plan import Plan, Problem
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.experiment.controller import Host
from tetractl.experiment.experiment import Experiment
from tetractl.run.spec_trial import trial_seeds

POINTS = Collision(walls=False, adaptive=False, stop_before_collision=False, silence=0.0)
"""How robots are steered whose controller has no margins: as points that may leave the arena."""
UNHURRIED = Host(timer=lambda: 0)
"""The host of controllers whose searches no deadline ends: on a busy machine it would end them
earlier, and the predictions would be others."""


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan of the robots at their starts, and the problem that it solves.

    `reaches` is whether the plan's cost is at most the tolerance, without the cost of obstacles if
    a robot starts within a margin. `shortest` is the least number of signals of the sequences found
    that reach the targets, None if none does.
    """

    plan: Plan
    problem: Problem
    reaches: bool
    shortest: int | None


def planner(experiment: Experiment) -> RecommendedMpc:
    """Return the section of the model predictive control by which an experiment is analysed.

    This is the spec's `controller` if its type is mpc, otherwise mpc with the spec's period, number
    of steps and, if it has them, motion and longest sequence. The optimiser is multistart, which
    has a tolerance.
    """
    control = experiment.controller
    if isinstance(control, RecommendedMpc):
        optimizer = control.optimizer
        found = {
            "optimizer": optimizer if isinstance(optimizer, Multistart) else Multistart(),
            "arrival_tolerance": 0.0,
        }
        return control.model_copy(update=found)
    shared = {"period": control.period, "time_limit": control.time_limit, "signal_periods": 1}
    if isinstance(control, SearchFields):
        shared |= control.model_dump(include={"motion", "horizon_max", "obstacle_weight"})
    setup = experiment.setup
    section = RecommendedMpc(estimate=False, collision=POINTS, **shared)
    return section.fitted(setup.wheel_radius is not None, float(setup.speed.sum()))


def tolerance(section: RecommendedMpc) -> float:
    """Return the cost up to which a plan reaches the targets [length unit]: the larger of the
    optimiser's tolerance and the accepted error.
    """
    return max(section.optimizer.good_enough or 0.0, section.accept_error)


def plans(section: RecommendedMpc, setup: Setup, seed: int, count: int) -> Iterator[Planned]:
    """Yield the plans with which the first `count` trials of a batch with this seed would begin."""
    every = np.ones(len(setup.names), dtype=np.bool_)
    observation = Observation(0, 0, 0, setup.starts, every)
    problem = section.problem(setup)
    enough = tolerance(section)
    within = bool(problem.obstacles.contain(setup.starts.x, setup.starts.y).any())
    for trial in range(count):
        key, _ = trial_seeds(seed, trial)
        plan = section.build(setup, key, UNHURRIED).plan(observation)
        if isinstance(plan, Plan):
            # robots that start within a margin are steered out of it; no plan avoids that cost
            reaches = (plan.target_cost if within else plan.cost) <= enough
            good = [one.length for one in plan.searches if one.cost <= enough]
            good += [len(plan.signals)] if reaches else []
            yield Planned(plan, problem, reaches, min(good, default=None))


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

    shortest: int | None
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


def steering(
    section: RecommendedMpc, setup: Setup, noise: Noise, seed: int, count: int
) -> Steering | None:
    """Search `count` plans for the robots of a setup, and analyse the plans that reach the targets;
    None if no plan reaches them.
    """
    found = [planned for planned in plans(section, setup, seed, count) if planned.reaches]
    if not found:
        return None
    linear = [linearise(planned.problem, planned.plan.signals) for planned in found]
    closed = [end_covariance(one, noise, True, section.estimate) for one in linear]
    free = [end_covariance(one, noise, corrects=False) for one in linear]
    each = [mean_errors(p, one.miss) for p, one in zip(closed, linear, strict=True)]
    errors = np.array([one.sum() for one in each])
    middle = int(np.argsort(errors)[(len(errors) - 1) // 2])
    left, singular, _ = np.linalg.svd(linear[middle].by_signal, full_matrices=False)
    size = 2 * len(setup.names)
    values = np.zeros(size)  # with fewer signals than coordinates, some values stay 0
    values[: len(singular)] = singular
    shares = (left[:, -1] ** 2).reshape(-1, 2).sum(axis=1)
    return Steering(
        shortest=min((one.shortest for one in found if one.shortest is not None), default=None),
        signal_s=section.signal_periods * section.period,
        errors=errors,
        open_loop=np.array(
            [mean_errors(p, one.miss).sum() for p, one in zip(free, linear, strict=True)]
        ),
        planned=np.array([one.miss.sum() for one in linear]),
        signals=len(found[middle].plan.signals),
        singular=values,
        weakest=shares,
        robot_errors=each[middle],
        covariance=of_each(closed[middle]),
        free_covariance=of_each(free[middle]),
    )
