"""Assigns the blobs of an image to cells and specks, with the minimum total cost.

Costs are squared deviations: twice the negative log-likelihood. A cell may have one of these
blobs, or no blob:

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
from tetractl_microscope.cells.picture_now import NewestImage
from tetractl_microscope.cells.specks import Speck
from tetractl_microscope.organisms import Organism

NO_BLOB_COST = 100.0  # cost of leaving a cell without a blob
FORBIDDEN_COST = 1e6  # cost of an assignment that must not happen
NO_BLOB_SPECK_COST = 30.0  # cost of leaving a new speck without a blob
NO_BLOB_SPECK_INCREASE = 14.0  # increase of that cost with each blob that a speck has had
GATE_SD = 6.0  # maximum Mahalanobis distance of a cell's blob from its expected position
SIZE_VARIATION = 0.15  # relative standard deviation of the length and width of a cell's blob
SIZE_COST_MAX = 20.0  # maximum cost of a blob's size
# Maximum difference of the logarithms of length or width between a cell and a blob that is not
# where the cell is expected.
LOG_SIZE_DIFFERENCE_MAX = 0.4
# Cost of a blob of the cell's size that the filter does not expect, because the cell has stopped or
# turned by itself. The cost rises from the expected position to the maximum distance from there.
STOPPED_COST_MIN = 50.0
STOPPED_COST_MAX = 90.0
STOPPED_REACH = 0.86  # that maximum distance, for a cell seen in the previous image [lengths]
STOPPED_REACH_GROWTH = 3.8  # increase of that distance with the time without a blob [lengths/s]
SHARED_LARGE_COST = 40.0  # cost of a place in a blob that is too large for one cell
SHARED_COST = 70.0  # cost of a place in a blob that is not too large for one cell
COVER_REACH = 0.6  # maximum distance of a cell from a blob that covers it [widths of the cell]
SPECK_COST_MIN = 6.0  # minimum cost of a speck's blob
# Distances of a speck's blob from the position to which the speck's motion leads. The unit is the
# length of the body at USUAL_HZ images per second, and longer for fast organisms or rare images.
SPECK_SD = 0.115  # standard deviation of the distance
SPECK_REACH = 0.48  # maximum distance
NEW_SPECK_REACH = 0.77  # maximum distance for a speck with at most two blobs
USUAL_HZ = 30.0
POSITION_SD_UM = 2.0  # standard deviation of a blob's position, in addition to the filter's
LARGE_AREA_RATIO = 1.45  # ratio of blob to cell area above which a blob shows more than one cell
EM_ITERATIONS = 4  # iterations of the fit that divides a blob among cells
EM_PIXELS_MAX = 200  # maximum number of pixels of a blob that this fit uses


@dataclass(frozen=True, slots=True)
class CellCosts:
    """The costs of assigning the blobs of an image to cells, shape (C, B).

    Attributes:
        own_blob: Cost of a blob that shows only this cell.
        shared_blob: Cost of a place in a blob that shows several cells.
        is_away: Whether a blob that shows only this cell would be away from the position that the
            filter expects.
    """

    own_blob: Floats
    shared_blob: Floats
    is_away: Bools


@dataclass(frozen=True, slots=True)
class SpeckCosts:
    """The costs of assigning the blobs of an image to specks.

    Attributes:
        blobs: Cost of each blob for each speck, shape (S, B).
        no_blob: Cost of leaving each speck without a blob, shape (S,).
    """

    blobs: Floats
    no_blob: Floats


@dataclass(frozen=True, slots=True)
class Assignment:
    """The blobs that are assigned to the cells and specks in one image.

    Attributes:
        blob_of_cell: Index of the blob of each cell. None for a cell without a blob.
        blob_of_speck: Index of the blob of each speck. None for a speck without a blob.
    """

    blob_of_cell: list[int | None]
    blob_of_speck: list[int | None]


def compute_cell_costs(
    cells: Sequence[CellTrack],
    expected: Floats,
    covariances: Floats,
    blobs: Sequence[Blob],
    places: Floats,
    image: NewestImage,
    organism: Organism,
) -> CellCosts:
    """Compute the costs of assigning the blobs of an image to cells.

    Args:
        cells: The C cells.
        expected: Expected x, y [um] and axis [rad] of each cell, shape (C, 3).
        covariances: Covariance of x and y [um^2], shape (C, 2, 2).
        blobs: The B blobs.
        places: Their x, y [um], axis [rad], length and width [um], shape (B, 5).
        image: The newest image.
        organism: The organism.
    """
    body_um = organism.body_um[0]
    offsets = places[None, :, :2] - expected[:, None, :2]
    inverse = np.linalg.inv(covariances + POSITION_SD_UM**2 * np.eye(2))
    # Mahalanobis distances
    squared_distances = np.einsum("cbi,cij,cbj->cb", offsets, inverse, offsets)
    distances = np.linalg.norm(offsets, axis=-1) / body_um
    sizes = np.array([cell.size for cell in cells]).reshape(-1, 1, 2)
    log_size_differences = np.abs(np.log(places[None, :, 3:5] / sizes))

    size_cost = np.minimum(np.square(log_size_differences / SIZE_VARIATION).sum(-1), SIZE_COST_MAX)
    cost_near = np.where(
        squared_distances < GATE_SD**2, squared_distances + size_cost, NO_BLOB_COST
    )

    missed_s = np.array([cell.missed_s for cell in cells])
    reach = (STOPPED_REACH + STOPPED_REACH_GROWTH * organism.quickness * missed_s)[:, None]
    was_seen = (missed_s < image.short_gap_s)[:, None]
    is_in_reach = (
        was_seen
        & (distances < reach)
        & (log_size_differences.max(axis=-1, initial=0.0) < LOG_SIZE_DIFFERENCE_MAX)
    )
    stopped_cost = STOPPED_COST_MIN + (STOPPED_COST_MAX - STOPPED_COST_MIN) * np.square(
        distances / reach
    )
    cost_away = np.where(is_in_reach, stopped_cost, NO_BLOB_COST)

    return CellCosts(
        own_blob=np.minimum(cost_near, cost_away),
        shared_blob=_compute_shared_costs(cells, image.pixels_of(expected), blobs, image.um_px),
        is_away=cost_away < cost_near,
    )


def compute_speck_costs(
    specks: Sequence[Speck],
    places: Floats,
    seconds: float,
    since_previous_s: float,
    organism: Organism,
) -> SpeckCosts:
    """Compute the costs of assigning blobs to specks, from where their motion leads.

    Args:
        specks: The S specks.
        places: x, y [um], axis [rad], length and width [um] of the B blobs, shape (B, 5).
        seconds: Time of the image [s].
        since_previous_s: Time since the previous image [s].
        organism: The organism.
    """
    predicted = np.array([speck.position_at(seconds) for speck in specks]).reshape(-1, 1, 2)
    reach = np.array([SPECK_REACH if len(speck.path) > 2 else NEW_SPECK_REACH for speck in specks])
    motion_um = organism.body_um[0] * max(1.0, organism.quickness * USUAL_HZ * since_previous_s)
    distances = np.linalg.norm(places[None, :, :2] - predicted, axis=-1) / motion_um
    no_blob_costs = np.array(
        [
            min(NO_BLOB_COST, NO_BLOB_SPECK_COST + NO_BLOB_SPECK_INCREASE * len(speck.path))
            for speck in specks
        ]
    )
    cost = np.minimum(SPECK_COST_MIN + np.square(distances / SPECK_SD), no_blob_costs[:, None] - 1)
    return SpeckCosts(np.where(distances < reach[:, None], cost, FORBIDDEN_COST), no_blob_costs)


def _compute_shared_costs(
    cells: Sequence[CellTrack], pixels: Floats, blobs: Sequence[Blob], um_px: float
) -> Floats:
    """Compute the costs for cells of sharing a blob that covers their expected positions.

    Args:
        cells: The C cells.
        pixels: Expected column and row of each cell, shape (C, 2) [px].
        blobs: The B blobs.
        um_px: Scale of the image [um/px].

    Returns:
        The costs, shape (C, B).
    """
    cost = np.full((len(cells), len(blobs)), NO_BLOB_COST)
    if not blobs or not cells:
        return cost
    centres = np.array([(blob.x, blob.y) for blob in blobs])
    half_lengths = np.array([blob.length / 2 for blob in blobs])
    reach = COVER_REACH * np.array([cell.size.width for cell in cells]) / um_px
    gaps = np.linalg.norm(pixels[:, None] - centres, axis=-1) - half_lengths[None] - reach[:, None]
    for j in np.flatnonzero((gaps < 0).any(axis=0)).tolist():
        blob = blobs[j]
        blob_um2 = um_px**2 * blob.length * blob.width
        points = blob.pixels
        for i in np.flatnonzero(gaps[:, j] < 0).tolist():
            cell = cells[i]
            is_large = blob_um2 > LARGE_AREA_RATIO * cell.size.area_um2
            was_outside = cell.missed_s > 0 and not is_large
            if not was_outside and np.linalg.norm(points - pixels[i], axis=1).min() < reach[i]:
                cost[i, j] = SHARED_LARGE_COST if is_large else SHARED_COST
    return cost


def assign_blobs(cells: CellCosts, specks: SpeckCosts) -> Assignment:
    """Find the assignment of blobs to cells and specks with the minimum total cost.

    Only cells share a blob. A speck in a cell's blob gets no blob. The cost matrix has a row for
    each track, the cells first. Its columns are the blobs, then a further column for each cell that
    may share a blob, then a column for each track that stays without a blob.
    """
    n_cells, n_blobs = cells.own_blob.shape
    may_share = cells.shared_blob < NO_BLOB_COST
    shared_blobs = np.repeat(np.arange(n_blobs), may_share.sum(axis=0))
    blob_of_column = np.concatenate([np.arange(n_blobs), shared_blobs])
    no_blob_costs = np.concatenate([np.full(n_cells, NO_BLOB_COST), specks.no_blob])
    cost = np.full((len(no_blob_costs), len(blob_of_column)), FORBIDDEN_COST)
    cost[:n_cells, :n_blobs] = cells.own_blob
    cost[:n_cells, n_blobs:] = cells.shared_blob[:, shared_blobs]
    cost[n_cells:, :n_blobs] = specks.blobs
    is_worse_than_none = cost >= no_blob_costs[:, None]
    cost[is_worse_than_none] = FORBIDDEN_COST
    no_blob_matrix = np.full((len(cost), len(cost)), FORBIDDEN_COST)
    np.fill_diagonal(no_blob_matrix, no_blob_costs)
    rows, columns = linear_sum_assignment(np.concatenate([cost, no_blob_matrix], axis=1))

    blob_of_track: list[int | None] = [None] * len(cost)
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        if column < len(blob_of_column):
            blob_of_track[row] = int(blob_of_column[column])
    of_cells = blob_of_track[:n_cells]
    of_specks = [None if blob in of_cells else blob for blob in blob_of_track[n_cells:]]
    return Assignment(of_cells, of_specks)


def find_centres_in_blob(cells: Sequence[CellTrack], expected: Floats, points: Floats) -> Floats:
    """Find the centres of K cells in a blob that they share, shape (K, 2) [um].

    A sample of the pixels is fitted, by expectation-maximisation, with a mixture of Gaussians that
    have the cells' sizes and directions.

    Args:
        cells: The cells' tracks.
        expected: Expected x, y [um] and axis [rad] of each cell, shape (K, 3), where the fit
            starts.
        points: Pixels of the blob [um], shape (M, 2).
    """
    points = points[:: max(1, len(points) // EM_PIXELS_MAX)]
    centres = expected[:, :2].copy()
    cos = np.cos(expected[:, 2])
    sin = np.sin(expected[:, 2])
    sd_um = np.array([cell.size for cell in cells]) / 4  # those of an ellipse, along and across
    for _ in range(EM_ITERATIONS):
        offsets = points[None] - centres[:, None]
        along = (offsets[..., 0] * cos[:, None] + offsets[..., 1] * sin[:, None]) / sd_um[:, :1]
        aside = (offsets[..., 1] * cos[:, None] - offsets[..., 0] * sin[:, None]) / sd_um[:, 1:]
        log_densities = -(along**2 + aside**2) / 2
        responsibilities = np.exp(log_densities - log_densities.max(axis=0))
        responsibilities /= responsibilities.sum(axis=0)
        weights = np.maximum(responsibilities.sum(axis=1), 1e-9)
        centres = (responsibilities @ points) / weights[:, None]
    return centres
