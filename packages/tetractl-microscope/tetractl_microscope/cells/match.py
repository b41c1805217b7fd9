"""Assigns the blobs of a picture to tracks, in one assignment of least cost.

Costs are squared deviations: the negative log-likelihood, doubled. A cell may have a blob of its
own where the filter expects it, one of its size nearby if it has stopped or turned by itself, or a
place in a blob that covers it together with other cells; a speck has the blob where its last motion
leads; and each may have none.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.poses import Bools, Floats
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.detect_cells import Blob
from tetractl_microscope.organisms import Organism

NONE = 100.0  # cost of leaving a cell without a blob
# cost of leaving a speck without a blob: that of a new one, and the increase with each of its blobs
NONE_SPECK, NONE_EACH = 30.0, 14.0
# a blob within this many deviations, or lengths of a cell, of its expected place is near
GATE, NEAR = 6.0, 0.23
SIZE_SHARE, SIZE_MOST = 0.15, 20.0  # relative variation of a cell's blob, and its largest cost
ALIKE = 0.4  # largest difference of the logarithms of size of a blob away from its expected place
# cost of a blob of the cell's size at the expected place, and at the largest distance from it
# [lengths], which grows with the time without a blob [1/s], for Tetrahymena: of a cell that stopped
STOPPED, STOPPED_FAR, STOPPED_REACH = (50.0, 90.0), 0.86, 3.8
# cost of a place in a blob that is too large for one cell, or not
SHARED_LARGE, SHARED = 40.0, 70.0
COVER = 0.6  # largest distance of a cell from a blob it is in, relative to the cell's width
# of a speck's blob: least cost; deviation from its expected place, and radius of search there, and
# for a new one [lengths of Tetrahymena in 1 / USUAL_HZ, as speeds are what differs]
SPECK, SPECK_SD, REACH, FIRST = 6.0, 0.115, 0.48, 0.77
USUAL_HZ = 30.0
PLACE_UM = 2.0  # standard deviation of a blob's position, in addition to the filter's
LARGE = 1.45  # ratio of blob to cell area above which a blob shows more than one cell
ROUNDS, SAMPLED = 4, 200  # iterations when a blob is divided among cells; pixels that are used


def places_of(blobs: Sequence[Blob], um_px: float, height: int) -> Floats:
    """Return x, y (upwards) [um], axis [rad], length and width [um] of B blobs (B, 5), found in a
    picture with `height` rows.
    """
    found = [
        ((b.x + 0.5) * um_px, (height - 0.5 - b.y) * um_px, -b.axis, b.long * um_px, b.wide * um_px)
        for b in blobs
    ]
    return np.array(found).reshape(-1, 5)


def points_of(blob: Blob, um_px: float, height: int) -> Floats:
    """Return x, y (upwards) [um] of a blob's pixels (M, 2), in a picture with `height` rows."""
    columns, rows = blob.pixels.T
    return np.column_stack([columns + 0.5, height - 0.5 - rows]) * um_px


def pixels_of(places: Floats, um_px: float, height: int) -> Floats:
    """Return column and row (N, 2) of places (N, >= 2) [um] in a picture with `height` rows."""
    return np.column_stack([places[:, 0] / um_px - 0.5, height - 0.5 - places[:, 1] / um_px])


def squared_distances(expected: Floats, spread: Floats, places: Floats) -> Floats:
    """Return the squared Mahalanobis distances (C, B) of blobs `places` (B, 5) from the expected
    positions `expected` (C, 3) of cells, whose covariances are `spread` (C, 2, 2) [um^2].
    """
    off = places[None, :, :2] - expected[:, None, :2]
    inverse = np.linalg.inv(spread + PLACE_UM**2 * np.eye(2))
    return np.einsum("cbi,cij,cbj->cb", off, inverse, off)


def cell_costs(
    cells: Sequence[CellTrack],
    expected: Floats,
    squared: Floats,
    places: Floats,
    organism: Organism,
    looked_s: float,
) -> tuple[Floats, Bools]:
    """Return the costs (C, B) of blobs of their own for C cells, and whether (C, B) the blob is not
    where the filter expects it: the cell has stopped or turned by itself, and was seen less than
    `looked_s` [s] ago.
    """
    body_um = organism.body_um[0]
    away = np.linalg.norm(places[None, :, :2] - expected[:, None, :2], axis=-1) / body_um
    sizes = np.array([(cell.long, cell.wide) for cell in cells]).reshape(-1, 1, 2)
    ratio = np.abs(np.log(places[None, :, 3:5] / sizes))
    near = (squared < GATE**2) | (away < NEAR)
    unlike = np.minimum(np.square(ratio / SIZE_SHARE).sum(-1), SIZE_MOST)
    cost = np.where(near, np.minimum(squared, 4 * GATE**2) + unlike, NONE)
    missed = np.array([cell.missed_s for cell in cells])
    stopped = STOPPED_FAR + STOPPED_REACH * organism.quickness * missed
    reach = np.where(missed < looked_s, stopped, 1e-9)[:, None]
    least, most = STOPPED
    allowed = (away < reach) & (ratio.max(axis=-1, initial=0.0) < ALIKE)
    loose = np.where(allowed, least + (most - least) * np.square(away / reach), NONE)
    return np.minimum(cost, loose), loose < cost


def speck_costs(
    specks: Sequence[CellTrack],
    places: Floats,
    seconds: float,
    passed: float,
    organism: Organism,
) -> tuple[Floats, Floats]:
    """Return the costs (S, B) of blobs for S specks, at their expected places at a time [s], and
    those of no blob (S,); `passed` is the time since the last picture [s].
    """
    ahead = np.array([speck.ahead(seconds) for speck in specks]).reshape(-1, 1, 2)
    reach = np.array([REACH if len(speck.path) > 2 else FIRST for speck in specks])
    length = organism.body_um[0] * max(1.0, organism.quickness * USUAL_HZ * passed)
    away = np.linalg.norm(places[None, :, :2] - ahead, axis=-1) / length
    none = np.array([min(NONE, NONE_SPECK + NONE_EACH * len(speck.path)) for speck in specks])
    cost = np.minimum(SPECK + np.square(away / SPECK_SD), none[:, None] - 1)
    return np.where(away < reach[:, None], cost, 1e6), none


def shared_costs(
    cells: Sequence[CellTrack], pixels: Floats, blobs: Sequence[Blob], um_px: float
) -> Floats:
    """Return the costs (C, B) of a place in a blob that covers the cell's expected column and row,
    `pixels` (C, 2), for C cells.
    """
    cost = np.full((len(cells), len(blobs)), NONE)
    if not blobs or not cells:
        return cost
    middles = np.array([(blob.x, blob.y) for blob in blobs])
    halves = np.array([blob.long / 2 for blob in blobs])
    reach = COVER * np.array([cell.wide for cell in cells]) / um_px
    away = np.linalg.norm(pixels[:, None] - middles, axis=-1) - halves[None] - reach[:, None]
    for j in np.flatnonzero((away < 0).any(axis=0)).tolist():
        blob, points = blobs[j], blobs[j].pixels
        for i in np.flatnonzero(away[:, j] < 0).tolist():
            cell = cells[i]
            large = um_px**2 * blob.long * blob.wide > LARGE * cell.long * cell.wide
            if cell.missed_s > 0 and not large:  # the cell was outside this blob before
                continue
            if np.linalg.norm(points - pixels[i], axis=1).min() < reach[i]:
                cost[i, j] = SHARED_LARGE if large else SHARED
    return cost


def assigned(own: Floats, shared: Floats, specks: tuple[Floats, Floats]) -> dict[int, int]:
    """Return {track: blob}, the assignment of least total cost.

    `own` and `shared` (C, B) are the costs of cells; `specks` are those of S specks, whose numbers
    follow the cells', as by `speck_costs`. Only cells share a blob: a speck in a cell's blob has
    none.
    """
    (count, blobs), (of_specks, none) = own.shape, specks
    some = np.flatnonzero((shared < NONE).any(axis=0))
    places = [np.repeat(some, (shared[:, some] < NONE).sum(axis=0))]
    column = np.concatenate([np.arange(blobs), *places])
    cost = np.full((count + len(none), len(column)), 1e6)
    cost[:count, :blobs], cost[:count, blobs:] = own, shared[:, column[blobs:]]
    cost[count:, :blobs] = of_specks
    none = np.concatenate([np.full(count, NONE), none])
    cost[cost >= none[:, None]] = 1e6
    nothing = np.full((len(cost), len(cost)), 1e6)
    np.fill_diagonal(nothing, none)
    rows, at = linear_sum_assignment(np.concatenate([cost, nothing], axis=1))
    found = {int(i): int(column[j]) for i, j in zip(rows, at, strict=True) if j < len(column)}
    of_cells = {j for i, j in found.items() if i < count}
    return {i: j for i, j in found.items() if i < count or j not in of_cells}


def parted(owners: Sequence[CellTrack], expected: Floats, points: Floats) -> Floats:
    """Return the middles (K, 2) [um] of the K cells in a shared blob, whose pixels are at `points`
    (M, 2) [um].

    A sample of the pixels is fitted, by expectation-maximisation, with a mixture of Gaussians that
    have the cells' sizes and directions, starting at `expected` (K, 3): x, y [um], axis [rad].
    """
    points = points[:: max(1, len(points) // SAMPLED)]
    middles = expected[:, :2].copy()
    cos, sin = np.cos(expected[:, 2]), np.sin(expected[:, 2])
    halves = np.array([(cell.long / 4, cell.wide / 4) for cell in owners])
    for _ in range(ROUNDS):
        away = points[None] - middles[:, None]
        along = (away[..., 0] * cos[:, None] + away[..., 1] * sin[:, None]) / halves[:, :1]
        aside = (away[..., 1] * cos[:, None] - away[..., 0] * sin[:, None]) / halves[:, 1:]
        logs = -(along**2 + aside**2) / 2
        shares = np.exp(logs - logs.max(axis=0))
        shares /= shares.sum(axis=0)
        total = np.maximum(shares.sum(axis=1), 1e-9)
        middles = (shares @ points) / total[:, None]
    return middles
