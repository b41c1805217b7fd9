"""Measure how late messages are, from time stamps of a clock that may differ from ours.

The fastest of the last STAMPS_MAX messages counts as not late. Any other message is late by the
difference between its own time from stamp to arrival and that of the fastest message.
"""

from collections import deque

STAMPS_MAX = 600
"""Number of recent messages among which the fastest is searched: 6 s at 100 Hz."""


class StampClock:
    """Compares the time stamps of messages, on the sender's clock, with their arrivals."""

    def __init__(self) -> None:
        self._gaps_ns = deque[int](maxlen=STAMPS_MAX)

    def measure_lateness_ns(self, stamp_ns: int, received_ns: int) -> int:
        """Add a message, and return how much later it arrived than the fastest message [ns].

        Args:
            stamp_ns: The time stamp of the message, on the sender's clock [ns].
            received_ns: When the message arrived, on the host's clock [ns].
        """
        gap_ns = received_ns - stamp_ns
        self._gaps_ns.append(gap_ns)
        return gap_ns - min(self._gaps_ns)

    @property
    def shortest_gap_ns(self) -> int | None:
        """The shortest difference between arrival and time stamp of recent messages [ns].

        The sender's clock may have any zero. None before the first message.
        """
        return min(self._gaps_ns, default=None)
