"""Infers the identities of cells after they were one blob from each cell's response to the known
signal.

Each cell that leaves a merged blob is followed once as each of the cells that entered it, with that
cell's known turning rate, bias, speed and helix. The question is closed once the likelihood of the
later measurements decides; if cells are too alike, it stays open and reports that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.helix import HelixFilter

MOST = 4  # largest number of cells in a question: 24 assignments
SURE = 0.998  # probability at which a question is closed
PATIENCE_S = 10.0  # time after which it is closed unanswered: the cells are indistinguishable
TEMPER = 0.7  # exponent of the likelihood, as errors of successive pictures are not independent


@dataclass(slots=True)
class Question:
    """The question which of K cells each of K tracks is.

    `rows` (K, K) are the filter's rows of track t as if it were cell i. `likelihood` (K, K) is the
    sum of their log-likelihoods since the question was opened at `since_s`.
    """

    identities: tuple[int, ...]
    rows: np.ndarray
    since_s: float
    likelihood: Floats = field(init=False)
    _orders: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.identities)
        self.likelihood = np.zeros((count, count))
        self._orders = np.array(list(permutations(range(count))))

    def add(self, track: int, likelihood: Floats) -> None:
        """Add the log-likelihoods of a track in one picture (K,)."""
        self.likelihood[track] += TEMPER * likelihood

    def probabilities(self) -> Floats:
        """Return the probability of each assignment, in the order of `orders`."""
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
        """Return whether the answer is certain, or can never become certain."""
        return self.best()[1] > SURE or now_s - self.since_s > PATIENCE_S


def opened(
    bank: HelixFilter, identities: Sequence[int], coasted: Sequence[int], now_s: float
) -> Question:
    """Return a new question of the cells' identities; `coasted` are their rows, predicted since
    they merged.
    """
    rows = np.array([[bank.copied(row) for row in coasted] for _ in identities])
    return Question(tuple(identities), rows, now_s)
