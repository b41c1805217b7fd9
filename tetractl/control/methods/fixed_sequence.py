"""Functions that several controllers share: records of searches, plans, and the best stop.

They create search records from given signals, create plans from search records, and find the best
moment to stop.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.control.search.cost import Prediction, predict_with_costs
from tetractl.control.search.evaluate import compiled_drive
from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.plan import Plan, Problem, Search, StopReason
from tetractl.core.poses import Floats


def given_search(problem: Problem, signals: Floats, foreseen: Prediction) -> Search:
    """Create the record of a search whose result is a given sequence, as if one was evaluated.

    Args:
        problem: The problem of the control step.
        signals: The sequence [rad], shape (L,).
        foreseen: The predicted path and costs of the sequence.
    """
    cost = foreseen.target + problem.obstacle_weight * foreseen.obstacle  # (7)
    return Search(len(signals), signals, cost, np.array([cost]), 1, StopReason.FIXED)


def make_plan(searches: Sequence[Search], chosen: int, step_key: int, foreseen: Prediction) -> Plan:
    """Create the plan of a control step from its searches.

    Args:
        searches: All searches of the step.
        chosen: Index of the chosen search.
        step_key: Key of all random numbers in the step.
        foreseen: The prediction for the chosen search.
    """
    best = searches[chosen]
    return Plan(
        signals=best.signals,
        path=foreseen.path,
        cost=best.cost,
        target_cost=foreseen.target,
        obstacle_cost=foreseen.obstacle,
        searches=tuple(searches),
        chosen=chosen,
        generator=step_key,
    )


def given_plan(problem: Problem, signals: Floats, step_key: int) -> Plan:
    """Create a plan that follows a given sequence of signals, without a search.

    Args:
        problem: The problem of the control step.
        signals: The sequence [rad], shape (L,).
        step_key: Key of all random numbers in the step.
    """
    foreseen = predict_with_costs(problem, signals)
    return make_plan([given_search(problem, signals, foreseen)], 0, step_key, foreseen)


def least_error(problem: Problem, period_s: float) -> float:
    """Compute a lower bound of the error if robots stop at any time in the coming period.

    The bound is the sum of distances that would remain if every robot drove straight to its target.

    Args:
        problem: The problem of the control step.
        period_s: Duration of the period [s].
    """
    speed = problem.speed
    if problem.flow is not None:
        speed = speed + elementwise.hypot(problem.flow[:, 0], problem.flow[:, 1])
    return float((problem.poses.distances(problem.targets) - period_s * speed).sum())


def best_stop(
    problem: Problem, direction: Floats, period_s: float, moments: int = 40
) -> tuple[int, float]:
    """Find the best moment in the coming control period to stop the robots.

    The problem's poses are those at which a stop that is sent now takes effect.

    Args:
        problem: The problem of the control step.
        direction: Direction that each robot follows until the stop takes effect [rad], shape (N,).
            NaN if a robot stands still.
        period_s: Duration of the control period [s].
        moments: How many moments to compare.

    Returns:
        The time until that moment [ns], and the sum of distances to the targets after the stop.
    """
    delays = np.arange(moments, dtype=np.float64) * (period_s / moments)
    path = compiled_drive(problem, direction, delays)
    targets = problem.targets
    errors = elementwise.hypot(path[..., 0] - targets[:, 0], path[..., 1] - targets[:, 1]).sum(
        axis=1
    )
    best = int(np.argmin(errors))
    delay_ns = round(float(delays[best]) * SECOND)
    return delay_ns, float(errors[best])
