"""The tracks of a dish's objects, and the question which cell is on which track."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import PathBlob
from tetractl_microscope.cells.detect_cells import Blob
from tetractl_microscope.cells.helix import HelixFilter

SURE = 0.998  # probability at which a question ends
LEAST_S = 0.5  # shortest time for which a question is open
PATIENCE_S = 10.0  # longest
SETTLED_S = 0.3  # time after which the rows of a question have settled on their tracks
# exponent of likelihoods, since errors of successive pictures are not independent, and the most
# that one picture says against a cell
TEMPER = 0.3
WORSE = 4.0
# degrees of freedom (Student's t) of places and of the logarithms of sizes; scale of a place in the
# filter's standard deviations: how cells swim while they share a blob is known less well than that
TAIL = 2.0
WIDER = 1.4
SIZE_SD = 0.1  # scale of the log of a size
SIZED = 6  # number of pictures in which sizes count
TURNS = 0.2  # probability that a cell has turned by itself while it was with others


@dataclass(frozen=True, slots=True)
class CellStart:
    """Where [um] and when [s] a speck became a cell."""

    x: float
    y: float
    seconds: float


@dataclass(slots=True, eq=False)
class CellTrack:
    """An object that the tracker follows: a cell, or, before it has swum, a speck.

    `path` holds its newest blobs. A cell has a `row` in the filter; a speck has none. `long` and
    `wide` are the usual length and width [um], `missed_s` is the time since the last blob [s], and
    `odd` counts successive blobs far from the expected position. `near` is the cell near which a
    speck was first seen, or None.
    """

    number: int
    path: list[PathBlob]
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
    begun: CellStart | None = None  # None once the cell has swum far enough
    meeting: "Meeting | None" = None
    # last time when it was too near to another cell to be distinguished
    together_s: float = -math.inf
    question: "WhichIsWhich | None" = None
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
            return last.x, last.y
        first = self.path[max(0, len(self.path) - 4)]
        ratio = (seconds - last.seconds) / max(last.seconds - first.seconds, 1e-3)
        return last.x + (last.x - first.x) * ratio, last.y + (last.y - first.y) * ratio

    def shift(self, x: float, y: float) -> None:
        """Move all that is known of its places by x, y [um], with the picture's content."""
        self.path = [entry.moved(x, y) for entry in self.path]
        self.last = self.last + np.array((x, y))
        if self.begun is not None:
            self.begun = replace(self.begun, x=self.begun.x + x, y=self.begun.y + y)


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """A cell that a track may be: its `name`, the probability `certainty` that it is that cell, and
    its length and width `size` [um].
    """

    name: int
    certainty: float
    size: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """A track in a meeting, and the cell that it showed when it joined; the filter's `row` predicts
    that cell without measurements.
    """

    track: CellTrack
    cell: Known
    row: int


@dataclass(slots=True, eq=False)
class Meeting:
    """Tracks that are too near to tell which cell is on which. Something unknown may have joined
    them.
    """

    members: list[Member]
    with_unknown: bool

    @property
    def tracks(self) -> list[CellTrack]:
        """The tracks in it now."""
        return [member.track for member in self.members]

    @property
    def rows(self) -> list[int]:
        """The filter's rows that predict the members' cells."""
        return [member.row for member in self.members]


@dataclass(slots=True, eq=False)
class WhichIsWhich:
    """The open question which of K `cells` is on which of K `tracks`, asked at `since_s` [s].

    `rows[t, n]` (K, K) is the filter's row that follows track t as cell n, `likelihood` (K, K) the
    sum of its log-likelihoods. `prior` (P,) is the log-probability of each assignment in `orders`
    (P, K) when the question was asked, `not_unknown` (K, K) the probability that nothing unknown is
    there instead of the cell.
    """

    tracks: tuple[CellTrack, ...]
    cells: tuple[Known, ...]
    rows: np.ndarray
    prior: Floats
    not_unknown: Floats
    since_s: float
    likelihood: Floats = field(init=False)
    orders: np.ndarray = field(init=False)
    _sized: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.likelihood = np.zeros(self.rows.shape)
        self.orders = orders(len(self.tracks))
        self._sized = np.zeros(len(self.tracks), int)

    def add(
        self, track: CellTrack, likelihood: Floats, size: Sequence[float] | None, seconds: float
    ) -> None:
        """Add the log-likelihoods (K,), one per cell, of a track's measurement in one picture, and
        length and width [um] of the blob, unless it is cut off. Measurements count once the rows of
        the filter have settled on the track: where it begins is in the prior.
        """
        t = self.tracks.index(track)
        if seconds - self.since_s > SETTLED_S:
            self.likelihood[t] += TEMPER * np.maximum(likelihood - likelihood.max(), -WORSE)
        if size is not None and self._sized[t] < SIZED:
            self._sized[t] += 1
            sizes = np.array([cell.size for cell in self.cells])
            squared = np.square(np.log(np.array(size) / sizes) / SIZE_SD)
            log_likelihoods = -(TAIL + 1) / 2 * np.log1p(squared / TAIL).sum(axis=1)
            self.likelihood[t] += log_likelihoods / SIZED

    def probabilities(self) -> Floats:
        """Return the probability of each assignment of cells to tracks (P,), as in `orders`."""
        return normalised(self.prior + log_of_each(self.orders, self.likelihood))

    def best(self) -> tuple[tuple[int, ...], Floats]:
        """Return the cell of each track in the likeliest assignment, and for each track (K,) the
        probability that this cell is on it.
        """
        shares = self.probabilities()
        order = self.orders[int(np.argmax(shares))]
        not_unknown = self.not_unknown[np.arange(len(order)), order]
        return tuple(order.tolist()), not_unknown * (shares @ (self.orders == order))

    def on_track(self, t: int) -> Floats:
        """Return the probability (K,) that each cell is on the track with the index `t`."""
        has_cell = self.orders[:, t, None] == np.arange(len(self.cells))
        return self.probabilities() @ has_cell

    def ends(self, now_s: float) -> bool:
        """Return whether the answer is certain enough, or has been waited for long enough."""
        open_s = now_s - self.since_s
        return open_s > PATIENCE_S or (open_s > LEAST_S and self.probabilities().max() > SURE)


def orders(tracks: int) -> np.ndarray:
    """Return all assignments (P, tracks) of as many cells to tracks."""
    all_orders = list(permutations(range(tracks)))
    return np.array(all_orders, int).reshape(-1, tracks)


def log_of_each(orders: np.ndarray, table: Floats) -> Floats:
    """Return the log-probability of each assignment in `orders` (P, K), up to a constant, by those
    in `table` (K, K) of each cell on each track: the sum of `table[t, orders[p, t]]` over t.
    """
    return table[np.arange(len(table)), orders].sum(axis=1)


def normalised(logs: Floats) -> Floats:
    """Return probabilities from their logarithms up to a constant."""
    shares = np.exp(logs - logs.max())
    return shares / shares.sum()


def log_densities(
    bank: HelixFilter, rows: Sequence[int], places: Floats, sd_um: Floats, unknown: float
) -> Floats:
    """Return the log-density [1/um^2] of the cells in the filter's `rows` at places (K, 3), as
    (K, M), with further standard deviations (K,) of the places. `unknown` is that of a cell that
    may have been anywhere: a cell may have turned by itself.
    """
    expected, spread = bank.expected(np.array(rows, int))
    spread = WIDER**2 * (spread + np.square(sd_um)[:, None, None, None] * np.eye(2))
    off = places[:, None, :2] - expected[None, :, :2]
    squared = np.einsum("tij,tijk,tik->ti", off, np.linalg.inv(spread), off)
    logs = -(TAIL + 2) / 2 * np.log1p(squared / TAIL) - math.log(math.tau)
    logs -= 0.5 * np.linalg.slogdet(spread)[1]
    return np.logaddexp(logs, unknown + math.log(TURNS))
