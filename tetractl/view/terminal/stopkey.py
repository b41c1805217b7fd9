"""The operator's emergency stop: space or Esc in the terminal of a lab run."""

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable
from typing import Self

STOP_KEYS = b" \x1b"
SAYS = "SPACE or ESC: EMERGENCY STOP"
POLL_S = 0.2


class StopKey:
    """Calls `stop` on space, Esc, or when the terminal goes away; a context manager.

    Enter calls `enter`; other keys do nothing. A terminal that goes away is no stop if
    `unattended`. Works only if stdin is a terminal: then
    `listening` is True.
    """

    def __init__(
        self, stop: Callable[[], None], enter: Callable[[], None], unattended: bool = False
    ) -> None:
        self.listening = sys.stdin is not None and sys.stdin.isatty()
        self._stop, self._enter, self._unattended = stop, enter, unattended
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="stop key", daemon=True)

    def __enter__(self) -> Self:
        if self.listening:
            self._fd = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd, termios.TCSANOW)  # does not wait for a blocked terminal
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.listening:
            self._closing.set()
            self._thread.join(1.0)
            try:
                termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
            except termios.error:
                return  # the terminal has gone

    def _listen(self) -> None:
        while not self._closing.is_set():
            try:
                ready, _, _ = select.select([self._fd], [], [], POLL_S)
                if not ready:
                    continue
                keys = os.read(self._fd, 64)
            except OSError:
                keys = b""
            if any(key in STOP_KEYS for key in keys) or not (keys or self._unattended):
                self._stop()
            if not keys:
                return
            if b"\n" in keys or b"\r" in keys:
                self._enter()
