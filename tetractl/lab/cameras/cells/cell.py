"""A tracked cell, and its state in one picture."""

import math
from dataclasses import dataclass

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.detect_cells import Blob
from tetractl.lab.cameras.cells.identity import Question


@dataclass(frozen=True, slots=True)
class SeenCell:
    """One cell in one picture.

    x, y [um] is the middle of the body, `axis` [rad] its direction, `heading` [rad] that of the
    helix, which (3) turns. `covariance` (12, 12) is that of the filter's state `mean` (12,).
    `probability` is that of this being the cell of the number `identity`, and not another one.
    `found`: it has a blob; `merged`: it shares the blob with others. `track` is the number of the
    path that it is on. `measured` (6,) is the measurement by its blob alone: x, y, axis
    and their deviations; None if it has none of its own.
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
    """Which cell is which since a time [s]: the cell of each track, and the probability of this."""

    tracks: tuple[int, ...]
    identities: tuple[int, ...]
    since_s: float
    probability: float


@dataclass(frozen=True, slots=True)
class Born:
    """A new cell, and the path (M, 4) by which it was recognised: seconds, x, y [um], axis.

    `divided` is the cell out of whose blob it came although nothing had come into it, None for
    none.
    """

    identity: int
    path: Floats
    divided: int | None


@dataclass(slots=True)
class FollowedCell:
    """A cell that is followed."""

    identity: int
    track: int
    row: int
    long: float
    wide: float
    certainty: float = 1.0  # that of its identity, by questions that are closed
    missed_s: float = 0.0
    odd: int = 0
    merge: "Merge | None" = None
    blob: Blob | None = None
    merged: bool = False
    question: Question | None = None
    place: int = 0  # of this track in the question
    begun: tuple[float, float, float] | None = None  # s, x, y: where it began, until it swims
    measured: tuple[float, ...] | None = None
    alone: int | None = None  # its row predicted by the signal alone, since its blob is too large
    size: tuple[float, float] = (math.nan, math.nan)  # its length and width then
    large_s: float = -math.inf  # when that last was so
    met: bool = False  # whether something not followed may have come into its blob


@dataclass(slots=True)
class Merge:
    """Cells that have been one blob, and their rows predicted by the signal alone."""

    cells: list[FollowedCell]
    coasted: dict[int, int]  # by identity
    seen: bool = True
