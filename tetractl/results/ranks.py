"""Tests by ranks, which assume no distribution, and Holm's correction for several of them.

Both p-values are two-sided and exact as long as there are at most EXACT values: the distribution of
the sum of ranks is counted out over all equally probable cases, tied values sharing their mean rank
as they are. With more values it is taken as normal, with the variance that the ties leave.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tetractl.core.poses import Floats

EXACT = 60  # values


def signed_rank(differences: Floats) -> float:
    """Return the p-value of Wilcoxon's signed-rank test that differences (n,) lie round 0.

    Differences of exactly 0 are left out. NaN where none is left.
    """
    kept = differences[differences != 0]
    n = len(kept)
    if n == 0:
        return math.nan
    double = _double_ranks(np.abs(kept))  # whole numbers, where mean ranks may be halves
    positive, total = int(double[kept > 0].sum()), int(double.sum())
    if n > EXACT:
        variance = float((double.astype(float) ** 2).sum()) / 4
        return _normal(positive - total / 2, variance)
    ways = np.zeros(total + 1)  # of reaching each sum, as probabilities
    ways[0] = 1.0
    for rank in double.tolist():
        ways[rank:] = (ways[rank:] + ways[: total + 1 - rank]) / 2
        ways[:rank] /= 2
    return _two_sided(ways, positive)


def rank_sum(ours: Floats, theirs: Floats) -> float:
    """Return the p-value of the rank-sum test (Wilcoxon, Mann and Whitney) that values (m,) are as
    large as values (n,). NaN where a side is empty."""
    m, n = len(ours), len(theirs)
    if min(m, n) == 0:
        return math.nan
    double = _double_ranks(np.concatenate([ours, theirs]))
    mine = int(double[:m].sum())
    expected = m * (m + n + 1)
    if m + n > EXACT:
        spread = float(((double - double.mean()) ** 2).sum())
        variance = m * n * spread / ((m + n) * (m + n - 1)) if m + n > 1 else 0.0
        return _normal(mine - expected, variance)
    total = int(double.sum())
    ways = np.zeros((m + 1, total + 1))  # of reaching each sum with so many ranks
    ways[0, 0] = 1.0
    for rank in double.tolist():
        ways[1:, rank:] += ways[:-1, : total + 1 - rank]
    return _two_sided(ways[m] / ways[m].sum(), mine)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for being several, by Holm (Scand. J. Statist. 6, 1979).

    The i-th smallest of k is multiplied by k - i + 1, and is at least the one before. NaN stays,
    and does not count.
    """
    order = sorted((p, i) for i, p in enumerate(p_values) if not math.isnan(p))
    found, least = [math.nan] * len(p_values), 0.0
    for rank, (p, i) in enumerate(order):
        least = max(least, min(1.0, p * (len(order) - rank)))
        found[i] = least
    return found


def _double_ranks(values: Floats) -> NDArray[np.int64]:
    """Return twice the rank of each value, ties sharing their mean rank."""
    ordered = np.sort(values)
    below, up_to = (np.searchsorted(ordered, values, side) for side in ("left", "right"))
    return below + up_to + 1


def _two_sided(probability: Floats, seen: int) -> float:
    """Return the probability of a sum at least as far out as the one seen, on either side."""
    tails = probability[: seen + 1].sum(), probability[seen:].sum()
    return min(1.0, 2 * float(min(tails)))


def _normal(off: float, variance: float) -> float:
    if variance <= 0:
        return 1.0
    return 2 * float(special.ndtr(-abs(off) / math.sqrt(variance)))
