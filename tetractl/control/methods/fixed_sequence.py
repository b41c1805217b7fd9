"""Helpers that several controllers share: search records, plans, and the best moment to stop."""

from collections.abc import Sequence

import numpy as np

from tetractl.control.search.cost import Prediction, predict_with_costs
from tetractl.control.search.evaluate import compiled_drive
from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.plan import Plan, Problem, Search, StopReason
from tetractl.core.poses import Floats


def given_search(problem: Problem, signals: Floats, prediction: Prediction) -> Search:
    """Create a search record for a given sequence, as if a search had evaluated only this one.

    Args:
        problem: The problem of the control step.
        signals: The sequence [rad], shape (L,).
        prediction: The predicted path and costs of the sequence.
    """
    cost = prediction.target + problem.obstacle_weight * prediction.obstacle  # (7)
    return Search(len(signals), signals, cost, np.array([cost]), 1, StopReason.FIXED)


def make_plan(
    searches: Sequence[Search], chosen: int, step_key: int, prediction: Prediction
) -> Plan:
    """Create the plan of a control step from its searches.

    Args:
        searches: All searches of the step.
        chosen: Index of the chosen search.
        step_key: Key of all random numbers in the step.
        prediction: The prediction for the chosen search.
    """
    best = searches[chosen]
    return Plan(
        signals=best.signals,
        path=prediction.path,
        cost=best.cost,
        target_cost=prediction.target,
        obstacle_cost=prediction.obstacle,
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
    prediction = predict_with_costs(problem, signals)
    return make_plan([given_search(problem, signals, prediction)], 0, step_key, prediction)


def min_error(problem: Problem, period_s: float) -> float:
    """Compute a lower bound of the total error after a stop in the coming period [length unit].

    The bound is the sum of distances that would remain if every robot drove straight to its target.

    Args:
        problem: The problem of the control step.
        period_s: Duration of the period [s].
    """
    speed = problem.speed
    if problem.flow is not None:
        speed = speed + elementwise.hypot(problem.flow[:, 0], problem.flow[:, 1])
    return float((problem.poses.distances(problem.targets) - period_s * speed).sum())


def find_best_stop(
    problem: Problem, directions: Floats, period_s: float, n_moments: int = 40
) -> tuple[int, float]:
    """Find the best moment in the coming control period to stop the robots.

    The problem's poses are those at which a stop that is sent now takes effect.

    Args:
        problem: The problem of the control step.
        directions: Direction that each robot follows until the stop takes effect [rad], shape (N,).
            NaN if a robot stands still.
        period_s: Duration of the control period [s].
        n_moments: How many moments to compare.

    Returns:
        The time until that moment [ns], and the sum of distances to the targets after the stop.
    """
    delays_s = np.arange(n_moments, dtype=np.float64) * (period_s / n_moments)
    path = compiled_drive(problem, directions, delays_s)
    targets = problem.targets
    errors = elementwise.hypot(path[..., 0] - targets[:, 0], path[..., 1] - targets[:, 1]).sum(
        axis=1
    )
    best_index = int(np.argmin(errors))
    delay_ns = round(float(delays_s[best_index]) * SECOND)
    return delay_ns, float(errors[best_index])
