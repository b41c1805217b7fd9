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

WAITING_MAX = 20_000
"""Maximum number of items that wait between two threads.

Beyond it, the oldest are dropped. It corresponds to 3 minutes of camera frames at 120 Hz.
"""
POLL_S = 0.05
"""Maximum time that a thread without events waits, so that it notices a request to end [s]."""


def drained(waiting: deque[T]) -> list[T]:
    """Remove and return a queue's items, oldest first. Another thread may add items meanwhile."""
    return [waiting.popleft() for _ in range(len(waiting))]


def _nothing() -> float | None:
    return None


class Worker:
    """A thread that makes queued calls, one after another.

    The first error is kept as `failure`. A call may have raised it, or the queue may be too slow.
    The next `put`, `drain` or `check` raises it, once, and later calls are dropped.

    Args:
        name: Name of the thread.
        size: Maximum number of calls in the queue.
        wait_s: Time for which the queue may stay full in `put` [s].
        patience_s: Time in which it has to become empty in `drain` or `close` [s].
        too_slow: The error for a queue that is too slow.
        idle: Called after each call, and again after the time [s] that it returned. None ends that.
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
        idle: Callable[[], float | None] = _nothing,
        batch_s: float = 0.0,
    ) -> None:
        self._wait_s = wait_s
        self._patience_s = patience_s
        self._too_slow = too_slow
        self._idle = idle
        self._calls: queue.SimpleQueue[Callable[[], Any] | None] = queue.SimpleQueue()
        self._places = threading.Semaphore(size)
        self._batch_s = batch_s
        self._awaited = threading.Event()
        self.failure: Exception | None = None
        self._raised = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def put(self, call: Callable[..., object], *args: object) -> None:
        """Queue the call `call(*args)`, which the thread of this worker will make.

        If the queue is full, this waits up to `wait_s` and then fails with `too_slow`. After a
        failure, which is raised once, further calls are dropped.
        """
        self.check()
        if self.failure is None:
            place = self._places.acquire(blocking=False)
            if not place:
                self._awaited.set()
                place = self._places.acquire(timeout=self._wait_s)
            if place:
                self._calls.put(lambda: self._do(call, *args))
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
            done = threading.Event()
            self._calls.put(done.set)
            self._awaited.set()
            if not done.wait(self._patience_s):
                self._fail(self._too_slow)

    def check(self) -> None:
        """Raise `failure` if there is one and it was not raised before."""
        if self.failure is not None and not self._raised:
            self._raised = True
            raise self.failure

    def close(self, last: Callable[[], object] = _nothing) -> None:
        """Make the calls in the queue and then `last`, even after a failure, and end the thread.

        `close` never raises. To find out about errors, read `failure`, or call `check`. A second
        `close` does nothing. A thread that has stalled is abandoned.
        """
        if not self._thread.is_alive():
            return
        self._calls.put(last)
        self._calls.put(None)
        self._awaited.set()
        if self.failure is not self._too_slow:
            self._thread.join(self._patience_s)
            if self._thread.is_alive():
                self._fail(self._too_slow)

    def _fail(self, error: Exception) -> None:
        self.failure = self.failure or error

    def _do(self, call: Callable[..., object], *args: object) -> None:
        self._places.release()
        if self.failure is None or self.failure is self._too_slow:
            call(*args)

    def _work(self) -> None:
        wait_s: float | None = None
        while True:
            if self._batch_s and self._calls.empty():
                self._awaited.wait(self._batch_s)
                self._awaited.clear()
            try:
                call = self._calls.get(timeout=wait_s)
            except queue.Empty:
                call = _nothing
            if call is None:
                return
            try:
                call()
                wait_s = self._idle()
            except Exception as error:
                self._fail(error)
                wait_s = None


class Relay(Observer):
    """An observer that stores its calls in order, to make them later on another observer."""

    @abstractmethod
    def put(self, call: Callable[[Observer], object]) -> None:
        """Store a call, which is a function of the observer on which it will be made."""

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
