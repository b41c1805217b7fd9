"""Identities of cells after they were one blob: probabilities from how each answers the known
signal.

Each cell that leaves a merged blob is followed once for every cell that went in, with what was
known of that one (turning rate, bias, speed, helix). Once the likelihood of the later measurements
decides, the question is closed; if cells are too alike it stays open, and says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.helix import HelixFilter

MOST = 4  # cells of one question: 24 assignments
SURE = 0.998  # then the question is closed
PATIENCE_S = 10.0  # after which it is closed without an answer: the cells are indistinguishable
TEMPER = 0.7  # of the likelihood: errors of successive pictures are not independent


@dataclass(slots=True)
class Question:
    """Which of K cells each of K tracks is.

    `rows` (K, K) are the filter's rows: track t as if it were cell i. `likelihood` (K, K) is the
    logarithm of each, summed since the question was opened at `since_s`.
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
        """Whether the answer is certain, or will never be."""
        return self.best()[1] > SURE or now_s - self.since_s > PATIENCE_S


def opened(
    bank: HelixFilter, identities: Sequence[int], coasted: Sequence[int], now_s: float
) -> Question:
    """Return the question of the cells' identities; their rows `coasted` since they merged."""
    rows = np.array([[bank.copied(row) for row in coasted] for _ in identities])
    return Question(tuple(identities), rows, now_s)
