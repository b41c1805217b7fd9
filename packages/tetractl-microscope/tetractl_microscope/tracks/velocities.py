"""Computes velocities of a track from its positions only, without a model of how a cell swims."""

from itertools import pairwise

import numpy as np

from tetractl.core.poses import Floats

WINDOW_S = 1.0  # duration of the parts of a track whose velocities are averaged [s]


def compute_vsl_um_s(times: Floats, places: Floats) -> float | None:
    """Compute the straight-line velocity (VSL) of a cell along its track [um/s].

    It is defined in the WHO laboratory manual for the examination of human semen, 6th edition,
    2021. It is the mean over successive parts of WINDOW_S, so that long and short tracks can be
    compared. A shorter track is one part. What remains after the last part does not count.

    Args:
        times: Times [s], shape (K,).
        places: Positions [um], shape (K, 2).

    Returns:
        The velocity. None for a single position.
    """
    if len(times) < 2:
        return None
    velocities = [
        measure_path_um(places[[start, stop]]) / (times[stop] - times[start])
        for start, stop in pairwise(_find_part_ends(times))
    ]
    return float(np.mean(velocities))


def _find_part_ends(times: Floats) -> list[int]:
    """Split a track into parts of about WINDOW_S, and return the indices of their end images.

    Each part ends with the image nearest to WINDOW_S after its start. The first image is included.
    """
    step_s = float(np.median(np.diff(times)))
    part_ends = [0]
    while times[part_ends[-1]] + WINDOW_S < times[-1] + step_s / 2:
        due_s = times[part_ends[-1]] + WINDOW_S
        nearest = int(np.abs(times - due_s).argmin())
        part_ends.append(max(nearest, part_ends[-1] + 1))
    return part_ends if len(part_ends) > 1 else [0, len(times) - 1]


def measure_path_um(places: Floats) -> float:
    """Compute the length of a path through positions (K, 2) [um]. It is 0 for a single position."""
    steps = np.diff(places, axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())
