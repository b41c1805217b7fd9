"""Assigns the blobs of an image to tracks, in one assignment of minimum total cost.

Costs are squared deviations: twice the negative log-likelihood. A cell may have one of these, or
none:

- a blob of its own where the filter expects it, with the cost q + s: q is the squared Mahalanobis
  distance of the position, and s the same for the logarithms of length and width;
- a blob of its size nearby, if the cell has stopped or turned by itself, at a higher cost;
- a place in a blob that covers it together with other cells.

A speck may have the blob to which its last motion leads, or none. The assignment with the minimum
total cost is computed for all tracks at once.

C is the number of cells, S the number of specks, and B the number of blobs. The place of a blob is
x, y [um], axis [rad], length and width [um], shape (5,).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.poses import Bools, Floats
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.detect_cells import Blob
from tetractl_microscope.cells.picture_now import PictureNow
from tetractl_microscope.cells.specks import Speck
from tetractl_microscope.organisms import Organism

NONE = 100.0  # cost of leaving a cell without a blob
NEVER = 1e6  # cost of what is never assigned
NONE_SPECK = 30.0  # cost of leaving a new speck without a blob
NONE_EACH = 14.0  # increase of that cost with each blob that a speck has had
GATE = 6.0  # standard deviations from its expected place within which a cell's blob is near
SIZE_SHARE = 0.15  # relative variation of a cell's blob
SIZE_MOST = 20.0  # largest cost of a blob's size
ALIKE = 0.4  # largest difference of the logarithms of size of a blob away from its expected place
STOPPED_LEAST = 50.0  # cost of a blob of the cell's size that has stopped where it was expected
STOPPED_MOST = 90.0  # the same at the largest distance from there
STOPPED_FAR = 0.86  # that distance for a cell seen in the picture before [lengths]
STOPPED_REACH = 3.8  # increase of that distance with the time without a blob [lengths/s]
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


@dataclass(frozen=True, slots=True)
class CellCosts:
    """The costs of assigning blobs to cells, shape (C, B).

    Attributes:
        own: Cost of a blob that shows only this cell.
        shared: Cost of a place in a blob that shows several cells.
        is_away: Whether an own blob is not where the filter expects it.
    """

    own: Floats
    shared: Floats
    is_away: Bools


@dataclass(frozen=True, slots=True)
class SpeckCosts:
    """The costs of assigning blobs to specks.

    Attributes:
        blobs: Cost of each blob for each speck, shape (S, B).
        none: Cost of leaving each speck without a blob, shape (S,).
    """

    blobs: Floats
    none: Floats


@dataclass(frozen=True, slots=True)
class Assignment:
    """The result of the assignment.

    Attributes:
        of_cells: Index of the blob of each cell. None if it has none.
        of_specks: Index of the blob of each speck. None if it has none.
    """

    of_cells: list[int | None]
    of_specks: list[int | None]


def cell_costs(
    cells: Sequence[CellTrack],
    expected: Floats,
    spread: Floats,
    blobs: Sequence[Blob],
    places: Floats,
    now: PictureNow,
    organism: Organism,
) -> CellCosts:
    """Compute the costs of assigning blobs to cells.

    Args:
        cells: The C cells.
        expected: Expected x, y [um] and axis [rad] of each cell, shape (C, 3).
        spread: Covariance of x and y [um^2], shape (C, 2, 2).
        blobs: The B blobs.
        places: Their x, y [um], axis [rad], length and width [um], shape (B, 5).
        now: The newest image.
        organism: The organism.
    """
    body_um = organism.body_um[0]
    off = places[None, :, :2] - expected[:, None, :2]
    inverse = np.linalg.inv(spread + PLACE_UM**2 * np.eye(2))
    squared = np.einsum("cbi,cij,cbj->cb", off, inverse, off)  # Mahalanobis distances
    away = np.linalg.norm(off, axis=-1) / body_um
    sizes = np.array([cell.size for cell in cells]).reshape(-1, 1, 2)
    size_off = np.abs(np.log(places[None, :, 3:5] / sizes))

    of_size = np.minimum(np.square(size_off / SIZE_SHARE).sum(-1), SIZE_MOST)
    cost_near = np.where(squared < GATE**2, squared + of_size, NONE)

    missed_s = np.array([cell.missed_s for cell in cells])
    reach = (STOPPED_FAR + STOPPED_REACH * organism.quickness * missed_s)[:, None]
    was_seen = (missed_s < now.brief_s)[:, None]
    is_in_reach = was_seen & (away < reach) & (size_off.max(axis=-1, initial=0.0) < ALIKE)
    of_distance = STOPPED_LEAST + (STOPPED_MOST - STOPPED_LEAST) * np.square(away / reach)
    cost_away = np.where(is_in_reach, of_distance, NONE)

    return CellCosts(
        own=np.minimum(cost_near, cost_away),
        shared=_shared_costs(cells, now.pixels_of(expected), blobs, now.um_px),
        is_away=cost_away < cost_near,
    )


def speck_costs(
    specks: Sequence[Speck],
    places: Floats,
    seconds: float,
    passed_s: float,
    organism: Organism,
) -> SpeckCosts:
    """Compute the costs of assigning blobs to specks, from where their last motion leads.

    Args:
        specks: The S specks.
        places: x, y [um], axis [rad], length and width [um] of the B blobs, shape (B, 5).
        seconds: Time of the image [s].
        passed_s: Time since the previous image [s].
        organism: The organism.
    """
    ahead = np.array([speck.position_at(seconds) for speck in specks]).reshape(-1, 1, 2)
    reach = np.array([REACH if len(speck.path) > 2 else FIRST for speck in specks])
    length = organism.body_um[0] * max(1.0, organism.quickness * USUAL_HZ * passed_s)
    away = np.linalg.norm(places[None, :, :2] - ahead, axis=-1) / length
    of_none = np.array([min(NONE, NONE_SPECK + NONE_EACH * len(speck.path)) for speck in specks])
    cost = np.minimum(SPECK + np.square(away / SPECK_SD), of_none[:, None] - 1)
    return SpeckCosts(np.where(away < reach[:, None], cost, NEVER), of_none)


def _shared_costs(
    cells: Sequence[CellTrack], pixels: Floats, blobs: Sequence[Blob], um_px: float
) -> Floats:
    """Compute the costs of places in blobs that cover the cells' expected positions.

    Args:
        cells: The C cells.
        pixels: Expected column and row of each cell, shape (C, 2) [px].
        blobs: The B blobs.
        um_px: Scale of the image [um/px].

    Returns:
        The costs, shape (C, B).
    """
    cost = np.full((len(cells), len(blobs)), NONE)
    if not blobs or not cells:
        return cost
    middles = np.array([(blob.x, blob.y) for blob in blobs])
    halves = np.array([blob.long / 2 for blob in blobs])
    reach = COVER * np.array([cell.size.wide for cell in cells]) / um_px
    away = np.linalg.norm(pixels[:, None] - middles, axis=-1) - halves[None] - reach[:, None]
    for j in np.flatnonzero((away < 0).any(axis=0)).tolist():
        blob = blobs[j]
        blob_um2 = um_px**2 * blob.long * blob.wide
        points = blob.pixels
        for i in np.flatnonzero(away[:, j] < 0).tolist():
            cell = cells[i]
            is_large = blob_um2 > LARGE * cell.size.area_um2
            was_outside = cell.missed_s > 0 and not is_large
            if not was_outside and np.linalg.norm(points - pixels[i], axis=1).min() < reach[i]:
                cost[i, j] = SHARED_LARGE if is_large else SHARED
    return cost


def assigned(cells: CellCosts, specks: SpeckCosts) -> Assignment:
    """Find the assignment of blobs to cells and specks with the minimum total cost.

    Only cells share a blob. A speck in a cell's blob gets none. The cost matrix has a row for each
    track, the cells first. Its columns are the blobs, one more for each cell that may share a blob,
    and one for each track without a blob.
    """
    count, blobs = cells.own.shape
    may_share = cells.shared < NONE
    shared_blobs = np.repeat(np.arange(blobs), may_share.sum(axis=0))
    blob_of_column = np.concatenate([np.arange(blobs), shared_blobs])
    of_none = np.concatenate([np.full(count, NONE), specks.none])
    cost = np.full((len(of_none), len(blob_of_column)), NEVER)
    cost[:count, :blobs] = cells.own
    cost[:count, blobs:] = cells.shared[:, shared_blobs]
    cost[count:, :blobs] = specks.blobs
    is_dearer = cost >= of_none[:, None]
    cost[is_dearer] = NEVER
    nothing = np.full((len(cost), len(cost)), NEVER)
    np.fill_diagonal(nothing, of_none)
    rows, columns = linear_sum_assignment(np.concatenate([cost, nothing], axis=1))

    blob_of: list[int | None] = [None] * len(cost)
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        if column < len(blob_of_column):
            blob_of[row] = int(blob_of_column[column])
    of_cells = blob_of[:count]
    of_specks = [None if blob in of_cells else blob for blob in blob_of[count:]]
    return Assignment(of_cells, of_specks)


def centres_in_blob(owners: Sequence[CellTrack], expected: Floats, points: Floats) -> Floats:
    """Find the centres of K cells in a blob that they share, shape (K, 2) [um].

    A sample of the pixels is fitted, by expectation-maximisation, with a mixture of Gaussians that
    have the cells' sizes and directions.

    Args:
        owners: The cells' tracks.
        expected: Expected x, y [um] and axis [rad] of each cell, shape (K, 3), where the fit
            starts.
        points: Pixels of the blob [um], shape (M, 2).
    """
    points = points[:: max(1, len(points) // SAMPLED)]
    middles = expected[:, :2].copy()
    cos = np.cos(expected[:, 2])
    sin = np.sin(expected[:, 2])
    sd_um = np.array([cell.size for cell in owners]) / 4  # those of an ellipse, along and across
    for _ in range(ROUNDS):
        away = points[None] - middles[:, None]
        along = (away[..., 0] * cos[:, None] + away[..., 1] * sin[:, None]) / sd_um[:, :1]
        aside = (away[..., 1] * cos[:, None] - away[..., 0] * sin[:, None]) / sd_um[:, 1:]
        logs = -(along**2 + aside**2) / 2
        shares = np.exp(logs - logs.max(axis=0))
        shares /= shares.sum(axis=0)
        total = np.maximum(shares.sum(axis=1), 1e-9)
        middles = (shares @ points) / total[:, None]
    return middles
