"""Counts the pictures or datagrams of the last second that a camera could not read."""

from collections import deque

from tetractl.core.clock import SECOND


class DamageCount:
    """The totals within the last second."""

    def __init__(self) -> None:
        self._totals: deque[tuple[int, int]] = deque()

    def recent(self, now_ns: int, total: int) -> int:
        """Take the total at a time [ns]; return by how much it rose within the second before."""
        self._totals.append((now_ns, total))
        while self._totals and self._totals[0][0] < now_ns - SECOND:
            self._totals.popleft()
        return total - self._totals[0][1]
