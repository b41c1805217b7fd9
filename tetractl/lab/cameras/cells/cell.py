"""A tracked cell, and its state in one picture."""

import math
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.detect_cells import Blob
from tetractl.lab.cameras.cells.identity import Question


@dataclass(frozen=True, slots=True)
class SeenCell:
    """One cell in one picture.

    x, y [um] is the middle of the body, `axis` [rad] its direction, `heading` [rad] the direction
    of the helix's axis, which turns by equation (3) of the paper. `mean` (12,) and `covariance`
    (12, 12) are the filter's state. `probability` is the probability that this is the cell with the
    number `identity`. `found`: the cell has a blob; `merged`: its blob shows other cells, too.
    `track` is the number of the cell's path. `measured` (6,) are x, y, axis of the cell's own blob
    and their standard deviations; None if the cell has no blob of its own.
    """

    identity: int
    x: float
    y: float
    axis: float
    heading: float
    mean: Floats
    covariance: Floats
    probability: float
    found: bool
    merged: bool
    long_um: float
    wide_um: float
    track: int
    measured: tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class CellAnswer:
    """Which cell is on which track after cells have met: `identities[i]` is on `tracks[i]` from the
    time `since_s` [s] on, with the given probability.
    """

    tracks: tuple[int, ...]
    identities: tuple[int, ...]
    since_s: float
    probability: float


@dataclass(frozen=True, slots=True)
class Born:
    """A cell that appears on a new track.

    `path` (M, 4) is the path by which it was recognised as a cell: time [s], x, y [um], axis [rad].
    `certainty` is the probability of `identity`, below 1 for a lost cell that was found again.
    `divided` is the number of the cell from whose blob it separated, if no other cell had entered
    that blob; otherwise None.
    """

    identity: int
    track: int
    path: Floats
    certainty: float
    divided: int | None


@dataclass(slots=True)
class FollowedCell:
    """A cell that the tracker follows.

    `row` is its row in the filter, `long` and `wide` are its usual length and width [um],
    `missed_s` is the time since it last had a blob [s], and `odd` counts its successive blobs far
    from the expected position.
    """

    identity: int
    track: int
    row: int
    long: float
    wide: float
    certainty: float = 1.0  # probability of its identity, without its open question
    missed_s: float = 0.0
    odd: int = 0
    merge: "Merge | None" = None
    blob: Blob | None = None
    merged: bool = False
    question: Question | None = None
    place: int = 0  # index of this track in `question`
    # time [s] and x, y [um] of the cell's first blob; None once the cell has swum far enough
    begun: tuple[float, float, float] | None = None
    measured: tuple[float, ...] | None = None
    last: Floats = field(default_factory=lambda: np.zeros(2))  # position of its last blob [um]
    large: bool = False  # whether its blob in the newest picture is too large for one cell
    alone: int | None = None  # filter row predicted without measurements while `large`
    size: tuple[float, float] = (math.nan, math.nan)  # length and width before `large` [um]
    large_s: float = -math.inf  # last time when the blob was too large [s]
    met: bool = False  # whether an object that is not followed may have entered its blob


@dataclass(slots=True)
class Merge:
    """Cells that share a blob; copies of their filter rows are predicted without measurements."""

    cells: list[FollowedCell]
    coasted: dict[int, int]  # row of each copy, by the cell's number
    seen: bool = True
