"""Specks: objects in a dish that are tracked until their motion shows that they are cells."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.organisms import Organism

BLOBS_TO_JUDGE = 5
"""Number of blobs of a speck from which its motion is judged."""
WHOLE_BLOBS_MIN = 3
"""Minimum number of the judged blobs that the edge of the image does not cut off."""
DISPLACEMENT_MIN = 0.23
"""Minimum distance between the first and the last judged blob of a cell [body lengths]."""
DEVIATION_MAX = 0.1
"""Maximum root mean square distance of the judged blobs from uniform motion [body lengths]."""
BLOBS_FOR_VELOCITY = 4
"""Number of the newest blobs from which the velocity of an object is computed."""
EXTRAPOLATION_MAX_S = 0.1
"""Time without a blob after which an object is expected where it was last seen [s]."""
SIZE_VARIATION_MAX = 0.2
"""Maximum relative standard deviation of a cell's length and width."""


@dataclass(slots=True, eq=False)
class Speck:
    """An object in a dish that has not swum yet, and may be a cell or debris.

    Attributes:
        number: Its number.
        path: Its newest blobs.
        first_near: The cell near which it was first seen. None if there was none.
        missed_s: Time since its last blob [s].
    """

    number: int
    path: list[PathBlob]
    first_near: CellTrack | None = None
    missed_s: float = 0.0

    def position_at(self, seconds: float) -> tuple[float, float]:
        """Extrapolate the speck's motion to a time [s], and return the position x, y [um].

        After EXTRAPOLATION_MAX_S without a blob, the position stays at the last blob.
        """
        newest = self.path[-1]
        if len(self.path) < 2 or self.missed_s > EXTRAPOLATION_MAX_S:
            return newest.x, newest.y
        earlier = self.path[max(0, len(self.path) - BLOBS_FOR_VELOCITY)]
        ratio = (seconds - newest.seconds) / max(newest.seconds - earlier.seconds, 1e-3)
        return newest.x + (newest.x - earlier.x) * ratio, newest.y + (newest.y - earlier.y) * ratio

    def move_by(self, x: float, y: float) -> None:
        """Shift the recorded path by x and y [um], after the camera has moved by this distance."""
        self.path = [blob.moved(x, y) for blob in self.path]


def is_swimming(blobs: Sequence[PathBlob], organism: Organism) -> bool:
    """Check whether an object is a swimming organism.

    Its newest BLOBS_TO_JUDGE blobs must have the organism's size, and move fast and straight.
    """
    path = np.array(blobs[-BLOBS_TO_JUDGE:])
    body_um = organism.body_um[0]
    displacement_um = math.hypot(*(path[-1, 1:3] - path[0, 1:3]))
    elapsed_s = path[-1, 0] - path[0, 0]
    if len(path) < BLOBS_TO_JUDGE or displacement_um < max(
        DISPLACEMENT_MIN * body_um, organism.slowest_um_s * elapsed_s
    ):
        return False
    if np.isfinite(path[:, 4]).sum() < WHOLE_BLOBS_MIN:
        return False
    length_um, width_um = compute_median_size(path)
    (length_min_um, length_max_um), (width_min_um, width_max_um) = organism.outline_um
    if not (length_min_um < length_um < length_max_um and width_min_um < width_um < width_max_um):
        return False
    _, line_um = fit_uniform_motion(path)
    deviation_um = np.sqrt(np.mean(np.square(path[:, 1:3] - line_um)))
    has_steady_size = bool(
        (
            np.nanstd(path[:, 4:6], axis=0)
            < (SIZE_VARIATION_MAX * length_um, SIZE_VARIATION_MAX * width_um)
        ).all()
    )
    return bool(has_steady_size and deviation_um < DEVIATION_MAX * body_um)


def compute_median_size(path: Floats) -> BodySize:
    """Compute the median size of the blobs of a path (M, 6) that are not cut off.

    At least one must not be.
    """
    is_whole = np.isfinite(path[:, 4])
    length_um, width_um = np.median(path[is_whole, 4:6], axis=0).tolist()
    return BodySize(length_um, width_um)


def fit_uniform_motion(path: Floats) -> tuple[tuple[float, float], Floats]:
    """Fit a uniform motion to a path by least squares.

    Args:
        path: Time [s], x and y [um], shape (M, 3) or wider.

    Returns:
        The velocity x, y [um/s], and the fitted positions, shape (M, 2) [um].
    """
    mean = path[:, :3].mean(axis=0)
    times = path[:, 0] - mean[0]
    offsets_um = path[:, 1:3] - mean[1:]
    speed_x, speed_y = (times @ offsets_um / (times @ times)).tolist()
    return (speed_x, speed_y), mean[1:] + times[:, None] * (speed_x, speed_y)
