"""Wheels of a single robot."""

import numpy as np

from tetractl.model.wheels import Drivetrains


def train(gain=(10.0, 10.0), dead_zone=(0, 0), limit=127, swap=False):
    """Return one robot's wheels: gains [mm/s per count] and dead zones of the left and right."""
    gains = np.array(gain)[:, None]
    zones = np.array(dead_zone)[:, None]
    return Drivetrains(gains, zones, np.array([limit]), np.array([swap]))
