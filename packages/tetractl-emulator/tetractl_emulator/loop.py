"""An event loop in one thread: it runs events in the order of their times, and watches files."""

import heapq
import select
import time
from collections.abc import Callable
from itertools import count

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.tools.worker import POLL_S

Action = Callable[[], None]
"""Function that a timeline or a loop calls."""


class Timeline:
    """A queue of events, ordered by time.

    A timeline needs no clock. Tests run it in virtual time, as a discrete-event simulation.

    Attributes:
        now_ns: The present time [ns].

    Args:
        advance: Called with a time [ns] before the events at that time.
        start_ns: The present time [ns].
    """

    def __init__(self, advance: Callable[[int], None], start_ns: int = 0) -> None:
        self.now_ns = start_ns
        self._advance = advance
        self._events: list[tuple[int, int, Action]] = []
        self._event_numbers = count()

    def at(self, when_ns: int, action: Action) -> None:
        """Schedule a function for a time [ns], or for the present if that time has passed.

        Functions at the same time are called in the order in which they were scheduled.
        """
        heapq.heappush(self._events, (max(when_ns, self.now_ns), next(self._event_numbers), action))

    @property
    def next_ns(self) -> int | None:
        """The time of the next event [ns]. None if there are no events."""
        return self._events[0][0] if self._events else None

    def run_to(self, until_ns: int) -> None:
        """Run all events up to and including the time `until_ns` [ns], each at its own time.

        This includes events that are scheduled meanwhile.
        """
        while self._events and self._events[0][0] <= until_ns:
            event_ns, _, action = heapq.heappop(self._events)
            self._advance_to(event_ns)
            action()
        self._advance_to(until_ns)

    def _advance_to(self, when_ns: int) -> None:
        """Set the present time to a later time [ns], and advance the emulated devices."""
        if when_ns > self.now_ns:
            self.now_ns = when_ns
            self._advance(when_ns)


class Loop:
    """Runs a timeline in real time, on the host's monotonic clock.

    Attributes:
        timeline: The timeline.
        worst_lag_ns: Maximum delay of an event so far [ns]. Long delays mean that the host is too
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
        self._readers: dict[int, Action] = {}
        self._is_ended = False

    def watch(self, fd: int, action: Action) -> None:
        """Call `action` whenever data can be read from the file descriptor `fd`.

        It replaces an earlier function for the same descriptor.
        """
        self._readers[fd] = action

    def forget(self, fd: int) -> None:
        """Stop watching the file descriptor `fd`. Nothing happens if it is not watched."""
        self._readers.pop(fd, None)

    def end(self) -> None:
        """Make `run` return. This method can be called in a signal handler."""
        self._is_ended = True

    def catch_up(self) -> None:
        """Run all events of the timeline that are due by now, without waiting for later events."""
        self.timeline.run_to(self.now())

    def run(self) -> None:
        """Run events at their times, and read data that arrive, until `end` is called."""
        while not self._is_ended:
            self.turn()

    def turn(self) -> None:
        """Run all due events, then wait for the next event or for data, at most POLL_S.

        The delay of an event is noted in `worst_lag_ns`, and reported if it exceeds 5 ms.
        """
        now_ns = self.now()
        due_ns = self.timeline.next_ns
        if due_ns is not None and now_ns > due_ns:
            self.worst_lag_ns = max(self.worst_lag_ns, now_ns - due_ns)
            if now_ns - due_ns > 5 * MILLISECOND:
                self._on_lag(now_ns - due_ns)
        self.timeline.run_to(now_ns)
        due_ns = self.timeline.next_ns
        wait_s = POLL_S if due_ns is None else (due_ns - self.now()) / SECOND
        wait_s = min(max(wait_s, 0.0), POLL_S)
        ready_fds, _, _ = select.select(list(self._readers), [], [], wait_s)
        if ready_fds:
            self.timeline.run_to(self.now())
            for fd in ready_fds:
                if action := self._readers.get(fd):
                    action()
