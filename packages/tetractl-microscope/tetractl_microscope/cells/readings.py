"""What a blob says of the cell, or of the cells, that it shows."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells import match
from tetractl_microscope.cells.cell import PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.match import LARGE
from tetractl_microscope.cells.specks import usual_size

# standard deviations of a blob's measured position
POSITION_PX = 0.2
POSITION_UM = 0.4
AXIS = 0.02
# deviations of position [lengths of a cell] and axis [rad]: for a blob cut off or too large; in a
# shared blob; and in a shared blob that is only as large as one of its cells
ODD = (0.15, 0.5)
MERGED = (0.13, 10.0)
HIDDEN = (0.57, 10.0)
ROUND = 0.01  # least elongation of a blob, 1 - width / length, of which the axis says something
OFF_SHARE = 0.3  # deviation of a cell's position per excess length of its blob
LONGER = 1.35  # ratio of blob to cell length above which it shows two cells in a row
GROWN_S = 1.0  # time for which a blob has another size than its cell, which then is the cell's
SHAPE_SHARE = 0.05  # weight of a new blob in a cell's usual size
JUMP = 0.25  # change of a new cell's steps, less the usual step, above which it jumped [lengths]
PATH = 15  # number of newest blobs of a track that are kept


@dataclass(frozen=True, slots=True)
class BlobReading:
    """A cell's `values` x, y [um] and axis [rad], and their standard `deviations`."""

    cell: CellTrack
    values: tuple[float, float, float]
    deviations: tuple[float, float, float]


def note_size(cell: CellTrack, place: Floats, seconds: float) -> None:
    """Add a cell's own blob in `place` (5,), as by `match.places_of`, to its path, and note whether
    the blob is too large for the cell, or the cell of another size than was thought.
    """
    x, y, axis, long, wide = place.tolist()
    cell.path = [*cell.path[1 - PATH :], PathBlob(seconds, x, y, axis, long, wide)]
    if 1 / LARGE <= long * wide / (cell.long * cell.wide) <= LARGE:
        cell.sized_s = seconds
    elif seconds - cell.sized_s > GROWN_S:  # nothing else has left the blob: this is its size
        cell.long, cell.wide = usual_size(np.array(cell.path))
    cell.hidden_s = math.inf
    cell.large = long * wide > LARGE * cell.long * cell.wide or long > LONGER * cell.long


def note_shared(cells: Sequence[CellTrack], place: Floats, seconds: float) -> None:
    """Note that cells share a blob in `place` (5,), and since when it has been as small as one of
    them.
    """
    is_small = _is_small(cells, place)
    for cell in cells:
        cell.merged = True
        cell.hidden_s = min(cell.hidden_s, seconds) if is_small else math.inf


def note_own(reading: BlobReading, place: Floats) -> None:
    """Note what a cell's own blob in `place` (5,) said, and its size unless the blob is odd."""
    cell = reading.cell
    cell.measured = (*reading.values, *reading.deviations)
    if not _is_odd(cell, place):
        _, _, _, long, wide = place.tolist()
        cell.long += SHAPE_SHARE * (long - cell.long)
        cell.wide += SHAPE_SHARE * (wide - cell.wide)


def _is_small(cells: Sequence[CellTrack], place: Floats) -> bool:
    """Return whether a shared blob is only as large as one of its cells."""
    return bool(place[3] * place[4] < LARGE * max(cell.long * cell.wide for cell in cells))


def _is_odd(cell: CellTrack, place: Floats) -> bool:
    """Return whether a cell's own blob is too large or too small for it, or cut off."""
    assert cell.blob is not None
    is_smaller = place[3] * place[4] < cell.long * cell.wide / LARGE**2
    return bool(cell.large or is_smaller or cell.blob.at_edge)


def own_path(path: Floats, long: float, wide: float, body_um: float) -> Floats:
    """Return the path (M, 6) of a new cell of a size [um] after the last blob that is too large for
    it, or to which it jumped: another cell was in that blob. Cells are `body_um` long.
    """
    steps = np.diff(path[:, 1:3], axis=0)
    usual_um = float(np.median(np.linalg.norm(steps, axis=1)))
    is_other = path[:-1, 4:6].prod(axis=1) > LARGE * long * wide
    is_other[1:] |= np.linalg.norm(np.diff(steps, axis=0), axis=1) > JUMP * body_um + usual_um
    return path[int(np.flatnonzero(is_other).max(initial=-1)) + 1 :]


def own_reading(
    cell: CellTrack,
    expected: Floats,
    place: Floats,
    um_px: float,
    height: int,
    body_um: float,
) -> BlobReading:
    """Return what a cell's own blob says, in a picture with `height` rows. A blob that is too large
    shows something else, too, on the other side of its middle from where the cell is `expected`
    (3,).
    """
    x, y, axis, long, wide = place.tolist()
    assert cell.blob is not None
    off = max(ODD[0] * body_um, OFF_SHARE * (long - cell.long))
    least = POSITION_UM + POSITION_PX * um_px
    deviations = least, least, AXIS / max(1 - wide / long, ROUND)
    if cell.large and not cell.blob.at_edge:
        points = match.points_of(cell.blob, um_px, height)
        pair = np.array([expected, (*(2 * place[:2] - expected[:2]), axis)])
        x, y = match.parted([cell, cell], pair, points)[0].tolist()
        off = MERGED[0] * body_um
    if _is_odd(cell, place):
        deviations = off, off, ODD[1]
    return BlobReading(cell, (x, y, axis), deviations)


def shared_readings(
    cells: Sequence[CellTrack],
    expected: Floats,
    place: Floats,
    points: Floats,
    body_um: float,
) -> list[BlobReading]:
    """Return what a blob says of the K cells that share it, which are `expected` (K, 3) there."""
    sd, turn = HIDDEN if _is_small(cells, place) else MERGED
    middles = match.parted(cells, expected, points).tolist()
    return [
        BlobReading(cell, (x, y, float(axis)), (sd * body_um, sd * body_um, turn))
        for cell, axis, (x, y) in zip(cells, expected[:, 2], middles, strict=True)
    ]
