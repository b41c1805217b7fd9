"""Cells that were in another cell's blob before they were first seen: both have been in that blob
since it was too large for one of them.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.match import LARGE
from tetractl_microscope.cells.names import LIKELIER
from tetractl_microscope.film.who import Parting, TrackRow, Whereabouts, row_from

APART_S = 0.5  # time after a parting whose blobs give the two cells' sizes
SEEN = 3  # successive blobs that are too large for one cell
SPREAD = 5.0  # least excess of ln of their areas, in deviations of a cell's blobs in the film
CUT_S = 0.5  # time before these blobs for which the picture's edge may have cut the cells off
LASTS_S = 0.4  # shortest part of a path that has names
APART = 0.15  # least distance of a cell from the middle of a blob that tells two cells [lengths]


def fill_pairs(where: Whereabouts, body_um: float) -> set[int]:
    """Add cells to the earlier pictures in which another cell's blob showed both. Cells are
    `body_um` long. Returns the tracks of the cells that were added.

    Each cell is then as far from the middle of the blob as the excess of the blob's second moment
    over a cell's says, along the blob or across it. Which of the two is which is not known: both
    have names of their own, and others after each time when they could not be distinguished.
    """
    areas = [list(map(math.prod, _sizes(rows))) for rows in where.tracks.values()]
    off = [
        np.log(np.array(areas_of_track) / np.median(areas_of_track))
        for areas_of_track in areas
        if areas_of_track
    ]
    spread = float(np.median(np.abs(np.concatenate(off)))) / 0.6745 if off else 0.0
    larger = max(LARGE, math.exp(SPREAD * spread))
    names = where.new_names()
    return {
        parting.track
        for parting in where.partings
        if _fill(where, parting, larger, APART * body_um, names)
    }


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
    first = parting.at
    times = where.times
    news = where.tracks[parting.track]
    olds = where.tracks[parting.near]
    i = row_from(news, first)
    j = row_from(olds, first)
    if [row.at for row in olds[max(j - 1, 0) : j + 1]] != [first - 1, first]:
        return False
    end = where.index(times[first] + APART_S)
    after = [_sizes(rows[k : row_from(rows, end)]) for rows, k in ((news, i), (olds, j))]
    if not all(after):
        return False
    sizes = [np.median(sizes_after, axis=0) for sizes_after in after]
    areas = [math.prod(size) for size in sizes]
    usual = [math.prod(size) for size in _sizes(where.picture(first).values())] or [0.0]
    least = larger * max(*areas, float(np.median(usual)))
    run_start = next(k for k in range(j - 1, -1, -1) if k == 0 or olds[k - 1].at != olds[k].at - 1)
    blob_rows = [
        (k, math.prod(size) > least) for k in range(run_start, j) for size in _sizes([olds[k]])
    ]
    runs = (blob_rows[k : k + SEEN] for k in range(len(blob_rows) - SEEN + 1))
    since = next((run[0][0] for run in runs if all(large for _, large in run)), j)
    if since < j and times[olds[since].at] - times[olds[run_start].at] <= CUT_S:
        since = run_start
    since_s = times[olds[since].at]
    if times[first] - since_s < LASTS_S:
        return False
    new = news[i].cell
    old = olds[j].cell
    apart = np.array((new.x - old.x, new.y - old.y))
    until_s = times[first]
    hidden = False
    named = (next(names), next(names))
    added = list[TrackRow]()
    for row in reversed(olds[since:j]):
        cell = row.cell
        half: Floats = np.zeros(2)
        now_s = times[row.at]
        x = cell.x
        y = cell.y
        axis = cell.axis
        if cell.blob_um is not None and _sizes([row]):
            x, y, axis = cell.blob_um[:3]
            half = _half(cell.blob_um, np.mean(sizes, axis=0))
        if half @ apart < 0:
            half = -half
        clear = np.hypot(*half) > apart_um
        begins = clear and hidden and min(until_s - now_s, now_s - since_s) > LASTS_S
        if begins:
            named = (next(names), next(names))
            until_s = now_s
        hidden = not clear or (hidden and not begins)
        joint = replace(cell, axis=axis, merged=True, measured=None)
        added_cell = replace(joint, x=x + half[0], y=y + half[1], track=parting.track)
        added.append(TrackRow(row.at, added_cell, named[0], LIKELIER))
        row.cell = replace(joint, x=x - half[0], y=y - half[1])
        row.name = named[1]
        row.likely = LIKELIER
        apart = half if half.any() else apart
    news[i:i] = reversed(added)
    return True


def _half(blob: Floats, size: Floats) -> Floats:
    """Return half of the distance (2,) [um] of two cells of a `size` (2,) [um] in their blob."""
    axis = blob[2]
    along, across = np.sqrt(np.maximum(blob[3:] ** 2 - size**2, 0.0)) / 4
    if across > along:
        return across * np.array((-math.sin(axis), math.cos(axis)))
    return along * np.array((math.cos(axis), math.sin(axis)))


def _sizes(rows: Iterable[TrackRow]) -> list[Floats]:
    """Return length and width (2,) [um] of the blobs that show one track, as a whole."""
    cells = (row.cell for row in rows)
    blobs = [cell.blob_um for cell in cells if cell.blob_um is not None and not cell.merged]
    return [blob[3:] for blob in blobs if math.isfinite(blob[4])]
