"""Reads keys of a terminal, for the player and for the operator's emergency stop, and restores the
terminal's settings at the end.
"""

import os
import select
import signal
import sys
import termios
import threading
import tty
from collections.abc import Callable
from types import FrameType
from typing import Self

from tetractl.run.interrupt import SIGNALS

_SEQUENCES = {
    b"\x1b[C": "right",
    b"\x1b[D": "left",
    b"\x1bOC": "right",
    b"\x1bOD": "left",
    b"\x1b[H": "home",
    b"\x1bOH": "home",
    b"\x1b[1~": "home",
    b"\x1b[7~": "home",
    b"\x1b[F": "end",
    b"\x1bOF": "end",
    b"\x1b[4~": "end",
    b"\x1b[8~": "end",
}
_NAMES = {" ": "space", "=": "+", "_": "-", "Q": "q"}


def decode(data: bytes) -> tuple[list[str], bytes]:
    """Split bytes read from a terminal into names of keys and the rest, an unfinished escape
    sequence.

    The name of a printable character is the character, except "space"; unknown sequences are
    dropped.
    """
    keys: list[str] = []
    while data:
        if data[0] != 0x1B:
            char = chr(data[0])
            if char.isascii() and char.isprintable():
                keys.append(_NAMES.get(char, char))
            data = data[1:]
            continue
        length = _sequence_length(data)
        if length is None:
            return keys, data
        if name := _SEQUENCES.get(data[:length]):
            keys.append(name)
        data = data[length:]
    return keys, b""


def _sequence_length(data: bytes) -> int | None:
    """Return the length of the escape sequence at the start of `data`; None if it is incomplete."""
    if len(data) < 2:
        return None
    if data[1] == ord("O"):
        return 3 if len(data) >= 3 else None
    if data[1] != ord("["):
        return 1
    for index in range(2, len(data)):
        if 0x40 <= data[index] <= 0x7E:
            return index + 1
        if not 0x20 <= data[index] <= 0x3F:
            return index  # an incomplete sequence
    return None


class Keyboard:
    """Reads each key when it is pressed, without echo; a context manager.

    Ctrl-C and other SIGNALS raise no exception, so that no operation is cut short: they set
    `interrupted`, and `read` returns ["q"]. On Ctrl-Z, `leave` is called, the terminal is restored,
    and the process is suspended; when the process continues, `back` is called.
    """

    def __init__(self, leave: Callable[[], None], back: Callable[[], None]) -> None:
        self._fd = sys.stdin.fileno()
        self._leave, self._back = leave, back
        self._rest = b""
        self._stop_wanted = False
        self.interrupted = False

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._fd)
        handlers = {signal.SIGTSTP: self._note_stop} | dict.fromkeys(SIGNALS, self._interrupt)
        self._handlers = {n: signal.signal(n, handler) for n, handler in handlers.items()}
        tty.setcbreak(self._fd, termios.TCSANOW)
        return self

    def __exit__(self, *error: object) -> None:
        termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def read(self, timeout_s: float) -> list[str]:
        """Wait for keys, at most `timeout_s`, and return their names; ["q"] after an interrupt, or
        if the terminal was closed.
        """
        if self._stop_wanted:
            self._suspend()
        try:
            ready, _, _ = select.select([self._fd], [], [], timeout_s)
            if self.interrupted:
                return ["q"]
            if not ready:
                self._rest = b""  # it was the Esc key alone
                return []
            data = os.read(self._fd, 1024)
        except OSError:
            return ["q"]
        if not data:
            return ["q"]
        keys, self._rest = decode(self._rest + data)
        return keys

    def _note_stop(self, number: int, frame: FrameType | None) -> None:
        self._stop_wanted = True

    def _suspend(self) -> None:
        self._stop_wanted = False
        self._leave()
        termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)  # suspends the process until SIGCONT
        signal.signal(signal.SIGTSTP, self._note_stop)
        tty.setcbreak(self._fd, termios.TCSANOW)
        self._back()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.interrupted = True


STOP_KEYS = b" \x1b"
SAYS = "SPACE or ESC: EMERGENCY STOP"
POLL_S = 0.2


class StopKey:
    """Calls `stop` on space, Esc, or when the terminal is closed; a context manager.

    Enter calls `enter`; other keys do nothing. With `unattended`, a closed terminal does not call
    `stop`. Works only if stdin is a terminal: then `listening` is True.
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
            tty.setcbreak(self._fd, termios.TCSANOW)  # TCSANOW does not wait for pending output
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.listening:
            self._closing.set()
            self._thread.join(1.0)
            try:
                termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
            except termios.error:
                return  # the terminal was closed

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
