"""Specks: objects in a dish that are tracked until they swim, and are then known to be cells."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.organisms import Organism

BORN = 5  # number of blobs after which a speck may be a cell
WHOLE = 3  # fewest of these blobs that the picture's edge does not cut off
SWUM = 0.23  # least way over these blobs [lengths]
STRAY = 0.1  # largest distance of them from a line [lengths]
MOTION = 4  # newest blobs that tell an object's motion
STOPPED_S = 0.1  # time without a blob after which an object is expected where it was
EVEN = 0.2  # relative variation of a cell's size


@dataclass(slots=True, eq=False)
class Speck:
    """An object that has not swum yet.

    Attributes:
        number: Its number.
        path: Its newest blobs.
        near: The cell near which it was first seen. None if there was none.
        missed_s: Time since its last blob [s].
    """

    number: int
    path: list[PathBlob]
    near: CellTrack | None = None
    missed_s: float = 0.0

    def ahead(self, seconds: float) -> tuple[float, float]:
        """Extrapolate the speck's motion to a time [s], and return the position x, y [um].

        After STOPPED_S without a blob, it is the last position.
        """
        last = self.path[-1]
        if len(self.path) < 2 or self.missed_s > STOPPED_S:
            return last.x, last.y
        first = self.path[max(0, len(self.path) - MOTION)]
        ratio = (seconds - last.seconds) / max(last.seconds - first.seconds, 1e-3)
        return last.x + (last.x - first.x) * ratio, last.y + (last.y - first.y) * ratio

    def shift(self, x: float, y: float) -> None:
        """Shift the recorded path by x and y [um], after the camera has moved by this distance."""
        self.path = [blob.moved(x, y) for blob in self.path]


def swims(entries: Sequence[PathBlob], organism: Organism) -> bool:
    """Check whether an object is a swimming organism.

    Its newest BORN blobs must have the organism's size, and move fast and straight.
    """
    path = np.array(entries[-BORN:])
    body_um = organism.body_um[0]
    moved = math.hypot(*(path[-1, 1:3] - path[0, 1:3]))
    passed = path[-1, 0] - path[0, 0]
    if len(path) < BORN or moved < max(SWUM * body_um, organism.slowest_um_s * passed):
        return False
    if np.isfinite(path[:, 4]).sum() < WHOLE:
        return False
    long, wide = usual_size(path)
    (short, longest), (thin, thick) = organism.outline_um
    if not (short < long < longest and thin < wide < thick):
        return False
    _, fitted = straight(path)
    strayed = np.sqrt(np.mean(np.square(path[:, 1:3] - fitted)))
    even = bool((np.nanstd(path[:, 4:6], axis=0) < (EVEN * long, EVEN * wide)).all())
    return bool(even and strayed < STRAY * body_um)


def usual_size(path: Floats) -> BodySize:
    """Compute the median size of the blobs of a path (M, 6) that are not cut off.

    At least one must not be.
    """
    is_whole = np.isfinite(path[:, 4])
    long, wide = np.median(path[is_whole, 4:6], axis=0).tolist()
    return BodySize(long, wide)


def straight(path: Floats) -> tuple[tuple[float, float], Floats]:
    """Fit a uniform motion to a path by least squares.

    Args:
        path: Time [s], x and y [um], shape (M, 3) or wider.

    Returns:
        The velocity x, y [um/s], and the fitted positions, shape (M, 2) [um].
    """
    middle = path[:, :3].mean(axis=0)
    times = path[:, 0] - middle[0]
    off = path[:, 1:3] - middle[1:]
    vx, vy = (times @ off / (times @ times)).tolist()
    return (vx, vy), middle[1:] + times[:, None] * (vx, vy)
