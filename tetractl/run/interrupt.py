"""Ctrl-C and SIGTERM: the first lets the step finish and stops the robots, the second now."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Counts requests to stop; `KeyboardInterrupt` is raised only where nothing can be torn."""

    def __init__(self, notice: Callable[[], object] = lambda: None) -> None:
        self.count = 0
        self.notice = notice  # called at the first request, in the signal's handler
        self._breakable = False

    @property
    def requested(self) -> bool:
        """Whether to stop after this step."""
        return self.count > 0

    def request(self) -> None:
        """Ask once: a second request breaks into the breakable part that is under way."""
        self.count += 1
        if self.count == 1:
            self.notice()
        if self.count > 1 and self._breakable:
            raise KeyboardInterrupt

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Take requests from SIGINT and SIGTERM while inside; main thread only."""
        before = [signal.signal(number, self._on_signal) for number in SIGNALS]
        try:
            yield
        finally:
            for number, handler in zip(SIGNALS, before, strict=True):
                signal.signal(number, handler)

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """Mark code, planning or sleeping, that a second request may break off at once."""
        self._breakable = True
        try:
            if self.count > 1:
                raise KeyboardInterrupt
            yield
        finally:
            self._breakable = False

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.request()
