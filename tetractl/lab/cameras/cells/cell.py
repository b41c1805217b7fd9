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
    of the helix, which (3) turns. `mean` (12,) and `covariance` (12, 12) are the filter's state.
    `probability` is the probability that this is the cell with the number `identity`. `found`: the
    cell has a blob; `merged`: it shares the blob with others. `track` is the number of the path to
    which it belongs. `measured` (6,) is the measurement by the cell's own blob: x, y, axis and
    their deviations; None without an own blob.
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
    """The answer to a question of identity, valid since a time [s]: the cell of each track, and the
    probability of that assignment.
    """

    tracks: tuple[int, ...]
    identities: tuple[int, ...]
    since_s: float
    probability: float


@dataclass(frozen=True, slots=True)
class Born:
    """A cell that appears on a new track, and the path (M, 4) by which it was recognised: seconds,
    x, y [um], axis.

    `certainty` is below 1 if it is one that was lost. `divided` is the cell out of whose blob it
    came although nothing had come into it, None for none.
    """

    identity: int
    track: int
    path: Floats
    certainty: float
    divided: int | None


@dataclass(slots=True)
class FollowedCell:
    """A cell that the tracker follows."""

    identity: int
    track: int
    row: int
    long: float
    wide: float
    certainty: float = 1.0  # probability of its identity after the closed questions
    missed_s: float = 0.0
    odd: int = 0
    merge: "Merge | None" = None
    blob: Blob | None = None
    merged: bool = False
    question: Question | None = None
    place: int = 0  # index of this track in its question
    # time [s] and x, y [um] of its first blob, until it swims
    begun: tuple[float, float, float] | None = None
    measured: tuple[float, ...] | None = None
    last: Floats = field(default_factory=lambda: np.zeros(2))  # where its last blob was [um]
    large: bool = False  # whether its blob in the newest picture is too large for it
    alone: int | None = None  # its row predicted by the signal alone, since its blob is too large
    size: tuple[float, float] = (math.nan, math.nan)  # its length and width then
    large_s: float = -math.inf  # when that last was so
    met: bool = False  # whether something not followed may have come into its blob


@dataclass(slots=True)
class Merge:
    """Cells that share a blob, and copies of their filter rows that are predicted without
    measurements.
    """

    cells: list[FollowedCell]
    coasted: dict[int, int]  # row of each copy, by the cell's number
    seen: bool = True
