"""An event loop in one thread: it runs events in the order of their times, and watches files."""

import heapq
import select
import time
from collections.abc import Callable
from itertools import count

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.tools.worker import POLL_S

Act = Callable[[], None]


class Timeline:
    """A queue of events by time [ns].

    A timeline needs no clock. Tests run it in virtual time, as a discrete-event simulation.

    Args:
        advance: Called with a time [ns] before the events at that time.
        start_ns: The present time [ns].
    """

    def __init__(self, advance: Callable[[int], None], start_ns: int = 0) -> None:
        self.now_ns = start_ns
        self._advance = advance
        self._events: list[tuple[int, int, Act]] = []
        self._order = count()

    def at(self, when_ns: int, act: Act) -> None:
        """Schedule a function for a time [ns], or for the present if that time has passed.

        Functions at the same time are called in the order in which they were scheduled.
        """
        heapq.heappush(self._events, (max(when_ns, self.now_ns), next(self._order), act))

    @property
    def next_ns(self) -> int | None:
        """The time of the next event [ns]. None if there are no events."""
        return self._events[0][0] if self._events else None

    def run_to(self, until_ns: int) -> None:
        """Run all events up to and including the time `until_ns` [ns], each at its own time.

        Events that they schedule in this span are run as well.
        """
        while self._events and self._events[0][0] <= until_ns:
            when, _, act = heapq.heappop(self._events)
            self._move(when)
            act()
        self._move(until_ns)

    def _move(self, when_ns: int) -> None:
        if when_ns > self.now_ns:
            self.now_ns = when_ns
            self._advance(when_ns)


class Loop:
    """Runs a timeline in real time, on the host's monotonic clock.

    Attributes:
        timeline: The timeline.
        worst_lag_ns: Maximum delay of an event so far [ns]. Long delays show that the host is too
            busy.

    Args:
        timeline: The timeline.
        on_lag: Called with each delay above 5 ms [ns].
    """

    now = staticmethod(time.monotonic_ns)

    def __init__(self, timeline: Timeline, on_lag: Callable[[int], None]) -> None:
        self.timeline = timeline
        self._on_lag = on_lag
        self.worst_lag_ns = 0
        self._readers: dict[int, Act] = {}
        self._ended = False

    def watch(self, fd: int, act: Act) -> None:
        """Call `act` whenever data can be read from the file descriptor `fd`.

        It replaces an earlier function for the same descriptor.
        """
        self._readers[fd] = act

    def forget(self, fd: int) -> None:
        """Stop watching the file descriptor `fd`. Nothing happens if it is not watched."""
        self._readers.pop(fd, None)

    def end(self) -> None:
        """Make `run` return. This method can be called in a signal handler."""
        self._ended = True

    def catch_up(self) -> None:
        """Run all events of the timeline that are due by now, without waiting for later ones."""
        self.timeline.run_to(self.now())

    def run(self) -> None:
        """Run events at their times, and read data that arrive, until `end` is called."""
        while not self._ended:
            self.turn()

    def turn(self) -> None:
        """Run all events that are due, then wait for the next event or for data, at most POLL_S.

        A delay is noted in `worst_lag_ns`, and reported if it exceeds 5 ms.
        """
        now = self.now()
        due = self.timeline.next_ns
        if due is not None and now > due:
            self.worst_lag_ns = max(self.worst_lag_ns, now - due)
            if now - due > 5 * MILLISECOND:
                self._on_lag(now - due)
        self.timeline.run_to(now)
        due = self.timeline.next_ns
        wait_s = POLL_S if due is None else (due - self.now()) / SECOND
        wait_s = min(max(wait_s, 0.0), POLL_S)
        ready, _, _ = select.select(list(self._readers), [], [], wait_s)
        if ready:
            self.timeline.run_to(self.now())
            for fd in ready:
                if act := self._readers.get(fd):
                    act()
