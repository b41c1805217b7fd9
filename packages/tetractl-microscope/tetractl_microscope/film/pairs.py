"""Cells that were in another cell's blob before they were first seen: both have been in that blob
since it was too large for one of them.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.match import LARGE
from tetractl_microscope.cells.names import LIKELIER

Shown = list[dict[int, SeenCell]]
"""The cells of each picture, by track."""

APART_S = 0.5  # time after a parting whose blobs give the two cells' sizes
SEEN = 3  # successive blobs that are too large for one cell
SPREAD = 5.0  # least excess of ln of their areas, in deviations of a cell's blobs in the film
CUT_S = 0.5  # time before these blobs for which the picture's edge may have cut the cells off
LASTS_S = 0.4  # shortest part of a path that has names
APART = 0.15  # least distance of a cell from the middle of a blob that tells two cells [lengths]


def fill_pairs(
    shown: Shown,
    times: Sequence[float],
    partings: Iterable[tuple[int, int, int]],
    body_um: float,
) -> set[int]:
    """Add cells to the earlier pictures in which another cell's blob showed both. `partings` are
    the first picture of each cell that came out of another one's blob, its track, and the other
    one's. Cells are `body_um` long. Returns the tracks of the cells that were added.

    Each cell is then as far from the middle of the blob as the excess of the blob's second moment
    over a cell's says, along the blob or across it. Which of the two is which is not known: both
    have names of their own, and others after each time when they could not be distinguished.
    """
    areas: dict[int, list[float]] = {}
    for at in shown:
        for track, cell in at.items():
            areas.setdefault(track, []).extend(math.prod(size) for size in _sizes([cell]))
    off = [np.log(np.array(each) / np.median(each)) for each in areas.values() if each]
    spread = float(np.median(np.abs(np.concatenate(off)))) / 0.6745 if off else 0.0
    names = count(max((cell.identity for at in shown for cell in at.values()), default=0) + 1)
    larger = max(LARGE, math.exp(SPREAD * spread))
    return {
        track
        for first, track, other in partings
        if _fill(shown, times, first, track, other, larger, APART * body_um, names)
    }


def _fill(
    shown: Shown,
    times: Sequence[float],
    first: int,
    track: int,
    other: int,
    larger: float,
    apart_um: float,
    names: Iterator[int],
) -> bool:
    """Add a cell on a `track` to the pictures before its `first` one; return whether it was. A blob
    that is `larger` than one cell shows two; nearer than `apart_um` [um] to its middle they cannot
    be distinguished.
    """
    if first == 0 or other not in shown[first] or other not in shown[first - 1]:
        return False
    end = int(np.searchsorted(times, times[first] + APART_S))
    after = [_sizes(at[each] for at in shown[first:end] if each in at) for each in (track, other)]
    if not all(after):
        return False
    sizes = [np.median(each, axis=0) for each in after]
    usual = [math.prod(each) for each in _sizes(shown[first].values())] or [0.0]
    least = larger * max(*map(math.prod, sizes), float(np.median(usual)))
    begun = next(k for k in range(first - 1, -1, -1) if k == 0 or other not in shown[k - 1])
    before = range(begun, first)
    own = [(k, math.prod(size) > least) for k in before for size in _sizes([shown[k][other]])]
    runs = (own[i : i + SEEN] for i in range(len(own) - SEEN + 1))
    since = next((run[0][0] for run in runs if all(large for _, large in run)), first)
    if since < first and times[since] - times[begun] <= CUT_S:
        since = begun
    if times[first] - times[since] < LASTS_S:
        return False
    new, old = shown[first][track], shown[first][other]
    apart, until, hidden = np.array((new.x - old.x, new.y - old.y)), first, False
    named = next(names), next(names)
    for k in range(first - 1, since - 1, -1):
        cell, half = shown[k][other], np.zeros(2)
        x, y, axis = cell.x, cell.y, cell.axis
        if cell.blob_um is not None and _sizes([cell]):
            (x, y, axis), half = cell.blob_um[:3], _half(cell.blob_um, np.mean(sizes, axis=0))
        half, clear = half if half @ apart >= 0 else -half, np.hypot(*half) > apart_um
        lasts = min(times[until] - times[k], times[k] - times[since]) > LASTS_S
        if clear and hidden and lasts:
            named, until = (next(names), next(names)), k
        hidden = not clear or (hidden and until != k)
        pair = replace(cell, axis=axis, merged=True, measured=None, probability=LIKELIER)
        shown[k][track] = replace(
            pair, x=x + half[0], y=y + half[1], identity=named[0], track=track
        )
        shown[k][other] = replace(pair, x=x - half[0], y=y - half[1], identity=named[1])
        apart = half if half.any() else apart
    return True


def _half(blob: Floats, size: Floats) -> Floats:
    """Return half of the distance (2,) [um] of two cells of a `size` (2,) [um] in their blob."""
    axis, (along, across) = blob[2], np.sqrt(np.maximum(blob[3:] ** 2 - size**2, 0.0)) / 4
    if across > along:
        return across * np.array((-math.sin(axis), math.cos(axis)))
    return along * np.array((math.cos(axis), math.sin(axis)))


def _sizes(cells: Iterable[SeenCell]) -> list[Floats]:
    """Return length and width (2,) [um] of the blobs that show one track, as a whole."""
    blobs = [cell.blob_um for cell in cells if cell.blob_um is not None and not cell.merged]
    return [blob[3:] for blob in blobs if math.isfinite(blob[4])]
