"""Velocities of a track by its places alone, without a model of how a cell swims."""

from itertools import pairwise

import numpy as np

from tetractl.core.poses import Floats

WINDOW_S = 1.0  # length of the parts of a track, whose velocities are averaged [s]


def vsl_um_s(times: Floats, places: Floats) -> float | None:
    """Return the velocity along the straight line [um/s] (VSL of the WHO laboratory manual for the
    examination of human semen, 6th edition, 2021) of a track with times (K,) [s] and places (K, 2)
    [um]; None of one place.

    It is the mean over successive parts of WINDOW_S, so that long and short tracks can be compared;
    a shorter track is one part, and what remains after the last part is none.
    """
    if len(times) < 2:
        return None
    velocities = [
        distance_um(places[[first, last]]) / (times[last] - times[first])
        for first, last in pairwise(_ends(times))
    ]
    return float(np.mean(velocities))


def _ends(times: Floats) -> list[int]:
    """Return the indices of the pictures at which successive parts of a track end, from the first:
    those nearest to each WINDOW_S.
    """
    step = float(np.median(np.diff(times)))
    ends = [0]
    while times[ends[-1]] + WINDOW_S < times[-1] + step / 2:
        due = times[ends[-1]] + WINDOW_S
        nearest = int(np.abs(times - due).argmin())
        ends.append(max(nearest, ends[-1] + 1))
    return ends if len(ends) > 1 else [0, len(times) - 1]


def distance_um(places: Floats) -> float:
    """Return the distance [um] along places (K, 2) [um]."""
    steps = np.diff(places, axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())
