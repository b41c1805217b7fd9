"""Clocks that a test advances by hand, as a wall clock or a timer."""

from tetractl.core.clock import SECOND, VirtualClock


class HandClock(VirtualClock):
    """Stands for a clock or, by its `now`, for a timer [ns]: time passes only where a test or a
    fake lets it."""

    def advance(self, seconds):
        self.advance_ns(round(seconds * SECOND))

    def advance_ns(self, by_ns):
        self.sleep_until(self.now() + by_ns)


class HandTimer:
    """Stands for a timer in seconds, such as `time.monotonic`: it shows `now_s` when called."""

    def __init__(self, now_s=0.0):
        self.now_s = now_s

    def __call__(self):
        return self.now_s
