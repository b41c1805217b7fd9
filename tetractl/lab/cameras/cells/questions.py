"""The question which cell is on which track, and what is known of the cells."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.cell import Track

SURE = 0.998  # probability at which a question ends
LEAST_S, PATIENCE_S = 0.25, 10.0  # shortest and longest time for which a question is open
# exponent of likelihoods, since errors of successive pictures are not independent, and the most
# that one picture says against a cell
TEMPER, WORSE = 0.4, 4.0
TAIL = 4.0  # degrees of freedom (Student's t) of places and of the logarithms of sizes
SIZE_SD, SIZED = 0.1, 6  # scale of the log of a size; number of pictures in which sizes count


@dataclass(slots=True, eq=False)
class Known:
    """A cell that a track may be: its `name`, the probability `certainty` that it is that cell, and
    its length and width `size` [um], NaN if unknown.

    The filter's `row` is predicted without measurements; None for a cell that may have been
    anywhere. A `lost` cell has been lost at the time `lost_s` [s].
    """

    name: int
    row: int | None
    certainty: float = 1.0
    size: tuple[float, float] = (math.nan, math.nan)
    lost: Track | None = None
    lost_s: float = 0.0


@dataclass(slots=True, eq=False)
class Meeting:
    """Tracks that are too near to tell which of the `cells` is on which. `met` is whether something
    unknown may have joined them. `before` is a question that was open among just these tracks.
    """

    tracks: list[Track]
    cells: list[Known]
    met: bool
    before: "Question | None" = None


@dataclass(slots=True, eq=False)
class Question:
    """The open question which of M `cells` are on K <= M `tracks`, asked at `since_s` [s].

    `rows[t, n]` (K, M) is the filter's row that follows track t as cell n, `likelihood` (K, M) the
    sum of its log-likelihoods. `prior` (P,) is the log-probability of each assignment in `orders`
    (P, K) when the question was asked.
    """

    tracks: tuple[Track, ...]
    cells: tuple[Known, ...]
    rows: np.ndarray
    prior: Floats
    since_s: float
    likelihood: Floats = field(init=False)
    orders: np.ndarray = field(init=False)
    _sized: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.likelihood = np.zeros(self.rows.shape)
        self.orders = orders(*self.rows.shape)
        self._sized = np.zeros(len(self.tracks), int)

    def add(self, track: Track, likelihood: Floats, size: Sequence[float] | None) -> None:
        """Add the log-likelihoods (M,), one per cell, of a track's measurement in one picture, and
        length and width [um] of the blob, unless it is cut off.
        """
        t = self.tracks.index(track)
        self.likelihood[t] += TEMPER * np.maximum(likelihood - likelihood.max(), -WORSE)
        if size is not None and self._sized[t] < SIZED:
            self._sized[t] += 1
            sizes = np.array([cell.size for cell in self.cells])
            squared = np.square(np.log(np.array(size) / sizes) / SIZE_SD)
            each = -(TAIL + 1) / 2 * np.log1p(squared / TAIL).sum(axis=1)
            self.likelihood[t] += np.nan_to_num(each) / SIZED

    def probabilities(self) -> Floats:
        """Return the probability of each assignment of cells to tracks (P,), as in `orders`."""
        logs = self.prior + self.likelihood[np.arange(len(self.tracks)), self.orders].sum(axis=1)
        return normalised(logs)

    def best(self) -> tuple[tuple[int, ...], Floats]:
        """Return the cell of each track in the likeliest assignment, and for each track (K,) the
        probability that this cell is on it.
        """
        shares = self.probabilities()
        order = self.orders[int(np.argmax(shares))]
        return tuple(order.tolist()), shares @ (self.orders == order)

    def ends(self, now_s: float) -> bool:
        """Return whether the answer is certain enough, or has been waited for long enough."""
        open_s = now_s - self.since_s
        return open_s > PATIENCE_S or (open_s > LEAST_S and self.probabilities().max() > SURE)


def orders(tracks: int, cells: int) -> np.ndarray:
    """Return all assignments (P, tracks) of different cells to tracks."""
    return np.array(list(permutations(range(cells), tracks)), int).reshape(-1, tracks)


def normalised(logs: Floats) -> Floats:
    """Return probabilities from their logarithms up to a constant."""
    shares = np.exp(logs - logs.max())
    return shares / shares.sum()
