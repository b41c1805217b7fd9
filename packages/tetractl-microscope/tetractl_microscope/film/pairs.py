"""Cells that were in another cell's blob before they were first seen: both have been in that blob
since it was too large for one of them.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.match import LARGE
from tetractl_microscope.cells.names import LIKELIER
from tetractl_microscope.film.who import Parting, TrackRow, Whereabouts, row_from

APART_S = 0.5  # time after a parting whose blobs give the two cells' sizes
SEEN = 3  # successive blobs that are too large for one cell
SPREAD = 5.0  # least excess of ln of their areas, in deviations of a cell's blobs in the film
CUT_S = 0.5  # time before these blobs for which the picture's edge may have cut the cells off
LASTS_S = 0.4  # shortest part of a path that has names
MEDIAN_OF_NORMAL = 0.6745  # median absolute deviation of a normal distribution [sd]
APART = 0.15  # least distance of a cell from the middle of a blob that tells two cells [lengths]


@dataclass(frozen=True, slots=True)
class PartedTracks:
    """The rows of two tracks that part in a picture: `newcomer[newcomer_row]` is the first row of
    the one that comes out, `old[old_row]` that of the other one in the same picture.
    """

    newcomer: list[TrackRow]
    newcomer_row: int
    old: list[TrackRow]
    old_row: int


@dataclass(frozen=True, slots=True)
class PairInBlob:
    """The `middle` (2,) [um] and the axis [rad] of a blob that shows two cells, and the way from
    there to the newcomer, `half` (2,) [um]; the other cell is as far on the other side.
    """

    middle: Floats
    axis: float
    half: Floats


def fill_pairs(where: Whereabouts, body_um: float) -> set[int]:
    """Add cells to the earlier pictures in which another cell's blob showed both. Cells are
    `body_um` long. Returns the tracks of the cells that were added.

    Each cell is then as far from the middle of the blob as the excess of the blob's second moment
    over a cell's says, along the blob or across it. Which of the two is which is not known: both
    have names of their own, and others after each time when they could not be distinguished.
    """
    larger = max(LARGE, math.exp(SPREAD * _spread_of_areas(where)))
    names = where.new_names()
    return {
        parting.track
        for parting in where.partings
        if _fill(where, parting, larger, APART * body_um, names)
    }


def _spread_of_areas(where: Whereabouts) -> float:
    """Return the standard deviation of ln of the area of one cell's blobs, by their median absolute
    deviation; 0 without blobs.
    """
    deviations: list[Floats] = []
    for rows in where.tracks.values():
        areas = _areas(rows)
        if areas:
            relative = np.array(areas) / np.median(areas)
            deviations.append(np.abs(np.log(relative)))
    if not deviations:
        return 0.0
    return float(np.median(np.concatenate(deviations))) / MEDIAN_OF_NORMAL


def _fill(
    where: Whereabouts,
    parting: Parting,
    larger: float,
    apart_um: float,
    names: Iterator[int],
) -> bool:
    """Add a cell to the pictures before its parting; return whether it was. A blob that is `larger`
    than one cell shows two; nearer than `apart_um` [um] to its middle they cannot be distinguished.
    """
    parted = _parted(where, parting)
    if parted is None:
        return False
    apart_until = where.index(where.times[parting.picture] + APART_S)
    newcomer_sizes = _sizes_until(parted.newcomer, parted.newcomer_row, apart_until)
    old_sizes = _sizes_until(parted.old, parted.old_row, apart_until)
    if not newcomer_sizes or not old_sizes:
        return False
    sizes = [np.median(newcomer_sizes, axis=0), np.median(old_sizes, axis=0)]
    larger_um2 = max(math.prod(size) for size in sizes)
    areas_then = _areas(where.shown_in(parting.picture).values()) or [0.0]
    one_um2 = max(larger_um2, float(np.median(areas_then)))
    since = _both_since(parted.old, parted.old_row, larger * one_um2, where.times)
    together_s = where.times[parting.picture] - where.times[parted.old[since].picture]
    if together_s < LASTS_S:
        return False
    added = _divide(where.times, parted, since, np.mean(sizes, axis=0), apart_um, names)
    parted.newcomer[parted.newcomer_row : parted.newcomer_row] = added
    return True


def _parted(where: Whereabouts, parting: Parting) -> PartedTracks | None:
    """Return the two tracks of a parting, unless the old one was not seen in the picture before, or
    is not seen in that of the parting.
    """
    newcomer = where.tracks[parting.track]
    old = where.tracks[parting.near]
    newcomer_row = row_from(newcomer, parting.picture)
    old_row = row_from(old, parting.picture)
    pictures = [row.picture for row in old[max(old_row - 1, 0) : old_row + 1]]
    if pictures != [parting.picture - 1, parting.picture]:
        return None
    return PartedTracks(newcomer, newcomer_row, old, old_row)


def _both_since(rows: list[TrackRow], end: int, least_um2: float, times: Sequence[float]) -> int:
    """Return the index of the row since which a track's blob has shown two cells, before the row
    `end`; `end` if it has not.

    SEEN successive blobs of more than `least_um2` [um^2] show two. Pictures without the track
    separate it from what was before; if the blob was large soon after them, it showed two at once.
    """
    start = end - 1
    while start > 0 and rows[start - 1].picture == rows[start].picture - 1:
        start -= 1
    measured = [(k, um2 > least_um2) for k in range(start, end) for um2 in _areas([rows[k]])]
    for i in range(len(measured) - SEEN + 1):
        if all(is_large for _, is_large in measured[i : i + SEEN]):
            first, _ = measured[i]
            is_soon = times[rows[first].picture] - times[rows[start].picture] <= CUT_S
            return start if is_soon else first
    return end


def _divide(
    times: Sequence[float],
    parted: PartedTracks,
    since: int,
    size: Floats,
    apart_um: float,
    names: Iterator[int],
) -> list[TrackRow]:
    """Divide the blobs of the old track, from its row `since` to the parting, between two cells of
    a `size` (2,) [um]: change that track's rows, and return the newcomer's.

    It goes back in time, so that the two are on the sides on which they are after the parting. Once
    they were nearer than `apart_um` [um] to the middle they get new names, for parts that last.
    """
    newcomer = parted.newcomer[parted.newcomer_row]
    old = parted.old[parted.old_row]
    since_s = times[parted.old[since].picture]
    until_s = times[old.picture]  # the names of the part that is being divided are for until then
    newcomer_name = next(names)
    old_name = next(names)
    side = np.array((newcomer.cell.x - old.cell.x, newcomer.cell.y - old.cell.y))
    were_hidden = False
    added = list[TrackRow]()
    for row in reversed(parted.old[since : parted.old_row]):
        pair = _pair_in(row, size, side)
        half = pair.half
        if half.any():
            side = half
        if math.hypot(*half) <= apart_um:
            were_hidden = True
        elif were_hidden:
            row_s = times[row.picture]
            if min(until_s - row_s, row_s - since_s) > LASTS_S:
                newcomer_name = next(names)
                old_name = next(names)
                until_s = row_s
                were_hidden = False
        in_pair = replace(row.cell, axis=pair.axis, merged=True, measured=None)
        newcomer_cell = _moved(in_pair, pair.middle + half, newcomer.cell.track)
        added.append(TrackRow(row.picture, newcomer_cell, newcomer_name, LIKELIER))
        row.cell = _moved(in_pair, pair.middle - half, row.cell.track)
        row.name = old_name
        row.likely = LIKELIER
    return added[::-1]


def _pair_in(row: TrackRow, size: Floats, side: Floats) -> PairInBlob:
    """Return where two cells of a `size` (2,) [um] are in a row's blob, the newcomer on the given
    `side` (2,); in the middle if the row has no blob whose size is known.
    """
    blob = row.cell.blob_um
    if blob is None or not _sizes([row]):
        return PairInBlob(np.array((row.cell.x, row.cell.y)), row.cell.axis, np.zeros(2))
    half = _half(blob, size)
    return PairInBlob(blob[:2], blob[2], -half if half @ side < 0 else half)


def _moved(cell: SeenCell, place: Floats, track: int) -> SeenCell:
    """Return a cell at another place (2,) [um], as seen on a track."""
    x, y = place
    return replace(cell, x=x, y=y, track=track)


def _half(blob: Floats, size: Floats) -> Floats:
    """Return half of the distance (2,) [um] of two cells of a `size` (2,) [um] in their blob."""
    axis = blob[2]
    along, across = np.sqrt(np.maximum(blob[3:] ** 2 - size**2, 0.0)) / 4
    if across > along:
        return across * np.array((-math.sin(axis), math.cos(axis)))
    return along * np.array((math.cos(axis), math.sin(axis)))


def _sizes_until(rows: list[TrackRow], first: int, picture: int) -> list[Floats]:
    """Return the sizes of a track's blobs from a row on, before a picture."""
    return _sizes(rows[first : row_from(rows, picture)])


def _areas(rows: Iterable[TrackRow]) -> list[float]:
    """Return length times width [um^2] of the blobs that show one track, as a whole."""
    return [math.prod(size) for size in _sizes(rows)]


def _sizes(rows: Iterable[TrackRow]) -> list[Floats]:
    """Return length and width (2,) [um] of the blobs that show one track, as a whole."""
    cells = (row.cell for row in rows)
    blobs = [cell.blob_um for cell in cells if cell.blob_um is not None and not cell.merged]
    return [blob[3:] for blob in blobs if math.isfinite(blob[4])]
