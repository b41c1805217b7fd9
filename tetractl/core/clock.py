"""Clocks, virtual or monotonic, which give nanoseconds since they were created."""

import sys
import time
from collections.abc import Callable
from typing import Protocol

SECOND = 1_000_000_000
"""A second [ns]."""
MILLISECOND = 1_000_000
"""A millisecond [ns]."""
NEVER_NS = 2**62
"""A time after the end of every trial [ns]."""


def seconds(ns: int) -> float:
    """Convert a time [ns] to seconds."""
    return ns / SECOND


def milliseconds(ns: int) -> float:
    """Convert a time [ns] to milliseconds."""
    return ns / MILLISECOND


class Clock(Protocol):
    """A clock that counts nanoseconds from 0, starting when it is created."""

    def now(self) -> int:
        """Return the time since the clock was created [ns]."""
        ...

    def sleep_until(self, when: int) -> None:
        """Wait until `when` [ns] on this clock. Returns at once if that time has passed."""
        ...


class VirtualClock:
    """A clock that advances only when a caller sleeps, so that a simulation need not wait."""

    def __init__(self) -> None:
        self._now = 0

    def now(self) -> int:
        """Return the virtual time since the clock was created [ns]."""
        return self._now

    def sleep_until(self, when: int) -> None:
        """Jump to the virtual time `when` [ns], without waiting.

        An earlier time changes nothing.
        """
        self._now = max(self._now, when)


def host_ns() -> int:
    """Return the time [ns] on the host's monotonic clock, which runs while the computer sleeps.

    After such a sleep, data that waited therefore counts as old, and the run notices the decisions
    that it missed.
    """
    if sys.platform == "linux":
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    if sys.platform == "darwin":
        return time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    return time.monotonic_ns()


class MonotonicClock:
    """A clock that follows the host's monotonic clock, not the adjustable wall clock."""

    def __init__(self) -> None:
        self._start = host_ns()

    def now(self) -> int:
        """Return the time since the clock was created, by the host's monotonic clock [ns]."""
        return host_ns() - self._start

    def sleep_until(self, when: int) -> None:
        """Wait until `when` [ns] on this clock. Returns at once if that time has passed."""
        remaining_ns = when - self.now()
        while remaining_ns > 0:
            time.sleep(remaining_ns / SECOND)
            remaining_ns = when - self.now()


def next_due_ns(due_ns: int, sent_ns: int, period_ns: int) -> int:
    """Compute when the next of several periodic transmissions is due [ns].

    The average rate stays constant. However, the next time is at least half a period and at most
    two periods after the last transmission.

    Args:
        due_ns: When the last transmission was due [ns].
        sent_ns: When it was really sent [ns].
        period_ns: The period [ns].
    """
    earliest_ns = sent_ns + period_ns // 2
    latest_ns = sent_ns + 2 * period_ns
    return min(max(due_ns + period_ns, earliest_ns), latest_ns)


def wait_for(clock: Clock, done: Callable[[], bool], timeout_s: float) -> bool:
    """Wait until a condition holds or a timeout passes, and return whether the condition held.

    In virtual time, the devices that use the clock advance during the wait. Tests therefore need no
    thread.

    Args:
        clock: The clock to wait on.
        done: The condition. It is called every 2 ms.
        timeout_s: How long to wait [s].
    """
    end_ns = clock.now() + round(timeout_s * SECOND)
    while not done():
        if clock.now() >= end_ns:
            return False
        clock.sleep_until(min(end_ns, clock.now() + 2 * MILLISECOND))
    return True
