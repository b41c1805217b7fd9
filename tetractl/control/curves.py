"""Smooth random sequences: a few random knots joined by straight lines."""

import numpy as np

from tetractl.core.plan import Problem
from tetractl.core.poses import Floats


def bearing(problem: Problem) -> float:
    """Return the direction of the mean vector from the robots to their targets [rad]."""
    gaps = problem.targets - problem.poses.xy
    return float(np.arctan2(gaps[:, 1].sum(), gaps[:, 0].sum()))


def interpolate(knots: Floats, length: int) -> Floats:
    """Return sequences (length, P) that are linear between evenly spread knots (K, P).

    The first and last signals are the first and last knots; K is at most `length`.
    """
    places = np.linspace(0, len(knots) - 1, length)
    last_below = max(len(knots) - 2, 0)
    below = np.minimum(places.astype(np.int64), last_below)
    share = (places - below)[:, None]
    after = np.minimum(below + 1, len(knots) - 1)
    return knots[below] * (1 - share) + knots[after] * share
