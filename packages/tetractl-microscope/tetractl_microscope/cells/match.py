"""Assigns the blobs of a picture to tracks, in one assignment of least cost.

Costs are squared deviations: the negative log-likelihood, doubled. A cell may have

- a blob of its own where the filter expects it, of cost q + s: q is the squared Mahalanobis
  distance of the place, s that of the logarithms of length and width;
- a blob of its size nearby, if it has stopped or turned by itself, which costs more than the first;
- a place in a blob that covers it together with other cells;

a speck has the blob where its last motion leads; and each may have none. The assignment of least
total cost is found at once for all.

C is the number of cells, S that of specks, B that of blobs; costs are (C, B) or (S, B).
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.poses import Bools, Floats
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.detect_cells import Blob
from tetractl_microscope.organisms import Organism

NONE = 100.0  # cost of leaving a cell without a blob
NEVER = 1e6  # cost of what is never assigned
NONE_SPECK = 30.0  # cost of leaving a new speck without a blob
NONE_EACH = 14.0  # increase of that cost with each blob that a speck has had
GATE = 6.0  # standard deviations from its expected place within which a cell's blob is near
NEAR = 0.23  # distance from its expected place within which a cell's blob is near [lengths]
GATES_MOST = 4  # largest cost of a near blob's place, in squares of the gate
SIZE_SHARE = 0.15  # relative variation of a cell's blob
SIZE_MOST = 20.0  # largest cost of a blob's size
ALIKE = 0.4  # largest difference of the logarithms of size of a blob away from its expected place
STOPPED_LEAST = 50.0  # cost of a blob of the cell's size that has stopped where it was expected
STOPPED_MOST = 90.0  # the same at the largest distance from there
STOPPED_FAR = 0.86  # that distance for a cell seen in the picture before [lengths]
STOPPED_REACH = 3.8  # increase of that distance with the time without a blob [lengths/s]
NO_REACH = 1e-9  # that distance for a cell not seen for long [lengths]
SHARED_LARGE = 40.0  # cost of a place in a blob that is too large for one cell
SHARED = 70.0  # cost of a place in a blob that is not
COVER = 0.6  # largest distance of a cell from a blob it is in, relative to the cell's width
SPECK = 6.0  # least cost of a speck's blob
# of a speck's blob: deviation from its expected place, and radius of search there, and for a new
# one [lengths of Tetrahymena in 1 / USUAL_HZ, as speeds are what differs]
SPECK_SD = 0.115
REACH = 0.48
FIRST = 0.77
USUAL_HZ = 30.0
PLACE_UM = 2.0  # standard deviation of a blob's position, in addition to the filter's
LARGE = 1.45  # ratio of blob to cell area above which a blob shows more than one cell
ROUNDS = 4  # iterations when a blob is divided among cells
SAMPLED = 200  # most pixels that are used then


def places_of(blobs: Sequence[Blob], um_px: float, height: int) -> Floats:
    """Return x, y (upwards) [um], axis [rad], length and width [um] of B blobs (B, 5), found in a
    picture with `height` rows.
    """
    places = [
        ((b.x + 0.5) * um_px, (height - 0.5 - b.y) * um_px, -b.axis, b.long * um_px, b.wide * um_px)
        for b in blobs
    ]
    return np.array(places).reshape(-1, 5)


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
    size_off = np.abs(np.log(places[None, :, 3:5] / sizes))

    is_near = (squared < GATE**2) | (away < NEAR)
    of_size = np.minimum(np.square(size_off / SIZE_SHARE).sum(-1), SIZE_MOST)
    of_place = np.minimum(squared, GATES_MOST * GATE**2)
    cost = np.where(is_near, of_place + of_size, NONE)

    missed_s = np.array([cell.missed_s for cell in cells])
    stopped = STOPPED_FAR + STOPPED_REACH * organism.quickness * missed_s
    reach = np.where(missed_s < looked_s, stopped, NO_REACH)[:, None]
    is_in_reach = (away < reach) & (size_off.max(axis=-1, initial=0.0) < ALIKE)
    of_distance = STOPPED_LEAST + (STOPPED_MOST - STOPPED_LEAST) * np.square(away / reach)
    cost_away = np.where(is_in_reach, of_distance, NONE)
    return np.minimum(cost, cost_away), cost_away < cost


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
    of_none = np.array([min(NONE, NONE_SPECK + NONE_EACH * len(speck.path)) for speck in specks])
    cost = np.minimum(SPECK + np.square(away / SPECK_SD), of_none[:, None] - 1)
    return np.where(away < reach[:, None], cost, NEVER), of_none


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
        blob = blobs[j]
        blob_um2 = um_px**2 * blob.long * blob.wide
        points = blob.pixels
        for i in np.flatnonzero(away[:, j] < 0).tolist():
            cell = cells[i]
            is_large = blob_um2 > LARGE * cell.long * cell.wide
            was_outside = cell.missed_s > 0 and not is_large
            if not was_outside and np.linalg.norm(points - pixels[i], axis=1).min() < reach[i]:
                cost[i, j] = SHARED_LARGE if is_large else SHARED
    return cost


def assigned(own: Floats, shared: Floats, specks: tuple[Floats, Floats]) -> dict[int, int]:
    """Return {track: blob}, the assignment of least total cost.

    `own` and `shared` (C, B) are the costs of cells; `specks` are those of S specks, whose numbers
    follow the cells', as by `speck_costs`. Only cells share a blob: a speck in a cell's blob has
    none.
    """
    count, blobs = own.shape
    of_specks, speck_none = specks
    # a blob has one more column for each cell that may share it
    may_share = shared < NONE
    columns = np.concatenate([np.arange(blobs), np.repeat(np.arange(blobs), may_share.sum(axis=0))])
    cost = np.full((count + len(speck_none), len(columns)), NEVER)
    cost[:count, :blobs] = own
    cost[:count, blobs:] = shared[:, columns[blobs:]]
    cost[count:, :blobs] = of_specks
    of_none = np.concatenate([np.full(count, NONE), speck_none])
    cost[cost >= of_none[:, None]] = NEVER
    nothing = np.full((len(cost), len(cost)), NEVER)  # a column for each track that has no blob
    np.fill_diagonal(nothing, of_none)
    rows, chosen = linear_sum_assignment(np.concatenate([cost, nothing], axis=1))
    blob_of = {
        int(i): int(columns[j]) for i, j in zip(rows, chosen, strict=True) if j < len(columns)
    }
    with_cells = {j for i, j in blob_of.items() if i < count}
    return {i: j for i, j in blob_of.items() if i < count or j not in with_cells}


def parted(owners: Sequence[CellTrack], expected: Floats, points: Floats) -> Floats:
    """Return the middles (K, 2) [um] of the K cells in a shared blob, whose pixels are at `points`
    (M, 2) [um].

    A sample of the pixels is fitted, by expectation-maximisation, with a mixture of Gaussians that
    have the cells' sizes and directions, starting at `expected` (K, 3): x, y [um], axis [rad].
    """
    points = points[:: max(1, len(points) // SAMPLED)]
    middles = expected[:, :2].copy()
    cos = np.cos(expected[:, 2])
    sin = np.sin(expected[:, 2])
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
