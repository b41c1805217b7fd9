"""Steps between the measured poses of a robot, and regressions that resist outliers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, wrap

DEVIATIONS_ROUNDS = 20
LEAST_DEVIATION = 1e-4
"""Minimum deviation in `robust_gains`, relative to the mean measurement.

DEVIATIONS_ROUNDS is the number of its rounds.
"""
STD_OF_MEDIAN = 1.48
"""Standard deviation of normal numbers, relative to the median of their magnitudes."""

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class PoseSteps:
    """The S steps from each pose of a robot to the next one.

    Attributes:
        duration_s: Duration of each step, shape (S,) [s].
        moved: Distance travelled in each step, shape (S,) [length unit]. The real part points along
            the mean heading of the step, the imaginary part to its left. The distance is that of an
            arc that turns as far as the robot did.
        turned: Change of the heading in each step, shape (S,) [rad].
    """

    duration_s: Floats
    moved: Complex
    turned: Floats

    @classmethod
    def between(cls, times: Floats, poses: Floats) -> "PoseSteps":
        """Compute the steps between poses (S + 1, 3) at times (S + 1,) [s].

        The robot is assumed to travel along an arc, so a step is a length along it and to
        its left.
        """
        x, y, heading = poses.T
        turned = np.asarray(wrap(np.diff(heading)), dtype=np.float64)
        chord_of_arc = np.sinc(turned / (2 * np.pi))
        moved = np.diff(x + 1j * y) * np.exp(-1j * (heading[:-1] + turned / 2)) / chord_of_arc
        return cls(np.diff(times), moved, turned)

    @classmethod
    def together(cls, parts: Sequence["PoseSteps"]) -> "PoseSteps":
        """Join the steps of several tracks, one track after another."""
        return cls(
            np.concatenate([part.duration_s for part in parts]),
            np.concatenate([part.moved for part in parts]),
            np.concatenate([part.turned for part in parts]),
        )

    def at(self, rows: Bools) -> "PoseSteps":
        """Return only the steps in which `rows` is True, shape (S,)."""
        return PoseSteps(self.duration_s[rows], self.moved[rows], self.turned[rows])


def robust_gains(measured: NDArray[np.inexact], causes: Floats) -> NDArray[np.inexact]:
    """Fit measurements (S,) as a sum of causes (S, K), minimising the sum of absolute deviations.

    Returns:
        The gains, shape (K,), computed by least squares that are reweighted repeatedly.
    """
    scale = np.abs(causes).sum(axis=0) + 1e-300
    scaled = causes / scale
    least = LEAST_DEVIATION * np.abs(measured).mean() + 1e-300
    gains = np.linalg.lstsq(scaled, measured)[0]
    for _ in range(DEVIATIONS_ROUNDS):
        weight = np.maximum(np.abs(measured - scaled @ gains), least) ** -0.5
        gains = np.linalg.lstsq(scaled * weight[:, None], measured * weight)[0]
    return gains / scale
