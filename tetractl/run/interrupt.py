"""Ctrl-C and SIGTERM: the first stops the robots after the control step, the second at once."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Counts requests to stop; raises KeyboardInterrupt only in code marked `breakable`."""

    def __init__(self, notice: Callable[[], object] = lambda: None) -> None:
        self.count = 0
        self.notice = notice  # called at the first request, in the signal's handler
        self._breakable = False

    @property
    def requested(self) -> bool:
        """Whether to stop after this step."""
        return self.count > 0

    def request(self) -> None:
        """Count a request; from the second on, raise KeyboardInterrupt in breakable code."""
        self.count += 1
        if self.count == 1:
            self.notice()
        if self.count > 1 and self._breakable:
            raise KeyboardInterrupt

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Count SIGINT and SIGTERM as requests inside the block; main thread only."""
        before = [signal.signal(number, self._on_signal) for number in SIGNALS]
        try:
            yield
        finally:
            for number, handler in zip(SIGNALS, before, strict=True):
                signal.signal(number, handler)

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """Mark the code inside the block, planning or sleeping, as breakable."""
        self._breakable = True
        try:
            if self.count > 1:
                raise KeyboardInterrupt
            yield
        finally:
            self._breakable = False

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.request()
