"""The rates commanded to the robots during the last seconds, for checks of their motion."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats

KEPT = 256  # transmissions for which there is room at first


class CommandHistory:
    """Rates in arrays of a `shape`, each commanded from its transmission until the next; 0 before
    the first.
    """

    def __init__(self, *shape: int) -> None:
        self._none = np.zeros(shape)
        self._times: list[int] = []
        self._sent = np.zeros((KEPT, *shape))  # of which the first rows are used

    def sent(self, now_ns: int, rates: Sequence[float] | Floats) -> None:
        """Take the rates of a transmission."""
        count = len(self._times)
        if count == len(self._sent):
            self._sent = np.concatenate([self._sent, np.zeros_like(self._sent)])
        self._sent[count] = rates
        self._times.append(now_ns)
        old = bisect_right(self._times, now_ns - 2 * SECOND)
        if old > 64:  # old entries are removed occasionally, all at once
            self._sent[: count + 2 - old] = self._sent[old - 1 : count + 1].copy()
            del self._times[: old - 1]

    def acting(self, since_ns: int, until_ns: int) -> tuple[list[int], Floats]:
        """Return the transmissions of which one acted between two times: times (K,), and rates (K,
        ...), a view."""
        first = max(0, bisect_right(self._times, since_ns) - 1)
        last = bisect_right(self._times, until_ns)
        return self._times[first:last], self._sent[first:last]

    def mean(self, until_ns: int, dt_ns: int) -> Floats:
        """Return the mean of the rates commanded during the `dt_ns` before a time."""
        first = until_ns - dt_ns
        k = bisect_left(self._times, until_ns) - 1
        if k >= 0 and self._times[k] <= first:  # the most frequent case
            return self._sent[k] * dt_ns / dt_ns
        total = self._none
        while k >= 0:
            since = max(self._times[k], first)
            total = total + self._sent[k] * (until_ns - since)
            if since == first:
                break
            until_ns = since
            k = bisect_left(self._times, since) - 1
        return total / dt_ns
