"""Converts blobs to measurements of the cells that they show."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells import match
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack, TrackBlob
from tetractl_microscope.cells.match import LARGE_AREA_RATIO
from tetractl_microscope.cells.picture_now import NewestImage
from tetractl_microscope.cells.specks import compute_median_size


class MeasurementSd(NamedTuple):
    """Standard deviations of a measurement from a blob.

    Attributes:
        position: Standard deviation of the position [lengths of a cell].
        axis: Standard deviation of the axis [rad].
    """

    position: float
    axis: float


# The standard deviation of a blob's measured position is the sum of these two.
POSITION_SD_PX = 0.2
POSITION_SD_UM = 0.4
# Standard deviation of the axis [rad], times the elongation of the blob.
AXIS_SD = 0.02
UNUSUAL_SD = MeasurementSd(0.15, 0.5)  # for a blob that is cut off, too large or too small
SHARED_SD = MeasurementSd(0.13, 10.0)  # for a blob that several cells share
HIDDEN_SD = MeasurementSd(0.57, 10.0)  # for a shared blob that is only as large as one cell
ELONGATION_MIN = (
    0.01  # least elongation of a blob, 1 - width / length, of which the axis says something
)
EXCESS_SD_FRACTION = 0.3  # deviation of a cell's position per excess length of its blob
TWO_CELLS_LENGTH_RATIO = (
    1.35  # ratio of blob to cell length above which it shows two cells in a row
)
NEW_SIZE_S = 1.0  # time for which a blob has another size than its cell, which then is the cell's
SIZE_WEIGHT = 0.05  # weight of a new blob in a cell's usual size
PATH_BLOBS = 15  # number of newest blobs of a track that are kept


@dataclass(frozen=True, slots=True)
class BlobReading:
    """A measurement of a cell from its newest blob.

    Attributes:
        cell: The cell's track.
        track_blob: The blob.
        values: x, y [um] and axis [rad].
        deviations: Their standard deviations.
    """

    cell: CellTrack
    track_blob: TrackBlob
    values: tuple[float, float, float]
    deviations: tuple[float, float, float]


def record_own_blob(cell: CellTrack, track_blob: TrackBlob, seconds: float) -> None:
    """Add a cell's own blob to the cell's path, and check the size of the blob.

    The blob may be too large for the cell, or the cell may have another size than was assumed.

    Args:
        cell: The cell's track.
        track_blob: The blob.
        seconds: Time of the image [s].
    """
    blob = PathBlob(seconds, *track_blob.place.tolist())
    size = BodySize(blob.length, blob.width)
    cell.path = [*cell.path[1 - PATH_BLOBS :], blob]
    if 1 / LARGE_AREA_RATIO <= size.area_um2 / cell.size.area_um2 <= LARGE_AREA_RATIO:
        cell.size_seen_s = seconds
    elif seconds - cell.size_seen_s > NEW_SIZE_S:
        # nothing else has left the blob: this is its size
        cell.size = compute_median_size(np.array(cell.path))
    has_large_area = size.area_um2 > LARGE_AREA_RATIO * cell.size.area_um2
    track_blob.is_large = has_large_area or size.length > TWO_CELLS_LENGTH_RATIO * cell.size.length


def update_size(reading: BlobReading) -> None:
    """Update the size of a cell from its own blob, unless the blob is unusual."""
    cell = reading.cell
    track_blob = reading.track_blob
    if not _is_unusual(cell, track_blob):
        _, _, _, length, width = track_blob.place.tolist()
        cell.size = BodySize(
            cell.size.length + SIZE_WEIGHT * (length - cell.size.length),
            cell.size.width + SIZE_WEIGHT * (width - cell.size.width),
        )


def _is_unusual(cell: CellTrack, track_blob: TrackBlob) -> bool:
    """Check whether a cell's own blob is too large or too small for the cell, or cut off.

    It is cut off if it touches the image's edge.
    """
    _, _, _, length, width = track_blob.place.tolist()
    is_smaller = length * width < cell.size.area_um2 / LARGE_AREA_RATIO**2
    return track_blob.is_large or is_smaller or track_blob.blob.at_edge


def create_own_reading(
    cell: CellTrack, track_blob: TrackBlob, expected: Floats, image: NewestImage, body_um: float
) -> BlobReading:
    """Compute the measurement of a cell from its own blob.

    A blob that is too large also shows another object, which is on the opposite side of the blob's
    centre from the cell.

    Args:
        cell: The cell's track.
        track_blob: The blob.
        expected: Expected x, y [um] and axis [rad], shape (3,).
        image: The newest image.
        body_um: Length of a body [um].
    """
    x, y, axis, length, width = track_blob.place.tolist()
    if not _is_unusual(cell, track_blob):
        position_sd_um = POSITION_SD_UM + POSITION_SD_PX * image.um_px
        axis_sd = AXIS_SD / max(1 - width / length, ELONGATION_MIN)
        return BlobReading(
            cell, track_blob, (x, y, axis), (position_sd_um, position_sd_um, axis_sd)
        )
    if track_blob.is_large and not track_blob.blob.at_edge:
        opposite = (*(2 * track_blob.place[:2] - expected[:2]), axis)
        points = image.points_of(track_blob.blob)
        centres = match.find_centres_in_blob([cell, cell], np.array([expected, opposite]), points)
        x, y = centres[0].tolist()
        sd_um = SHARED_SD.position * body_um
    else:
        sd_um = max(UNUSUAL_SD.position * body_um, EXCESS_SD_FRACTION * (length - cell.size.length))
    return BlobReading(cell, track_blob, (x, y, axis), (sd_um, sd_um, UNUSUAL_SD.axis))


def create_shared_readings(
    cells: Sequence[CellTrack],
    track_blob: TrackBlob,
    expected: Floats,
    image: NewestImage,
    body_um: float,
) -> list[BlobReading]:
    """Compute the measurements of K cells from the blob that they share.

    Args:
        cells: The cells' tracks.
        track_blob: The blob.
        expected: Expected x, y [um] and axis [rad] of each cell, shape (K, 3).
        image: The newest image.
        body_um: Length of a body [um].
    """
    length, width = track_blob.place[3:]
    has_size_of_one_cell = length * width < LARGE_AREA_RATIO * max(
        cell.size.area_um2 for cell in cells
    )
    measurement_sd = HIDDEN_SD if has_size_of_one_cell else SHARED_SD
    sd_um = measurement_sd.position * body_um
    points = image.points_of(track_blob.blob)
    centres = match.find_centres_in_blob(cells, expected, points).tolist()
    return [
        BlobReading(cell, track_blob, (x, y, axis), (sd_um, sd_um, measurement_sd.axis))
        for cell, axis, (x, y) in zip(cells, expected[:, 2].tolist(), centres, strict=True)
    ]
