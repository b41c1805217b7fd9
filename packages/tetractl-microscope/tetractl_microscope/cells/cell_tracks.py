"""The tracks of the cells in a dish, and the inference of which cell is on which track."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import BodySize, PathBlob
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


@dataclass(slots=True)
class TrackBlob:
    """The blob that shows a cell in the newest image.

    Attributes:
        index: Its index among the image's blobs.
        blob: The blob.
        place: x, y [um], axis [rad], length and width [um], shape (5,).
        is_shared: Whether it also shows other tracked cells.
        is_large: Whether it is the cell's own blob, but too large for one cell.
    """

    index: int
    blob: Blob
    place: Floats
    is_shared: bool = False
    is_large: bool = False

    @property
    def whole_place(self) -> Floats:
        """The place of the blob, shape (5,): x, y [um], axis [rad], length and width [um].

        Length and width are NaN if the image's edge cuts the blob off.
        """
        if not self.blob.at_edge:
            return self.place
        return np.array((*self.place[:3], math.nan, math.nan))


@dataclass(slots=True, eq=False)
class CellTrack:
    """A cell that is tracked from image to image.

    Attributes:
        number: Number of the track.
        row: Row of the filter that predicts the cell.
        size: Size of the cell.
        last: Position of its last blob [um], shape (2,).
        path: Its newest blobs that show only this cell.
        missed_s: Time since its last blob [s].
        newest: Its blob in the newest image. None if it has none.
        size_seen_s: When a blob of its own last had the cell's size [s]. The size of a blob shows
            how many cells it contains.
        start: Its first position [um], shape (2,). None once it has swum far enough.
        began_s: When the track began [s].
        outliers_in_row: Number of successive blobs far from the filter's prediction.
        identity: Number of the cell that is most probably on the track; see `Names`.
        certainty: Probability of that identity while the track is in no meeting and no question.
        meeting: The meeting that it takes part in. None if there is none.
        question: The open question about its identity. None if there is none.
        together_s: When it was last too close to another cell to be distinguished [s].
    """

    number: int
    row: int
    size: BodySize
    last: Floats
    path: list[PathBlob] = field(default_factory=list)
    missed_s: float = 0.0
    newest: TrackBlob | None = None  # in the newest picture
    size_seen_s: float = 0.0
    start: Floats | None = None
    began_s: float = 0.0
    outliers_in_row: int = 0
    identity: int = 0
    certainty: float = 1.0
    meeting: "Meeting | None" = None
    question: "WhichIsWhich | None" = None
    together_s: float = -math.inf

    @property
    def is_new(self) -> bool:
        """Whether the cell has not yet swum as far as a cell must."""
        return self.start is not None

    @property
    def is_shared(self) -> bool:
        """Whether the blob that shows this cell in the newest image also shows other cells.

        It is False if no blob shows the cell.
        """
        return self.newest is not None and self.newest.is_shared

    @property
    def rows(self) -> Sequence[int]:
        """The rows of the filter that follow the track.

        While its identity is an open question, there is one row for each cell that it may be.
        """
        if self.question is None:
            return [self.row]
        return self.question.rows[self.question.tracks.index(self)].tolist()

    def shift(self, x: float, y: float) -> None:
        """Move all stored positions by x and y [um], with the content of the image."""
        self.path = [blob.moved(x, y) for blob in self.path]
        by_um = np.array((x, y))
        self.last = self.last + by_um
        if self.start is not None:
            self.start = self.start + by_um


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """A track in a meeting, and the cell that was on it when it joined.

    Attributes:
        track: The track.
        row: The filter's row that predicts the cell without measurements.
        name: Number of the cell.
        certainty: Probability that it is this cell.
        size: Size of the cell.
    """

    track: CellTrack
    row: int
    name: int
    certainty: float
    size: BodySize


@dataclass(slots=True, eq=False)
class Meeting:
    """Tracks that are too close together to distinguish their cells.

    Attributes:
        members: The tracks, with the cell that was on each of them when it joined.
        with_unknown: Whether an unknown object may have joined them.
    """

    members: list[Member]
    with_unknown: bool

    @property
    def tracks(self) -> list[CellTrack]:
        """The tracks that are too close together now, one for each member."""
        return [member.track for member in self.members]

    @property
    def rows(self) -> list[int]:
        """The rows of the filter that predict the members' cells."""
        return [member.row for member in self.members]


@dataclass(slots=True, eq=False)
class WhichIsWhich:
    """The open question of which cell is on which track, after K cells were in a meeting.

    Attributes:
        members: The K cells and tracks.
        rows: The filter's row that follows track t as cell n, shape (K, K).
        prior: Log-probability of each assignment in `orders` when the question arose, shape (P,).
        not_unknown: Probability that the cell, and not an unknown object, is on the track, (K, K).
        since_s: When the question arose [s].
        likelihood: Sum of the log-likelihoods of each of `rows`, shape (K, K).
        orders: The possible assignments, shape (P, K).
    """

    members: Sequence[Member]
    rows: np.ndarray
    prior: Floats
    not_unknown: Floats
    since_s: float
    likelihood: Floats = field(init=False)
    orders: np.ndarray = field(init=False)
    _sized: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.likelihood = np.zeros(self.rows.shape)
        self.orders = orders(len(self.members))
        self._sized = np.zeros(len(self.members), int)

    @property
    def tracks(self) -> list[CellTrack]:
        """The tracks that have separated, and for which it is open which cell is which."""
        return [member.track for member in self.members]

    def add(
        self, track: CellTrack, likelihood: Floats, size: Sequence[float] | None, seconds: float
    ) -> None:
        """Add a measurement of a track from one image.

        Measurements count once the filter's rows have settled on the track, because the beginning
        is part of the prior.

        Args:
            track: The track.
            likelihood: Log-likelihood of the measurement for each cell, shape (K,).
            size: Length and width of the blob [um]. None if it is cut off.
            seconds: Time of the image [s].
        """
        t = self.tracks.index(track)
        if seconds - self.since_s > SETTLED_S:
            self.likelihood[t] += TEMPER * np.maximum(likelihood - likelihood.max(), -WORSE)
        if size is not None and self._sized[t] < SIZED:
            self._sized[t] += 1
            sizes = np.array([member.size for member in self.members])
            squared = np.square(np.log(np.array(size) / sizes) / SIZE_SD)
            log_likelihoods = -(TAIL + 1) / 2 * np.log1p(squared / TAIL).sum(axis=1)
            self.likelihood[t] += log_likelihoods / SIZED

    def probabilities(self) -> Floats:
        """Compute the probability of each assignment in `orders`, shape (P,)."""
        return normalised(self.prior + log_of_each(self.orders, self.likelihood))

    def best(self) -> tuple[tuple[int, ...], Floats]:
        """Find the most probable assignment.

        Returns:
            The index of the cell on each track, and for each track the probability that this cell
            is on it, shape (K,).
        """
        shares = self.probabilities()
        order = self.orders[int(np.argmax(shares))]
        not_unknown = self.not_unknown[np.arange(len(order)), order]
        return tuple(order.tolist()), not_unknown * (shares @ (self.orders == order))

    def ends(self, now_s: float) -> bool:
        """Check whether the question is answered at a time [s].

        It is if the answer is certain enough after LEAST_S seconds, and in any case after
        PATIENCE_S.
        """
        open_s = now_s - self.since_s
        return open_s > PATIENCE_S or (open_s > LEAST_S and self.probabilities().max() > SURE)


def orders(tracks: int) -> np.ndarray:
    """Return all assignments of n cells to n tracks, shape (n!, n).

    Column t of a row is the index of the cell that track t shows.
    """
    all_orders = list(permutations(range(tracks)))
    return np.array(all_orders, int).reshape(-1, tracks)


def log_of_each(orders: np.ndarray, table: Floats) -> Floats:
    """Compute the log-probability of each assignment, up to a constant.

    Args:
        orders: The assignments, shape (P, K).
        table: Log-probability of each cell (columns) on each track (rows), shape (K, K).

    Returns:
        The sum of `table[t, orders[p, t]]` over t, shape (P,).
    """
    return table[np.arange(len(table)), orders].sum(axis=1)


def normalised(logs: Floats) -> Floats:
    """Convert log-probabilities, known up to a constant, to probabilities that add up to 1."""
    shares = np.exp(logs - logs.max())
    return shares / shares.sum()


def log_densities(
    bank: HelixFilter, rows: Sequence[int], places: Floats, sd_um: Floats, unknown: float
) -> Floats:
    """Compute the log-density of cells at given places [1/um^2], shape (K, M).

    Args:
        bank: The filter.
        rows: The cells' rows, M of them.
        places: The places, shape (K, 3).
        sd_um: Additional standard deviations of the places [um], shape (K,).
        unknown: Log-density of a cell that may have been anywhere, because a cell may have turned
            by itself.
    """
    expected, spread = bank.expected(np.array(rows, int))
    spread = WIDER**2 * (spread + np.square(sd_um)[:, None, None, None] * np.eye(2))
    off = places[:, None, :2] - expected[None, :, :2]
    squared = np.einsum("tij,tijk,tik->ti", off, np.linalg.inv(spread), off)
    logs = -(TAIL + 2) / 2 * np.log1p(squared / TAIL) - math.log(math.tau)
    logs -= 0.5 * np.linalg.slogdet(spread)[1]
    return np.logaddexp(logs, unknown + math.log(TURNS))
