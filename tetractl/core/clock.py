"""Clocks: nanoseconds since a clock was made, virtual or monotonic."""

import time
from collections.abc import Callable
from typing import Protocol

SECOND = 1_000_000_000  # ns
MILLISECOND = 1_000_000  # ns
POLL_NS = 2 * MILLISECOND


def seconds(ns: int) -> float:
    """Return a time [ns] in seconds."""
    return ns / SECOND


def milliseconds(ns: int) -> float:
    """Return a time [ns] in milliseconds."""
    return ns / MILLISECOND


class Clock(Protocol):
    """A source of time that starts at 0 when it is made."""

    def now(self) -> int:
        """Return the time [ns]."""
        ...

    def sleep_until(self, when: int) -> None:
        """Wait until `when` [ns]; return at once for a time that has passed."""
        ...


class VirtualClock:
    """Time that passes only by sleeping: simulation runs as fast as it can be computed."""

    def __init__(self) -> None:
        self._now = 0

    def now(self) -> int:
        """Return the time [ns]."""
        return self._now

    def sleep_until(self, when: int) -> None:
        """Jump to `when` [ns]."""
        self._now = max(self._now, when)


class MonotonicClock:
    """The host's monotonic clock, which changes of the wall clock do not affect."""

    def __init__(self) -> None:
        self._start = time.monotonic_ns()

    def now(self) -> int:
        """Return the time [ns]."""
        return time.monotonic_ns() - self._start

    def sleep_until(self, when: int) -> None:
        """Sleep until `when` [ns]."""
        while (left := when - self.now()) > 0:
            time.sleep(left / SECOND)


def wait_for(clock: Clock, done: Callable[[], bool], timeout_s: float) -> bool:
    """Call `done` every 2 ms of a clock until it returns true; return False if the timeout comes
    first.

    In virtual time, waiting advances the devices that run on the clock, so tests need no thread.
    """
    end = clock.now() + round(timeout_s * SECOND)
    while not done():
        if clock.now() >= end:
            return False
        clock.sleep_until(min(end, clock.now() + POLL_NS))
    return True
