"""Infers which cell is which after cells have shared a blob, from their responses to the signal.

Each cell that leaves a merged blob is followed by one filter per cell that entered the blob, with
that cell's turning rate, bias, speed and helix. The later measurements give the likelihood of each
assignment of cells; the question is closed once one assignment is certain, or after a time limit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.helix import HelixFilter

MOST = 4  # most cells whose identities are resolved jointly: 4! = 24 assignments
SURE = 0.998  # probability at which a question is closed
LEAST_S = 0.25  # shortest time that a question is open
PATIENCE_S = 10.0  # time after which a question is closed, certain or not
TEMPER = 0.7  # exponent of likelihoods, since errors of successive pictures are not independent
FIRST = (2.0, 2.0, 0.1)  # standard deviations of a track's first blob in a question: um, um, rad
FAR = 25.0  # squared distance, in standard deviations, above which a cell is moved to its track
SIZE_SD, SIZE_TAIL = 0.1, 4.0  # scale and degrees of freedom (Student's t) of the log of a size
SIZED = 6  # number of first pictures in which the sizes of a question's tracks are measured


@dataclass(slots=True)
class Question:
    """The open question which of K cells is on which of K tracks.

    `rows[t, i]` (K, K) is the filter's row that follows track t as cell i. `likelihood` (K, K) is
    the sum of these rows' log-likelihoods since `since_s`, when the question was opened. `sizes`
    (K, 2) are length and width [um] of the cells, NaN if unknown.
    """

    identities: tuple[int, ...]
    rows: np.ndarray
    since_s: float
    sizes: Floats
    likelihood: Floats = field(init=False)
    _orders: np.ndarray = field(init=False)
    _sized: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.identities)
        self.likelihood = np.zeros((count, count))
        self._sized = np.zeros(count, int)
        self._orders = np.array(list(permutations(range(count))))

    def add(self, track: int, likelihood: Floats) -> None:
        """Add the log-likelihoods (K,), one per cell, of a track's measurement in one picture."""
        self.likelihood[track] += TEMPER * likelihood

    def add_size(self, track: int, size: Sequence[float]) -> None:
        """Add length and width [um] of a track's blob in one of the first `SIZED` pictures."""
        if self._sized[track] < SIZED:
            self._sized[track] += 1
            squared = np.square(np.log(np.array(size) / self.sizes) / SIZE_SD)
            each = -(SIZE_TAIL + 1) / 2 * np.log1p(squared / SIZE_TAIL).sum(axis=1)
            self.likelihood[track] += np.nan_to_num(each) / SIZED

    def probabilities(self) -> Floats:
        """Return the probability of each assignment of cells to tracks, in the order of
        `_orders`.
        """
        count = len(self.identities)
        logs = self.likelihood[np.arange(count), self._orders].sum(axis=1)
        shares = np.exp(logs - logs.max())
        return shares / shares.sum()

    def best(self) -> tuple[tuple[int, ...], float]:
        """Return the cell of each track in the likeliest assignment, and its probability."""
        shares = self.probabilities()
        i = int(np.argmax(shares))
        return tuple(self._orders[i].tolist()), float(shares[i])

    def closed(self, now_s: float) -> bool:
        """Return whether the answer is certain enough, or the time limit has passed."""
        open_s = now_s - self.since_s
        return (self.best()[1] > SURE and open_s > LEAST_S) or open_s > PATIENCE_S


def opened(
    bank: HelixFilter,
    identities: Sequence[int],
    coasted: Sequence[int],
    seen: Floats,
    sizes: Floats,
    now_s: float,
) -> Question:
    """Return a new question: which of the cells, predicted in the filter rows `coasted` since they
    merged, is on which track.

    `seen` (K, 3) are x, y, heading of the tracks now [um, rad]; `sizes` (K, 2) length and width of
    the cells [um], NaN for a new cell. A cell predicted far from a track is moved to the track; its
    speed, turning and helix rate are kept.
    """
    count = len(identities)
    rows = np.array([[bank.copied(row) for row in coasted] for _ in seen])
    question = Question(tuple(identities), rows, now_s, sizes)
    for track, place in enumerate(seen):
        likelihood, distance = bank.update(
            rows[track], np.tile(place, (count, 1)), np.tile(FIRST, (count, 1))
        )
        new = np.isnan(sizes[:, 0])  # new cells may have been anywhere
        question.add(track, np.where(new, 0.0, likelihood))
        for i in np.flatnonzero((distance > FAR) | new).tolist():
            bank.drop(int(rows[track, i]))
            rows[track, i] = bank.moved(coasted[i], *place.tolist())
    return question
