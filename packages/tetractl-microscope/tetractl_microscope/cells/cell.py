"""A tracked object of a dish, and a cell's state in one picture."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.detect_cells import Blob

if TYPE_CHECKING:
    from tetractl_microscope.cells.names import Meeting, Question

Entry = tuple[float, float, float, float, float, float]
"""A blob: time [s], x, y [um], axis [rad], length and width [um], NaN if it is cut off."""


@dataclass(frozen=True, slots=True)
class SeenCell:
    """One cell in one picture.

    x, y [um] is the middle of the body, `axis` [rad] its direction, `heading` [rad] the direction
    of the helix's axis, which turns by equation (3) of the paper. `mean` (12,) and `covariance`
    (12, 12) are the filter's state. `probability` is the probability that this is the cell with the
    number `identity`. `found`: the cell has a blob; `merged`: its blob shows other cells, too.
    `track` is the number of the cell's track. `measured` (6,) are x, y, axis of the cell's own blob
    and their standard deviations; None if the cell has no blob of its own. `blob_um` (5,) are
    x, y [um], axis [rad], length and width [um] of the blob; None if the cell has none. `sure` is
    whether a whole film leaves no doubt that this is the cell that had the number at first.
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
    blob_um: Floats | None
    sure: bool = True


@dataclass(frozen=True, slots=True)
class CellAnswer:
    """Which cell is on which track after cells have met.

    `named` are, for each track, its number, the number of its cell, the probability that it is that
    cell, and the time [s] since which it is. `asked` are the cells that met, and `probability` is
    that of the likeliest assignment of them.
    """

    named: tuple[tuple[int, int, float, float], ...]
    probability: float
    asked: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Born:
    """A cell that appears on a new track.

    `path` (M, 6) is the path by which it was recognised as a cell: time [s], x, y [um], axis [rad],
    length and width [um], NaN for a blob cut off by the picture's edge.
    `certainty` is the probability of `identity`, below 1 for a lost cell that was found again.
    `divided` is the number of the cell from whose blob it separated, if no other cell had entered
    that blob; otherwise None. `near` is the track near whose blob it was first seen, or None.
    """

    identity: int
    track: int
    path: Floats
    certainty: float
    divided: int | None
    near: int | None


@dataclass(slots=True, eq=False)
class CellTrack:
    """An object that the tracker follows: a cell, or, before it has swum, a speck.

    `path` holds its newest blobs. A cell has a `row` in the filter; a speck has none. `long` and
    `wide` are the usual length and width [um], `missed_s` is the time since the last blob [s], and
    `odd` counts successive blobs far from the expected position. `near` is the cell near which a
    speck was first seen, or None.
    """

    number: int
    path: list[Entry]
    row: int | None = None
    identity: int = 0
    certainty: float = 1.0  # probability of the identity, without an open question
    long: float = math.nan
    wide: float = math.nan
    missed_s: float = 0.0
    odd: int = 0
    near: "CellTrack | None" = None
    blob: Blob | None = None
    place: Floats | None = None  # x, y, axis, length and width of its blob (5,) [um, rad]
    merged: bool = False  # whether its blob shows other cells, too
    hidden_s: float = math.inf  # since then, its shared blob has been as small as one cell
    large: bool = False  # whether its own blob is too large for one cell
    sized_s: float = 0.0  # last time when the blob had the cell's size
    pair_s: float = -math.inf  # until then, its blob may show two cells that came together
    measured: tuple[float, ...] | None = None
    # x, y [um] and time [s] of the cell's first blob; None once it has swum far enough
    begun: tuple[float, float, float] | None = None
    meeting: "Meeting | None" = None
    together_s: float = (
        -math.inf
    )  # last time when it was too near to another cell to be distinguished
    question: "Question | None" = None
    last: Floats = field(default_factory=lambda: np.zeros(2))  # position of its last blob [um]

    @property
    def filter_row(self) -> int:
        """The cell's row in the filter."""
        assert self.row is not None, "a speck has no row in the filter"
        return self.row

    def ahead(self, seconds: float) -> tuple[float, float]:
        """Return the position x, y [um] that the last motion predicts for a time [s]."""
        last = self.path[-1]
        if len(self.path) < 2 or self.missed_s > 0.1:
            return last[1], last[2]
        first = self.path[max(0, len(self.path) - 4)]
        ratio = (seconds - last[0]) / max(last[0] - first[0], 1e-3)
        return last[1] + (last[1] - first[1]) * ratio, last[2] + (last[2] - first[2]) * ratio
