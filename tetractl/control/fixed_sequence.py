"""What controllers share that search nothing: the problem whose cost a log states, and the record
of signals that no search found."""

import numpy as np

from tetractl.control.cost import evaluate
from tetractl.core.plan import Search, StopReason
from tetractl.core.poses import Floats
from tetractl.core.problem import Problem, Region
from tetractl.core.setup import Setup


def plain_problem(setup: Setup, period: float, obstacles: Region, swept: bool = False) -> Problem:
    """Return the problem of robots at their starts, predicted by the exact motion over control
    periods [s]; touching an obstacle costs nothing."""
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
    """Return the record of given signals (L,) [rad]: one evaluation of their cost."""
    return search_of(signals, float(evaluate(problem, signals[None]).total[0]))


def search_of(signals: Floats, cost: float) -> Search:
    """Return the record of given signals (L,) [rad] of a known cost."""
    return Search(len(signals), signals, cost, np.array([cost]), 1, StopReason.FIXED)
