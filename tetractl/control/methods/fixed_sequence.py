"""Functions that controllers share: search records of given signals, plans from search records,
where robots will be, and the best moment to stop.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.control.search.cost import Foreseen, foresee
from tetractl.control.search.evaluate import compiled_drive
from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.plan import Plan, Problem, Search, StopReason
from tetractl.core.poses import Floats


def given_search(problem: Problem, signals: Floats, foreseen: Foreseen) -> Search:
    """Return a search record of given signals (L,) [rad], whose prediction is known."""
    cost = foreseen.target + problem.obstacle_weight * foreseen.obstacle  # (7)
    return Search(len(signals), signals, cost, np.array([cost]), 1, StopReason.FIXED)


def make_plan(searches: Sequence[Search], chosen: int, step_key: int, foreseen: Foreseen) -> Plan:
    """Return the plan of a control step from its searches, given the prediction for the chosen
    one."""
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
    """Return the plan of given signals (L,) [rad]."""
    foreseen = foresee(problem, signals)
    return make_plan([given_search(problem, signals, foreseen)], 0, step_key, foreseen)


def least_error(problem: Problem, period_s: float) -> float:
    """Return a bound that no stop in the coming `period_s` can better: the sum of distances that
    would be left if every robot drove straight to its target."""
    speed = problem.speed
    if problem.flow is not None:
        speed = speed + elementwise.hypot(problem.flow[:, 0], problem.flow[:, 1])
    return float((problem.poses.distances(problem.targets) - period_s * speed).sum())


def best_stop(
    problem: Problem, direction: Floats, period_s: float, moments: int = 40
) -> tuple[int, float]:
    """Return in how long to stop [ns], at one of `moments` in the coming control period, to leave
    the least sum of distances to the targets, and that sum.

    The problem's poses are those at which a stop sent now acts. Until a later stop acts, robots
    follow `direction` (N,) [rad], NaN for a robot that stands still.
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
