"""Decides whether tracked objects swim, or only diffuse like beads in water.

Over a time t, the mean square displacement of a swimmer grows with t^2, and that of a bead with t.
Let a and b be displacements over two successive times of equal length. Then

    |a + b|^2 = |a|^2 + |b|^2 + 2 a.b

A straight swimmer has a.b = |a||b|, so its displacement doubles. For a bead, the mean of a.b is 0.

If images are rare, a swimmer may turn by any angle from one image to the next. It is then known by
its steps, which have similar lengths. The lengths of a bead's steps vary by half of their mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats

COSINE_MIN = 0.5
"""Minimum mean cosine between successive displacements of an object that keeps its direction.

The mean is weighted by the lengths of the displacements. Beads in water have a mean cosine of .23,
Euglena of .78, Paramecium of .92.
"""
KEEPING_FRACTION_MIN = 1 / 3
"""Minimum fraction of objects that must keep their direction. Below it, nothing seems to swim.

In a simulation of 2,000 beads, seen in 20 to 40 images, a fraction of .00 to .21 seems to keep its
direction if a step is at least a tenth of a bead's length. Up to .57 of slower beads do, but few of
these are examined, because most do not move far enough.
"""
DISPLACEMENT_MAX_S = 1.0
"""Maximum duration of the displacements that are compared [s].

Over longer times, swimmers turn. Over shorter times, the scatter of positions dominates.
"""
PAIRS_MIN = 10
"""Minimum number of independent pairs of displacements for a mean cosine."""
STEP_SCATTER_MAX = 0.2
"""Maximum relative scatter of the lengths of steps that count as equally long.

The relative scatter is the standard deviation of the lengths from image to image, divided by their
mean. In simulations of 2,000 tracks of 40 steps for each kind of object, beads have .28 or more,
and beads whose long steps a tracking program does not link have .23 or more. Swimmers that turn by
2.2 rad/s, filmed at 1 Hz, have .09 or less, or .13 to .31 if their speed varies by a fifth.
"""
STEPS_MIN = 40
"""Minimum number of steps of a track for a check whether its steps are equally long."""
TO_AND_FRO = "nothing swims: everything that moves goes back and forth, as beads do"


@dataclass(frozen=True, slots=True)
class Persistence:
    """The agreement in direction between successive displacements of an object.

    Attributes:
        product_sum: Sum of the scalar products of successive displacements.
        product_max: The maximum that this sum can have: the sum of the products of their lengths.
    """

    product_sum: float
    product_max: float

    @property
    def keeps_direction(self) -> bool:
        """Whether successive displacements mostly point in the same direction."""
        return self.product_sum >= COSINE_MIN * self.product_max


def measure_persistence(places: Floats, n_steps: int) -> Persistence:
    """Compare the directions of successive displacements along a path.

    Args:
        places: Positions, shape (K, 2).
        n_steps: Number of steps in a displacement.
    """
    displacements = places[n_steps:] - places[:-n_steps]
    earlier = displacements[:-n_steps]
    later = displacements[n_steps:]
    length_product = np.linalg.norm(earlier, axis=1) @ np.linalg.norm(later, axis=1)
    scalar_product = float(np.vdot(earlier, later))
    return Persistence(scalar_product, float(length_product))


def hardly_any_keeps_direction(keeps_direction: Sequence[bool]) -> bool:
    """Check whether less than a fraction KEEPING_FRACTION_MIN of some objects keep their direction.

    Args:
        keeps_direction: For each object, whether it keeps its direction. If there is no object,
            the result is False.
    """
    return sum(keeps_direction) < KEEPING_FRACTION_MIN * len(keeps_direction)


def track_keeps_direction(times: Floats, places: Floats) -> bool:
    """Check whether a tracked object swims: it keeps its direction, or its steps are equally long.

    The directions of displacements over several durations are compared. One duration over which the
    object keeps its direction is enough.

    Args:
        times: Times [s], shape (K,).
        places: Positions, shape (K, 2).
    """
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if len(lengths) >= STEPS_MIN and lengths.std() < STEP_SCATTER_MAX * lengths.mean():
        return True
    step_s = float(np.median(np.diff(times)))
    n_steps_limit = round(DISPLACEMENT_MAX_S / step_s)
    n_steps_max = max(1, min(n_steps_limit, len(times) // PAIRS_MIN))
    persistences = [measure_persistence(places, n_steps) for n_steps in range(1, n_steps_max + 1)]
    return any(persistence.keeps_direction for persistence in persistences)
