"""A background thread that makes calls in order, and an observer that passes its calls to it.

The log's writer and other observers that may be slow use them.
"""

import queue
import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

from tetractl.core.commands import Command
from tetractl.core.errors import TetractlError
from tetractl.core.poses import Sample
from tetractl.core.protocols import Observer
from tetractl.core.trial import Note, Result, Step

T = TypeVar("T")

QUEUE_MAX = 20_000
"""Maximum number of items in a queue between two threads: 3 minutes of frames at 120 Hz.

If there are more items, the oldest are dropped.
"""
POLL_S = 0.05
"""Maximum time that a thread without events waits, so that it notices a request to end [s]."""


def take_all(waiting: deque[T]) -> list[T]:
    """Remove all items of a queue and return them, oldest first.

    Another thread may add items meanwhile.
    """
    return [waiting.popleft() for _ in range(len(waiting))]


def _do_nothing() -> float | None:
    return None


class Worker:
    """A thread that makes queued calls, one after another.

    The first error is kept as `failure`. A call may have raised it, or the queue may be too slow.
    The next `put`, `drain` or `check` raises it, once, and later calls are dropped.

    Args:
        name: Name of the thread.
        size: Maximum number of calls in the queue.
        wait_s: Maximum time that `put` waits while the queue is full [s].
        patience_s: Maximum time that `drain` and `close` wait until the queue is empty [s].
        too_slow: The error that is raised if one of these times passes.
        idle: Function that the thread calls after each call. It returns the time after which it is
            called again [s]. None if it need not be called again.
        batch_s: Time for which calls are collected before they are made [s], because switching
            threads at every call may take longer than the calls.
    """

    def __init__(
        self,
        name: str,
        *,
        size: int,
        wait_s: float,
        patience_s: float,
        too_slow: TetractlError,
        idle: Callable[[], float | None] = _do_nothing,
        batch_s: float = 0.0,
    ) -> None:
        self._wait_s = wait_s
        self._patience_s = patience_s
        self._too_slow = too_slow
        self._idle = idle
        self._calls: queue.SimpleQueue[Callable[[], Any] | None] = queue.SimpleQueue()
        self._free_slots = threading.Semaphore(size)
        self._batch_s = batch_s
        self._wake_event = threading.Event()
        self.failure: Exception | None = None
        self._is_raised = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def put(self, call: Callable[..., object], *args: object) -> None:
        """Queue the call `call(*args)`, which the worker's thread will make.

        If the queue is full, this waits up to `wait_s` and then fails with `too_slow`. After a
        failure, which is raised once, further calls are dropped.
        """
        self.check()
        if self.failure is None:
            has_slot = self._free_slots.acquire(blocking=False)
            if not has_slot:
                self._wake_event.set()
                has_slot = self._free_slots.acquire(timeout=self._wait_s)
            if has_slot:
                self._calls.put(lambda: self._make_call(call, *args))
            else:
                self._fail(self._too_slow)
                self.check()

    def drain(self) -> None:
        """Wait until the worker's thread has done every call so far.

        A failure is raised if it was not raised before.
        """
        self.check()
        self.wait()
        self.check()

    def wait(self) -> None:
        """Wait until every call so far is done, at most `patience_s`.

        Nothing is raised: an error is left to the next call.
        """
        if self.failure is None:
            all_done = threading.Event()
            self._calls.put(all_done.set)
            self._wake_event.set()
            if not all_done.wait(self._patience_s):
                self._fail(self._too_slow)

    def check(self) -> None:
        """Raise `failure` if there is one and it was not raised before."""
        if self.failure is not None and not self._is_raised:
            self._is_raised = True
            raise self.failure

    def close(self, last_call: Callable[[], object] = _do_nothing) -> None:
        """Make the queued calls and then `last_call`, even after a failure, and end the thread.

        `close` never raises. To find out about errors, read `failure`, or call `check`. A second
        `close` does nothing. A thread that has stalled is abandoned.
        """
        if not self._thread.is_alive():
            return
        self._calls.put(last_call)
        self._calls.put(None)
        self._wake_event.set()
        if self.failure is not self._too_slow:
            self._thread.join(self._patience_s)
            if self._thread.is_alive():
                self._fail(self._too_slow)

    def _fail(self, error: Exception) -> None:
        self.failure = self.failure or error

    def _make_call(self, call: Callable[..., object], *args: object) -> None:
        self._free_slots.release()
        if self.failure is None or self.failure is self._too_slow:
            call(*args)

    def _work(self) -> None:
        idle_s: float | None = None
        while True:
            if self._batch_s and self._calls.empty():
                self._wake_event.wait(self._batch_s)
                self._wake_event.clear()
            try:
                call = self._calls.get(timeout=idle_s)
            except queue.Empty:
                call = _do_nothing
            if call is None:
                return
            try:
                call()
                idle_s = self._idle()
            except Exception as error:
                self._fail(error)
                idle_s = None


class Relay(Observer):
    """An observer that stores its calls in order, to make them later on another observer."""

    @abstractmethod
    def put(self, call: Callable[[Observer], object]) -> None:
        """Store a call: a function that takes the observer on which the call will be made."""

    def on_samples(self, samples: list[Sample]) -> None:
        """Store camera frames."""
        self.put(lambda observer: observer.on_samples(samples))

    def on_step(self, step: Step) -> None:
        """Store a control step."""
        self.put(lambda observer: observer.on_step(step))

    def on_command(self, command: Command) -> None:
        """Store a command sent outside the control steps."""
        self.put(lambda observer: observer.on_command(command))

    def on_note(self, note: Note) -> None:
        """Store an event or a message of the trial."""
        self.put(lambda observer: observer.on_note(note))

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result."""
        self.put(lambda observer: observer.on_stop(stop, result))
