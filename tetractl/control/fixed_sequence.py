"""Functions that controllers share: the problem whose cost is logged by controllers that do not
search, search records of given signals, plans from search records, and the best moment to stop.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tetractl.control.cost import Foreseen, evaluate, foresee
from tetractl.control.delay import driven
from tetractl.core.clock import SECOND
from tetractl.core.plan import Plan, Problem, Region, Search, StopReason
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup

MOMENTS = 40  # number of moments of the coming control period that are tried for the stop


@dataclass(frozen=True, slots=True)
class StopForecast:
    """A stop `delay_ns` from now, and the predicted sum of distances to the targets after it."""

    delay_ns: int
    error: float


def plain_problem(setup: Setup, period: float, obstacles: Region, swept: bool = False) -> Problem:
    """Return the problem of robots at their starts, predicted by the exact motion with the control
    period `period` [s]; touching an obstacle costs nothing."""
    return Problem(
        poses=setup.starts,
        targets=setup.targets,
        a=setup.a,
        speed=setup.speed,
        motion="exact",
        period=period,
        first_period=period,
        obstacles=obstacles,
        obstacle_weight=0.0,
        swept=swept,
    )


def given_search(problem: Problem, signals: Floats) -> Search:
    """Return a search record of given signals (L,) [rad], with one evaluation of their cost."""
    return search_of(signals, float(evaluate(problem, signals[None]).total[0]))


def search_of(signals: Floats, cost: float) -> Search:
    """Return a search record of given signals (L,) [rad] whose cost is known."""
    return Search(len(signals), signals, cost, np.array([cost]), 1, StopReason.FIXED)


def make_plan(
    problem: Problem,
    searches: list[Search],
    chosen: int,
    step_key: int,
    foreseen: Callable[[Problem, Floats], Foreseen] = foresee,
) -> Plan:
    """Return the plan of a control step from its searches, with the predicted path and the terms of
    the paper's cost (7).
    """
    best = searches[chosen]
    ahead = foreseen(problem, best.signals)
    return Plan(
        signals=best.signals,
        path=ahead.path,
        cost=best.cost,
        target_cost=ahead.target,
        obstacle_cost=ahead.obstacle,
        searches=tuple(searches),
        chosen=chosen,
        generator=step_key,
    )


def best_stop(problem: Problem, direction: Floats, period_s: float) -> StopForecast:
    """Return the stop within the coming control period that leaves the least sum of distances.

    The problem's poses are those at which a stop sent now acts. Until a later stop acts, robots
    follow `direction` (N,) [rad], NaN for a robot that stands still.
    """
    delays = np.arange(MOMENTS, dtype=np.float64) * (period_s / MOMENTS)
    x, y, _ = driven(problem, problem.poses, direction, delays[:, None])
    targets = problem.targets
    errors = np.hypot(x - targets[:, 0], y - targets[:, 1]).sum(axis=1)
    best = int(np.argmin(errors))
    return StopForecast(round(float(delays[best]) * SECOND), float(errors[best]))
