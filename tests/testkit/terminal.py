"""Runs a command in a pseudo-terminal: tests send keys, and read what the screen received."""

import fcntl
import io
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import time
from pathlib import Path
from typing import Self

from rich.console import Console

PATIENCE_S = 120.0  # before a test gives up; nothing waits for it to pass
FULL_S = 0.5  # for which a full terminal takes nothing
_CODES = re.compile(r"\x1b(?:\[[0-9;?]*(?:[A-Za-z]|$)|[=>]|$)")


def console(width=80, height=24, encoding="utf-8", **options):
    """A terminal with colours, in memory; what it was sent is `file.buffer`."""
    return Console(
        file=io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True), width=width,
        height=height, force_terminal=True, color_system="truecolor", legacy_windows=False,
        _environ={"TERM": "xterm-256color"}, **options,
    )  # fmt: skip


class Terminal:
    """Runs a command as the leader of a session on a new terminal of `columns` x `rows`."""

    def __init__(
        self, command: list[str], folder: Path, columns: int = 80, rows: int = 24, **env: str
    ) -> None:
        self._master, self._slave = pty.openpty()
        self.resize(columns, rows)
        self.before = termios.tcgetattr(self._slave)
        self.process = subprocess.Popen(
            command,
            stdin=self._slave,
            stdout=self._slave,
            stderr=self._slave,
            cwd=folder,
            env=_environment() | env,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        self.raw = ""
        self._seen = 0

    def resize(self, columns: int, rows: int) -> None:
        """Set the size of the screen."""
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def press(self, keys: str) -> None:
        """Type."""
        os.write(self._master, keys.encode())

    def expect(self, pattern: str) -> str:
        """Read on until what came since the last match matches, without control codes."""
        matched = self._match(pattern)
        while not matched:
            assert self._read(), f"{pattern!r} never came:\n{self.raw[-3000:]}"
            matched = self._match(pattern)
        return matched

    def answer(self, pattern: str, keys: str) -> None:
        """Type, without waiting, if what came since the last match matches; fail if all is over."""
        assert self.process.poll() is None, f"the command has ended:\n{self.raw[-3000:]}"
        self._read(0.0)
        if self._match(pattern):
            self.press(keys)

    def fill(self) -> None:
        """Leave the terminal as it is, unread, until it takes nothing more.

        It takes nothing for a moment, too, while the kernel passes on what was written: so it must
        have taken nothing for FULL_S, in which the live view draws some pictures.
        """
        began = since = time.monotonic()
        while time.monotonic() - since < FULL_S:
            assert time.monotonic() - began < PATIENCE_S, "nothing fills the terminal"
            if select.select([], [self._slave], [], 0.01)[1]:
                since = time.monotonic()
            self.process.poll()

    def close(self) -> None:
        """Close the terminal, as a window or a lost connection does."""
        os.close(self._slave)
        os.close(self._master)
        self._slave = self._master = -1

    def finish(self) -> int:
        """Read until the command ends and return its exit code."""
        os.close(self._slave)
        self._slave = -1
        while self._read():
            pass
        return self.process.wait(PATIENCE_S)

    def settings(self) -> list:
        """How the terminal is set now, as termios tells it."""
        return termios.tcgetattr(self._slave if self._slave >= 0 else self._master)

    def _match(self, pattern: str) -> str:
        text = _CODES.sub("", self.raw)
        match = re.compile(pattern).search(text, self._seen)
        if match is None:
            return ""
        self._seen = match.end()
        return match[0]

    def _read(self, patience_s: float = PATIENCE_S) -> bool:
        ready, _, _ = select.select([self._master], [], [], patience_s)
        if not ready:
            return False
        try:
            data = os.read(self._master, 65536)
        except OSError:  # the last one has left the terminal
            return False
        self.raw += data.decode(errors="replace")
        return bool(data)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        for end in {self._master, self._slave} - {-1}:
            os.close(end)


def _environment() -> dict[str, str]:
    hidden = ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "TTY_COMPATIBLE", "JPY_PARENT_PID")
    inherited = {name: value for name, value in os.environ.items() if name not in hidden}
    return inherited | {"TERM": "xterm-256color", "PYTHONUTF8": "1"}
