"""The time and size of the newest image, and the conversion between pixels and positions.

Column c and row r are at x = (c + 1/2) um_px and, because y points up, at y = (height - 1/2 - r)
um_px.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.detect_cells import Blob

GAP_MIN_S = 0.1  # minimum time without a blob that is conclusive about an object
# Time without a blob that a single missing image explains, in times between two images.
GAP_PERIODS = 1.5


@dataclass(frozen=True, slots=True)
class NewestImage:
    """The time and scale of the newest image.

    Attributes:
        seconds: Its time [s].
        since_previous_s: Time since the previous image [s].
        um_px: Its scale [um/px].
        height: Its height [px].
        width: Its width [px].
    """

    seconds: float
    since_previous_s: float
    um_px: float
    height: int
    width: int

    @property
    def short_gap_s(self) -> float:
        """Time for which a cell may have no blob only because an image is missing [s]."""
        return max(GAP_MIN_S, GAP_PERIODS * self.since_previous_s)

    def edge_distance_um(self, x: float, y: float) -> float:
        """Compute the distance of a position from the nearest edge of the image [um].

        The distance is negative outside the image.
        """
        return min(x, y, self.width * self.um_px - x, self.height * self.um_px - y)

    def places_of(self, blobs: Sequence[Blob]) -> Floats:
        """Convert B blobs to x, y [um], axis [rad], length and width [um], shape (B, 5).

        The origin is the image's lower left corner, y points up, and angles are
        anticlockwise.
        """
        um_px = self.um_px
        places = [
            (
                (blob.x + 0.5) * um_px,
                (self.height - 0.5 - blob.y) * um_px,
                -blob.axis,
                blob.length * um_px,
                blob.width * um_px,
            )
            for blob in blobs
        ]
        return np.array(places).reshape(-1, 5)

    def points_of(self, blob: Blob) -> Floats:
        """Compute x and y of a blob's M pixels from the image's lower left corner, (M, 2) [um]."""
        columns, rows = blob.pixels.T
        return np.column_stack([columns + 0.5, self.height - 0.5 - rows]) * self.um_px

    def pixels_of(self, places: Floats) -> Floats:
        """Convert positions (N, >= 2) [um] to columns and rows, shape (N, 2) [px].

        Columns after the first two are ignored.
        """
        return pixels_of(places, self.um_px, self.height)


def pixels_of(places: Floats, um_px: float, height: int) -> Floats:
    """Convert positions to columns and rows of an image, shape (N, 2).

    Args:
        places: The places, shape (N, >= 2) [um].
        um_px: Scale of the image [um/px].
        height: Number of rows of the image.
    """
    return np.column_stack([places[:, 0] / um_px - 0.5, height - 0.5 - places[:, 1] / um_px])
