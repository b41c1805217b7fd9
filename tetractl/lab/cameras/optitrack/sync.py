"""Relates the server's clock to the host's: offset, drift and round trip from echoes.

An echo says that the server's clock read `ticks` at some time between its sending and its return;
halfway is the best guess, with an error of at most half the round trip. Therefore only the echoes
with the shortest round trips are used, also for the fit of the drift.

Two echoes also bound the clock's rate between them, even with a slow network or host. If a clock
gained or lost more than `DRIFT_MAX`, it was set or runs wrongly, and `fault` says so.
"""

from collections import deque
from dataclasses import dataclass

from tetractl.core.clock import SECOND

KEPT = 120
BEST = 0.25  # fraction of the echoes, with the shortest round trips, that are used
DRIFT_SPAN = 5 * SECOND  # least time span of the echoes for a fit of the drift
DRIFT_MAX = 1e-3


@dataclass(frozen=True, slots=True)
class Echo:
    """One echo: host time halfway [ns], the server's clock at that time [ns], and round trip
    [ns].
    """

    host_ns: int
    server_ns: int
    round_trip_ns: int


class ClockSync:
    """Maps the ticks of a server's clock to the host's clock; needs at least one echo."""

    def __init__(self, clock_hz: int) -> None:
        self.clock_hz = clock_hz
        self.drift = 0.0  # time by which the server's clock gains on the host's, per unit of time
        self.fault = ""  # description of a fault of the clock, kept for good
        self._echoes: deque[Echo] = deque(maxlen=KEPT)
        self._at = Echo(0, 0, 0)

    @property
    def synced(self) -> bool:
        """Whether there is an echo, so that `to_host` can convert times."""
        return bool(self._echoes)

    @property
    def round_trip_ns(self) -> int:
        """Round trip of the reference echo [ns]; half of it bounds the error."""
        return self._at.round_trip_ns

    def add(self, sent_ns: int, returned_ns: int, ticks: int) -> None:
        """Take an echo: host times of sending and return [ns], and the server's ticks between."""
        if not 0 <= returned_ns - sent_ns <= SECOND:
            return
        halfway = (sent_ns + returned_ns) // 2
        echo = Echo(halfway, self._ns(ticks), returned_ns - sent_ns)
        self.fault = self.fault or self._contradiction(echo)
        self._echoes.append(echo)
        best = sorted(self._echoes, key=lambda echo: echo.round_trip_ns)
        best = best[: max(1, round(BEST * len(best)))]
        self._at = max(best, key=lambda echo: echo.host_ns)
        self.drift = _slope(best)

    def to_host(self, ticks: int) -> int:
        """Return the host time [ns] at which the server's clock showed `ticks`."""
        since = self._ns(ticks) - self._at.server_ns
        return self._at.host_ns + round(since / (1.0 + self.drift))

    def error_ns(self, host_ns: int) -> int:
        """Return the largest error of `to_host` near a host time [ns]."""
        # the error of `drift` is at most twice DRIFT_MAX
        drifted = 2 * DRIFT_MAX * abs(host_ns - self._at.host_ns)
        return self._at.round_trip_ns // 2 + round(drifted) + self._resolution_ns

    def _contradiction(self, new: Echo) -> str:
        """Return a description of the clock's fault since an earlier echo, "" if there is none."""
        for old in reversed(self._echoes):
            span = new.host_ns - old.host_ns
            gained = new.server_ns - old.server_ns - span
            unsure = (old.round_trip_ns + new.round_trip_ns) // 2 + self._resolution_ns
            if abs(gained) > unsure + DRIFT_MAX * abs(span):
                return (
                    f"the camera server's clock {'gained' if gained > 0 else 'lost'} "
                    f"{abs(gained) / 1e6:.1f} ms on this computer's within {span / SECOND:.2f} s: "
                    "it was set, or runs wrongly"
                )
        return ""

    @property
    def _resolution_ns(self) -> int:
        return 2 * SECOND // self.clock_hz + 1

    def _ns(self, ticks: int) -> int:
        return ticks * SECOND // self.clock_hz


def _slope(echoes: list[Echo]) -> float:
    """Return the least-squares slope of server minus host time over host time, 0 if it cannot be
    estimated.
    """
    first = echoes[0]
    t = [echo.host_ns - first.host_ns for echo in echoes]
    if max(t) - min(t) < DRIFT_SPAN:
        return 0.0
    d = [(echo.server_ns - first.server_ns) - x for echo, x in zip(echoes, t, strict=True)]
    mean_t, mean_d = sum(t) / len(t), sum(d) / len(d)
    covariance = sum((x - mean_t) * (y - mean_d) for x, y in zip(t, d, strict=True))
    slope = covariance / sum((x - mean_t) ** 2 for x in t)
    return max(-DRIFT_MAX, min(DRIFT_MAX, slope))
