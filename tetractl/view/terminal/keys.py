"""Reads single keys from a terminal, and restores the terminal's settings at the end.

The player, the operator's emergency stop, and a person who steers by hand use it.
"""

import os
import re
import select
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import Self

from tetractl.run.interrupt import STOP_SIGNALS
from tetractl.tools.terminal import has_keys

_SEQUENCES = {
    "right": ("[C", "OC"),
    "left": ("[D", "OD"),
    "up": ("[A", "OA"),
    "down": ("[B", "OB"),
    "home": ("[H", "OH", "[1~", "[7~"),
    "end": ("[F", "OF", "[4~", "[8~"),
}
"""Keys by name, as the sequences after the escape character that terminals send for them."""
_NAMES = {f"\x1b{code}": name for name, codes in _SEQUENCES.items() for code in codes}
_NAMES |= {" ": "space", "=": "+", "_": "-", "Q": "q", "\x1b": "escape"}
_KEY = re.compile(
    r"(?P<unfinished>\x1b(O|\[[ -?]*)?\Z)|(?P<alt>\x1b(?=\x1b[O\[]))|\x1b(O.|\[[ -?]*[@-~]?)?"
    r"|(?P<printable>[ -~])|.",
    re.DOTALL,
)
ESCAPE_S = 0.05
"""Time within which the rest of a key's escape sequence comes [s]; without it, Esc was pressed."""
STOP_KEYS = {"space", "escape"}
_MOUSE_EVENT = "\x1b[<"
"""Begin of an event of the mouse, in a terminal's mode 1006."""


def decode_keys(data: bytes) -> tuple[list[str], bytes]:
    """Split bytes read from a terminal into names of keys and an unfinished escape sequence.

    A printable character is named by itself, except "space". A mouse event is named by the
    characters after the escape character and `[`. Unknown sequences are dropped. "escape" is Esc
    followed by another character, for example when the key is held down: Esc alone looks like the
    beginning of a sequence until ESCAPE_S have passed.

    Returns:
        The names, and the bytes of the unfinished sequence at the end.
    """
    keys: list[str] = []
    for sequence in _KEY.finditer(data.decode("latin-1")):
        if sequence["unfinished"]:
            return keys, data[sequence.start() :]
        if sequence["alt"]:  # of a key with Alt, whose sequence follows
            continue
        sequence_text = sequence[0]
        if sequence_text in _NAMES or sequence["printable"]:
            keys.append(_NAMES.get(sequence_text, sequence_text))
        elif sequence_text.startswith(_MOUSE_EVENT):
            keys.append(sequence_text.removeprefix("\x1b["))
    return keys, b""


class _RawInput:
    """A terminal's input in a mode without buffer and echo, until `restore`."""

    def __init__(self) -> None:
        import termios  # not on Windows

        self.fd = sys.stdin.fileno()
        self._first_mode = termios.tcgetattr(self.fd)
        self.set()

    def set(self) -> None:
        """Turn off the input's buffer and echo. TCSANOW does not wait for pending output."""
        import termios
        import tty

        tty.setcbreak(self.fd, termios.TCSANOW)

    def restore(self) -> None:
        """Restore the mode that the terminal had at first. Do nothing if it was closed."""
        import termios

        with suppress(termios.error):
            termios.tcsetattr(self.fd, termios.TCSANOW, self._first_mode)

    def wait(self, timeout_s: float, count: int) -> bytes | None:
        """Wait for input, and read it.

        Args:
            timeout_s: Maximum time to wait for the first byte [s].
            count: Maximum number of bytes to read.

        Returns:
            The bytes. None if no input arrives in time, and b"" if the terminal was closed.
        """
        try:
            readable, _, _ = select.select([self.fd], [], [], timeout_s)
            return os.read(self.fd, count) if readable else None
        except OSError:
            return b""


class Keyboard:
    """Reads each key as soon as it is pressed, without echo. It is a context manager.

    Ctrl-C and other STOP_SIGNALS raise no exception, so that no operation is cut short: they set
    `interrupted`, and `read` returns ["q"]. On Ctrl-Z, the terminal is restored and the process is
    suspended.

    Args:
        on_leave: Called before the process is suspended.
        on_return: Called when the process continues.
    """

    def __init__(self, on_leave: Callable[[], None], on_return: Callable[[], None]) -> None:
        self._on_leave = on_leave
        self._on_return = on_return
        self._unfinished = b""
        self._must_suspend = False
        self.interrupted = False

    def __enter__(self) -> Self:
        handlers = {signal.SIGTSTP: self._ask_to_suspend} | dict.fromkeys(
            STOP_SIGNALS, self._interrupt
        )
        self._handlers = {n: signal.signal(n, handler) for n, handler in handlers.items()}
        self._input = _RawInput()
        return self

    def __exit__(self, *error: object) -> None:
        self._input.restore()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def read(self, timeout_s: float) -> list[str]:
        """Wait for keys for at most `timeout_s`, and return the names of those that were pressed.

        After an interrupt, or if the terminal was closed, the result is ["q"].
        """
        if self._must_suspend:
            self._suspend()
        data = self._input.wait(timeout_s, 1024)
        if self.interrupted or data == b"":
            return ["q"]
        if data is None:
            self._unfinished = b""  # it was the Esc key alone
            return []
        keys, self._unfinished = decode_keys(self._unfinished + data)
        return keys

    def _ask_to_suspend(self, number: int, frame: FrameType | None) -> None:
        self._must_suspend = True

    def _suspend(self) -> None:
        self._must_suspend = False
        self._on_leave()
        self._input.restore()
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)  # suspends the process until SIGCONT
        signal.signal(signal.SIGTSTP, self._ask_to_suspend)
        self._input.set()
        self._on_return()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.interrupted = True


STOP_HINT = "SPACE or ESC: EMERGENCY STOP"
NO_KEY = "without a terminal, there is no key to stop the robots"


class StopKey:
    """Stops robots on space or Esc, or if the terminal is closed, by calling a function.

    It is a context manager, and works only if stdin is a terminal; then `listening` is True.

    Args:
        stop: Called to stop.
        enter: Called on Enter.
        unattended: Whether a closed terminal does not stop.
        steer: Called with every other key, then also with the space bar. None to ignore other keys.
    """

    def __init__(
        self,
        stop: Callable[[], None],
        enter: Callable[[], None],
        unattended: bool = False,
        steer: Callable[[str], None] | None = None,
    ) -> None:
        self.listening = has_keys()
        self._stop = stop
        self._enter = enter
        self._unattended = unattended
        self._steer = steer or (lambda key: None)
        self._stop_keys = STOP_KEYS if steer is None else STOP_KEYS - {"space"}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="stop key", daemon=True)

    def __enter__(self) -> Self:
        if self.listening:
            self._input = _RawInput()
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.listening:
            self._closing.set()
            self._thread.join(1.0)
            self._input.restore()

    def _listen(self) -> None:
        unfinished = b""
        while not self._closing.is_set():
            data = self._input.wait(ESCAPE_S if unfinished else 0.2, 64)
            if data is None:
                # it was Esc alone, or a sequence that never ends, which stops the robots to be safe
                if unfinished:
                    self._stop()
                unfinished = b""
                continue
            if not data:
                if not self._unattended:
                    self._stop()
                return
            keys, unfinished = decode_keys(unfinished + data)
            if not self._stop_keys.isdisjoint(keys):
                self._stop()
            for key in keys:
                self._steer(key)
            if b"\n" in data or b"\r" in data:
                self._enter()
