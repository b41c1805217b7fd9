"""Smooth random sequences: a few random knots joined by straight lines."""

import numpy as np
from numpy.typing import NDArray

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
    below, part = places(len(knots), length)
    share, after = part[:, None], np.minimum(below + 1, len(knots) - 1)
    return knots[below] * (1 - share) + knots[after] * share


def places(count: int, length: int) -> tuple[NDArray[np.int64], Floats]:
    """Place `length` signals among `count` evenly spread knots.

    Return, for each signal, the index of the knot before it, and the signal's distance from that
    knot as a fraction of the distance between two knots.
    """
    at = np.linspace(0, count - 1, length)
    below = np.minimum(at.astype(np.int64), max(count - 2, 0))
    return below, at - below
