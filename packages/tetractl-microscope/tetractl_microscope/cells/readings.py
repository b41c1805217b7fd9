"""Converts blobs to measurements of the cells that they show."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells import match
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack, TrackBlob
from tetractl_microscope.cells.match import LARGE
from tetractl_microscope.cells.picture_now import PictureNow
from tetractl_microscope.cells.specks import median_size


class Spread(NamedTuple):
    """Standard deviations of a measurement from a blob.

    Attributes:
        position: Standard deviation of the position [lengths of a cell].
        axis: Standard deviation of the axis [rad].
    """

    position: float
    axis: float


# standard deviations of a blob's measured position
POSITION_PX = 0.2
POSITION_UM = 0.4
AXIS = 0.02
# for a blob that is cut off, too large or too small; for a shared blob; and for a shared blob that
# is only as large as one of its cells
UNUSUAL = Spread(0.15, 0.5)
MERGED = Spread(0.13, 10.0)
HIDDEN = Spread(0.57, 10.0)
ROUND = 0.01  # least elongation of a blob, 1 - width / length, of which the axis says something
OFF_SHARE = 0.3  # deviation of a cell's position per excess length of its blob
LONGER = 1.35  # ratio of blob to cell length above which it shows two cells in a row
GROWN_S = 1.0  # time for which a blob has another size than its cell, which then is the cell's
SHAPE_SHARE = 0.05  # weight of a new blob in a cell's usual size
PATH = 15  # number of newest blobs of a track that are kept


@dataclass(frozen=True, slots=True)
class BlobReading:
    """A measurement of a cell from its newest blob.

    Attributes:
        cell: The cell's track.
        newest: The blob.
        values: x, y [um] and axis [rad].
        deviations: Their standard deviations.
    """

    cell: CellTrack
    newest: TrackBlob
    values: tuple[float, float, float]
    deviations: tuple[float, float, float]


def note_own_blob(cell: CellTrack, newest: TrackBlob, seconds: float) -> None:
    """Add a cell's own blob to its path, and check its size.

    The blob may be too large for the cell, or the cell may have another size than was assumed.

    Args:
        cell: The cell's track.
        newest: The blob.
        seconds: Time of the image [s].
    """
    blob = PathBlob(seconds, *newest.place.tolist())
    size = BodySize(blob.long, blob.wide)
    cell.path = [*cell.path[1 - PATH :], blob]
    if 1 / LARGE <= size.area_um2 / cell.size.area_um2 <= LARGE:
        cell.size_seen_s = seconds
    elif seconds - cell.size_seen_s > GROWN_S:
        # nothing else has left the blob: this is its size
        cell.size = median_size(np.array(cell.path))
    has_two_areas = size.area_um2 > LARGE * cell.size.area_um2
    newest.is_large = has_two_areas or size.long > LONGER * cell.size.long


def note_own_reading(reading: BlobReading) -> None:
    """Update the size of a cell from its own blob, unless the blob is unusual."""
    cell = reading.cell
    newest = reading.newest
    if not _is_unusual(cell, newest):
        _, _, _, long, wide = newest.place.tolist()
        cell.size = BodySize(
            cell.size.long + SHAPE_SHARE * (long - cell.size.long),
            cell.size.wide + SHAPE_SHARE * (wide - cell.size.wide),
        )


def _is_unusual(cell: CellTrack, newest: TrackBlob) -> bool:
    """Check whether a cell's own blob is too large or too small for the cell, or cut off.

    It is cut off if it touches the image's edge.
    """
    _, _, _, long, wide = newest.place.tolist()
    is_smaller = long * wide < cell.size.area_um2 / LARGE**2
    return newest.is_large or is_smaller or newest.blob.at_edge


def own_reading(
    cell: CellTrack, newest: TrackBlob, expected: Floats, now: PictureNow, body_um: float
) -> BlobReading:
    """Compute the measurement of a cell from its own blob.

    A blob that is too large also shows another object, which is on the opposite side of the blob's
    centre from the cell.

    Args:
        cell: The cell's track.
        newest: The blob.
        expected: Expected x, y [um] and axis [rad], shape (3,).
        now: The newest image.
        body_um: Length of a body [um].
    """
    x, y, axis, long, wide = newest.place.tolist()
    if not _is_unusual(cell, newest):
        min_um = POSITION_UM + POSITION_PX * now.um_px
        axis_sd = AXIS / max(1 - wide / long, ROUND)
        return BlobReading(cell, newest, (x, y, axis), (min_um, min_um, axis_sd))
    if newest.is_large and not newest.blob.at_edge:
        opposite = (*(2 * newest.place[:2] - expected[:2]), axis)
        points = now.points_of(newest.blob)
        centres = match.centres_in_blob([cell, cell], np.array([expected, opposite]), points)
        x, y = centres[0].tolist()
        sd_um = MERGED.position * body_um
    else:
        sd_um = max(UNUSUAL.position * body_um, OFF_SHARE * (long - cell.size.long))
    return BlobReading(cell, newest, (x, y, axis), (sd_um, sd_um, UNUSUAL.axis))


def shared_readings(
    cells: Sequence[CellTrack],
    newest: TrackBlob,
    expected: Floats,
    now: PictureNow,
    body_um: float,
) -> list[BlobReading]:
    """Compute the measurements of K cells from the blob that they share.

    Args:
        cells: The cells' tracks.
        newest: The blob.
        expected: Expected x, y [um] and axis [rad] of each cell, shape (K, 3).
        now: The newest image.
        body_um: Length of a body [um].
    """
    long, wide = newest.place[3:]
    is_as_one_cell = long * wide < LARGE * max(cell.size.area_um2 for cell in cells)
    spread = HIDDEN if is_as_one_cell else MERGED
    sd_um = spread.position * body_um
    points = now.points_of(newest.blob)
    middles = match.centres_in_blob(cells, expected, points).tolist()
    return [
        BlobReading(cell, newest, (x, y, axis), (sd_um, sd_um, spread.axis))
        for cell, axis, (x, y) in zip(cells, expected[:, 2].tolist(), middles, strict=True)
    ]
