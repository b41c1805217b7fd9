"""Steps between the measured poses of a robot, and regressions that resist outliers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, wrap

REWEIGHTING_ROUNDS = 20
"""Number of times that `fit_robust_gains` reweights its least squares."""
DEVIATION_RATIO_MIN = 1e-4
"""Minimum deviation that counts in `fit_robust_gains`, relative to the mean measurement."""
STD_OF_MEDIAN = 1.48
"""Standard deviation of normal numbers, relative to the median of their absolute values."""

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class PoseSteps:
    """The S steps from each pose of a robot to the next one.

    Attributes:
        duration_s: Duration of each step, shape (S,) [s].
        displacement: Complex distance travelled in each step, shape (S,) [length unit]. The real
            part points along the mean heading of the step, and the imaginary part to the left. The
            length is measured along an arc that turns as far as the robot did.
        turn_rad: Change of the heading in each step, shape (S,) [rad].
    """

    duration_s: Floats
    displacement: Complex
    turn_rad: Floats

    @classmethod
    def from_poses(cls, times: Floats, poses: Floats) -> "PoseSteps":
        """Compute the steps between poses (S + 1, 3) at times (S + 1,) [s].

        The robot is assumed to travel along an arc, so a step is a length along it and to
        its left.
        """
        x, y, heading = poses.T
        turn_rad = np.asarray(wrap(np.diff(heading)), dtype=np.float64)
        chord_of_arc = np.sinc(turn_rad / (2 * np.pi))
        displacement = (
            np.diff(x + 1j * y) * np.exp(-1j * (heading[:-1] + turn_rad / 2)) / chord_of_arc
        )
        return cls(np.diff(times), displacement, turn_rad)

    @classmethod
    def concatenate(cls, steps_by_track: Sequence["PoseSteps"]) -> "PoseSteps":
        """Join the steps of several tracks, one track after another."""
        return cls(
            np.concatenate([part.duration_s for part in steps_by_track]),
            np.concatenate([part.displacement for part in steps_by_track]),
            np.concatenate([part.turn_rad for part in steps_by_track]),
        )

    def select(self, is_selected: Bools) -> "PoseSteps":
        """Select the steps for which `is_selected` (S,) is True."""
        return PoseSteps(
            self.duration_s[is_selected], self.displacement[is_selected], self.turn_rad[is_selected]
        )


def fit_robust_gains(measured: NDArray[np.inexact], causes: Floats) -> NDArray[np.inexact]:
    """Fit measurements (S,) as a sum of causes (S, K), minimising the sum of absolute deviations.

    Returns:
        The gains, shape (K,), computed by least squares that are reweighted repeatedly.
    """
    cause_scale = np.abs(causes).sum(axis=0) + 1e-300
    scaled_causes = causes / cause_scale
    deviation_min = DEVIATION_RATIO_MIN * np.abs(measured).mean() + 1e-300
    gains = np.linalg.lstsq(scaled_causes, measured)[0]
    for _ in range(REWEIGHTING_ROUNDS):
        weight = np.maximum(np.abs(measured - scaled_causes @ gains), deviation_min) ** -0.5
        gains = np.linalg.lstsq(scaled_causes * weight[:, None], measured * weight)[0]
    return gains / cause_scale
