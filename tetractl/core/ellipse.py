"""The ellipse of a covariance in the plane."""

import math

import numpy as np

from tetractl.core.poses import Floats

INSIDE = 0.95
"""The share of a normal distribution that lies in the ellipse."""
DEVIATIONS = math.sqrt(-2 * math.log(1 - INSIDE))
"""Distance from the ellipse's centre to its edge, in standard deviations."""


def ellipse(covariance: Floats) -> tuple[float, float, float]:
    """Return the ellipse that holds INSIDE of a normal distribution of a covariance (2, 2): its
    half axes [length unit], the longer first, and the angle of the longer one [rad].
    """
    values, vectors = np.linalg.eigh(covariance)
    short, long = DEVIATIONS * np.sqrt(np.maximum(values, 0.0))
    angle = math.atan2(float(vectors[1, 1]), float(vectors[0, 1]))
    return float(long), float(short), math.remainder(angle, math.pi)
