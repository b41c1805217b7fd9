"""The clock of a replay, driven by the wall clock, as rosbag2's player clock."""

import math

from tetractl.core.clock import Clock


class PlayerClock:
    """A trial's time [ns], `rate` times as fast as the wall clock; it can be paused and set.

    now = anchor + rate * (wall - wall at the anchor). A change of rate, a pause and a jump each set
    a new anchor, so that the time is continuous but for jumps.
    """

    def __init__(
        self, wall: Clock, *, at_ns: int = 0, rate: float = 1.0, paused: bool = False
    ) -> None:
        self._wall = wall
        self._rate = _positive(rate)
        self._paused = paused
        self._anchor = at_ns
        self._anchor_wall = wall.now()

    @property
    def rate(self) -> float:
        """Seconds of the trial per second of wall time."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Whether the clock is paused."""
        return self._paused

    def now(self) -> int:
        """Time of the trial [ns]."""
        if self._paused:
            return self._anchor
        return self._anchor + round(self._rate * (self._wall.now() - self._anchor_wall))

    def sleep_until(self, time_ns: int) -> bool:
        """Wait until a time of the trial, and return True; a paused clock returns at once."""
        if not self._paused:
            wall_ns = math.ceil((time_ns - self._anchor) / self._rate)
            self._wall.sleep_until(self._anchor_wall + wall_ns)
        return self.now() >= time_ns

    def set_rate(self, rate: float) -> None:
        """Change the rate; it must be above 0."""
        rate = _positive(rate)
        self.jump(self.now())
        self._rate = rate

    def pause(self) -> None:
        """Stop the clock."""
        self.jump(self.now())
        self._paused = True

    def resume(self) -> None:
        """Start a paused clock."""
        self.jump(self.now())
        self._paused = False

    def jump(self, time_ns: int) -> None:
        """Set the time, paused or not."""
        self._anchor, self._anchor_wall = time_ns, self._wall.now()


def _positive(rate: float) -> float:
    if not 0 < rate < float("inf"):
        raise ValueError(f"rate must be positive and finite, not {rate}")
    return rate
