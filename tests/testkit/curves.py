"""Smooth random sequences of directions: a readable reference for the multistart kernel."""

import numpy as np


def bearing(problem):
    """The direction of the mean vector from the robots to their targets [rad]."""
    x, y = (problem.targets - problem.poses.xy).T
    return float(np.arctan2(y.sum(), x.sum()))


def interpolate(knots, length):
    """Sequences (length, P) that are linear between evenly spread knots (K, P)."""
    places = np.linspace(0, len(knots) - 1, length)
    return np.array([np.interp(places, range(len(knots)), row) for row in knots.T]).T
