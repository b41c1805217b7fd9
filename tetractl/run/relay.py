"""An observer that works in a thread of its own, so that a slow disk never holds the loop up."""

import queue
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.errors import LogError, TetractlError
from tetractl.core.protocols import Observer
from tetractl.core.trial import Result, Start, Step

Call = Callable[[], None] | threading.Event  # an event is set when its turn has come

WAITING = 2000  # calls that may wait: minutes of a trial
PATIENCE_S = 30.0  # for the last of them, after the robots were stopped


class Relay:
    """Hands every call on to `observer`, in order; a context manager.

    What the observer raises is raised by the next call here; later calls are dropped then. So is
    what `failed` returns, for an observer that itself works behind its calls, as the log does.
    """

    def __init__(
        self, observer: Observer, failed: Callable[[], Exception | None] = lambda: None
    ) -> None:
        self._observer, self._failed = observer, failed
        self._calls: queue.Queue[Call | None] = queue.Queue(WAITING)
        self._failure: TetractlError | None = None
        self._bug: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="observer", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._calls.put(None, timeout=PATIENCE_S)
        except queue.Full:
            return
        self._thread.join(PATIENCE_S)

    def on_start(self, start: Start) -> None:
        """Call at once: nothing moves yet, and a log that cannot be made ends the trial here."""
        self._observer.on_start(start)

    def on_samples(self, samples: list[Sample]) -> None:
        """Hand on."""
        self._hand(lambda: self._observer.on_samples(samples))

    def on_step(self, step: Step) -> None:
        """Hand on."""
        self._hand(lambda: self._observer.on_step(step))

    def on_command(self, command: Command) -> None:
        """Hand on."""
        self._hand(lambda: self._observer.on_command(command))

    def on_note(self, note: Note) -> None:
        """Hand on."""
        self._hand(lambda: self._observer.on_note(note))

    def on_stop(self, stop: Command, result: Result) -> None:
        """Hand on, and wait until all is done."""
        self._hand(lambda: self._observer.on_stop(stop, result))
        done = threading.Event()
        self._hand(done)
        if not done.wait(PATIENCE_S):
            raise LogError(f"the log was not written within {PATIENCE_S:g} s: the disk is too slow")
        self._raise()

    def _hand(self, call: Call) -> None:
        self._raise()
        try:
            self._calls.put_nowait(call)
        except queue.Full:
            raise LogError("the disk is too slow for the log") from None

    def _raise(self) -> None:
        if self._bug is not None:
            raise self._bug
        if self._failure is not None:
            raise self._failure
        if (failure := self._failed()) is not None:
            raise failure

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            if isinstance(call, threading.Event):
                call.set()
                continue
            if self._failure or self._bug:
                continue
            try:
                call()
            except TetractlError as error:
                self._failure = error
            except Exception as error:
                self._bug = error
