"""Assigns blobs to cells by the filter's expected positions and by size."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.cell import FollowedCell
from tetractl.lab.cameras.cells.detect_cells import Blob

GATE = 6.0  # largest distance from a cell's expected position, in standard deviations
GATE_UM = 12.0  # distance within which a blob always matches a cell
FAR = 100.0  # cost of leaving a cell without a blob
STOPPED_UM = 45.0  # largest distance of a stopped cell's blob from the expected position
STOPPED_UM_S = 200.0  # growth of STOPPED_UM per second without a blob
SIZE_SHARE = 0.15  # relative variation of a cell's blob between pictures
ALIKE = 0.4  # largest difference of the logarithms of size for a stopped cell
COVER = 0.6  # largest distance of a cell from a blob it is part of, relative to the cell's width
FAR_PX = 20.0  # plus the blob's length: largest distance from a blob's middle to a cell in it
PARTED_UM = 90.0  # largest distance of a cell from the shared blob that it has left
SPECK_UM = 25.0  # a blob nearer than this to a hidden speck is the speck
LARGE = 1.45  # ratio of blob to cell area above which a blob shows more than one cell
PLACE_UM = 2.0  # standard deviation of a blob's position, in addition to the filter's
ROUNDS = 4  # iterations when a blob is divided among cells
SAMPLED = 200  # number of the blob's pixels that are used


def places_of(blobs: Sequence[Blob], um_px: float, height: int) -> Floats:
    """Return x, y (upwards) [um], axis [rad], length and width [um] of B blobs (B, 5), found in a
    picture with `height` rows.
    """
    found = [
        (
            (b.x + 0.5) * um_px,
            (height - 0.5 - b.y) * um_px,
            -b.axis,
            b.long * um_px,
            b.wide * um_px,
        )
        for b in blobs
    ]
    return np.array(found).reshape(-1, 5)


def assigned(
    cells: Sequence[FollowedCell],
    expected: Floats,
    spread: Floats,
    specks: Floats,
    places: Floats,
) -> tuple[dict[int, int], set[int]]:
    """Return {cell: blob} for cells with a blob of their own, and the set of blobs that are specks.

    The assignment minimises the sum of squared distances in position and size. `expected` (C, 3)
    are the cells' expected poses, `spread` (C, 2, 2) the covariances of their positions, `specks`
    (S, 2) the last positions of specks [um], and `places` (B, 5) the blobs, as by `places_of`.
    """
    if len(places) == 0 or len(cells) + len(specks) == 0:
        return {}, set()
    cost = np.full((len(cells) + len(specks), len(places)), FAR)
    if len(cells):
        off = places[None, :, :2] - expected[:, None, :2]
        inverse = np.linalg.inv(spread + PLACE_UM**2 * np.eye(2))
        squared = np.einsum("cbi,cij,cbj->cb", off, inverse, off)
        near = (squared < GATE**2) | (np.hypot(off[..., 0], off[..., 1]) < GATE_UM)
        sizes = np.array([(cell.long, cell.wide) for cell in cells])
        ratio = np.log(places[None, :, 3:5] / sizes[:, None]) / SIZE_SHARE
        total = np.minimum(squared, 4 * GATE**2) + np.minimum(np.square(ratio).sum(-1), 20.0)
        cost[: len(cells)] = np.where(near, total, FAR)
    if len(specks):
        apart = np.linalg.norm(places[None, :, :2] - specks[:, None], axis=-1)
        cost[len(cells) :] = np.where(apart < 2 * GATE_UM, 6.0 + np.square(apart / 6.0), FAR)
    own, blob = linear_sum_assignment(cost)
    pairs = [(int(i), int(j)) for i, j in zip(own, blob, strict=True) if cost[i, j] < FAR]
    count = len(cells)
    return {i: j for i, j in pairs if i < count}, {j for i, j in pairs if i >= count}


def stopped(
    cells: Sequence[FollowedCell],
    expected: Floats,
    places: Floats,
    owner: dict[int, int],
    specks: set[int],
) -> list[int]:
    """Assign free blobs to cells that have stopped or turned by themselves; return these cells.

    Such a cell is near its expected position and as large as the blob. `owner` {cell: blob} is
    updated.
    """
    taken = set(owner.values()) | specks
    free = [j for j in range(len(places)) if j not in taken]
    found = []
    for i, cell in enumerate(cells):
        if i in owner or not free or cell.merged:
            continue
        away = np.linalg.norm(places[free, :2] - expected[i, :2], axis=1)
        ratio = np.abs(np.log(places[free, 3:5] / (cell.long, cell.wide))).max(axis=1)
        k = int(np.argmin(np.where(ratio < ALIKE, away, np.inf)))
        if away[k] < STOPPED_UM + STOPPED_UM_S * cell.missed_s and ratio[k] < ALIKE:
            owner[i] = free.pop(k)
            found.append(i)
    return found


def shared_blobs(
    cells: Sequence[FollowedCell],
    pixels: Floats,
    blobs: Sequence[Blob],
    owner: dict[int, int],
    um_px: float,
) -> dict[int, list[int]]:
    """Return {blob: cells}; a cell without a blob gets the blob that covers its expected position.

    `pixels` (C, 2) are the cells' expected columns and rows; `owner` {cell: blob} is completed.
    """
    shared: dict[int, list[int]] = {}
    for i, j in owner.items():
        shared.setdefault(j, []).append(i)
    middles = np.array([(blob.x, blob.y) for blob in blobs])
    reach = np.array([blob.long + FAR_PX for blob in blobs])
    for i, cell in enumerate(cells):
        if i in owner or not blobs:
            continue
        away = np.hypot(*(middles - pixels[i]).T)
        gaps = np.full(len(blobs), np.inf)
        for j in np.flatnonzero(away <= reach).tolist():
            held = [cells[k].long * cells[k].wide for k in shared.get(j, ())]
            room = um_px**2 * blobs[j].long * blobs[j].wide > LARGE * max(held, default=0.0)
            if cell.missed_s > 0 and not room:  # the cell was outside this blob before
                continue
            gaps[j] = um_px * np.linalg.norm(blobs[j].pixels - pixels[i], axis=1).min()
        j = int(np.argmin(gaps))
        if gaps[j] < COVER * cell.wide:
            owner[i] = j
            shared.setdefault(j, []).append(i)
    return shared


def separated(
    cells: Sequence[FollowedCell],
    expected: Floats,
    places: Floats,
    owner: dict[int, int],
    shared: dict[int, list[int]],
    specks: set[int],
    hidden: Floats,
) -> None:
    """Assign free blobs to cells that have left a shared blob nearby; update `owner` and `shared`.
    The cells may be away from their expected positions. A free blob near `hidden` (S, 2) is a speck
    that a cell had covered, and is not assigned.
    """
    away = np.linalg.norm(places[:, None, :2] - hidden, axis=2).min(axis=1, initial=np.inf)
    free = [
        k for k in range(len(places)) if k not in shared and k not in specks and away[k] > SPECK_UM
    ]
    for j in [j for j, owners in shared.items() if len(owners) > 1]:
        for k in free:
            owners = shared[j]
            if len(owners) < 2 or np.linalg.norm(places[k, :2] - places[j, :2]) > PARTED_UM:
                continue
            sizes = np.array([(cells[i].long, cells[i].wide) for i in owners])
            alike = np.abs(np.log(places[k, 3:5] / sizes)).max(axis=1) < ALIKE
            gaps = np.linalg.norm(expected[owners, None, :2] - places[None, (k, j), :2], axis=2)
            cost = np.where(alike, gaps[:, 0] - gaps[:, 1], np.inf)
            if len(owners) == 2:  # the shared blob must not be too large for the cell left in it
                cost[places[j, 3] * places[j, 4] > LARGE * sizes[::-1].prod(axis=1)] = np.inf
            if k not in shared and np.isfinite(cost.min()):
                i = owners.pop(int(cost.argmin()))
                owner[i], shared[k] = k, [i]


def parted(owners: Sequence[FollowedCell], expected: Floats, points: Floats) -> Floats:
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


def second_best(squared: Floats, best: float) -> float:
    """Return the least sum of squared distances among all assignments of tracks to cells except the
    best, whose sum is `best`; `squared` (K, K) are the squared distances.
    """
    track, cell = linear_sum_assignment(squared)
    least = math.inf
    for t, c in zip(track, cell, strict=True):
        other = squared.copy()
        other[t, c] = 1e6
        i, j = linear_sum_assignment(other)
        least = min(least, float(other[i, j].sum()))
    return least if least > best else best
