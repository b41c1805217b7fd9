"""Standard output and error, written by threads, so that no terminal or pipe delays a run.

If a terminal has closed or stopped accepting text, a pipe is not read, or the disk is full, only
the output is lost, and the command goes on. `hung_up_unread` ends a command that moves robots once
no process reads its output.
"""

import io
import os
import queue
import select
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

GONE = sum(getattr(select, name, 0) for name in ("POLLERR", "POLLHUP", "POLLNVAL"))
"""What `poll` says of a closed stream; Windows has no `poll`."""


class PatientWriter(io.FileIO):
    """Writes bytes to a file descriptor, and drops them if the descriptor is stuck.

    If the descriptor accepts nothing for `patience_s`, bytes are dropped without waiting until it
    accepts bytes again. If a write fails, its bytes are lost; with `tells`, its OSError is then
    raised, but only once.
    """

    def __init__(self, descriptor: int, patience_s: float, tells: bool) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.patience_s, self._tells = patience_s, tells
        self._pieces: queue.SimpleQueue[tuple[bytes, int]] = queue.SimpleQueue()
        self._changed = threading.Condition()
        self._put = self._done = 0  # bytes
        # bytes queued by a write that a signal interrupted: the buffer repeats that write
        self._queued = b""
        self._moved_s = 0.0  # when the descriptor last accepted bytes, or the queue was empty
        self._failure: OSError | None = None
        threading.Thread(target=self._work, name="output", daemon=True).start()

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write or drop bytes; return their number, as if all were written."""
        piece = bytes(data)
        if sys.is_finalizing():  # the writing thread has ended, perhaps while it held the lock
            return len(piece)
        with self._changed:
            new = piece.removeprefix(self._queued)
            if self._done >= self._put or not self._stuck():
                self._queue(new, len(new))
            self._queued = b""
            if self._tells and self._failure is not None:
                self._tells = False
                raise self._failure
        return len(piece)

    def urge(self, data: bytes) -> None:
        """Queue bytes without waiting or locking: safe in a signal handler."""
        self._pieces.put((data, 0))

    def finish(self) -> None:
        """Wait until everything is written, or until nothing could be written for `patience_s`."""
        with self._changed:
            self._queue(b"", 1)

    def _queue(self, piece: bytes, count: int) -> None:
        """Queue a piece that counts as `count` bytes, and wait until it is written; the caller
        holds the lock.
        """
        if self._done >= self._put:
            self._moved_s = time.monotonic()
        self._put += count
        put = self._put
        self._pieces.put((piece, count))
        self._queued = piece
        while self._done < put and not self._stuck():
            self._changed.wait(0.1)  # a short wait, because `patience_s` may be lowered meanwhile

    def _stuck(self) -> bool:
        return time.monotonic() - self._moved_s >= self.patience_s

    def _work(self) -> None:
        while True:
            piece, count = self._pieces.get()
            try:
                while piece:
                    taken = super().write(piece[:4096])  # few, so that a slow reader ends it soon
                    if taken is None:  # another program made the terminal non-blocking
                        select.select([], [self], [], 1.0)
                    piece = piece[taken or 0 :]
                    self._moved_s = time.monotonic()
            except OSError as error:
                self._failure = error
            with self._changed:
                self._done += count
                self._changed.notify_all()


class Output(io.TextIOWrapper):
    """A text stream on a `PatientWriter`; characters that its encoding lacks are written as
    escapes.
    """

    def __init__(self, descriptor: int, patience_s: float, tells: bool) -> None:
        self.writer = PatientWriter(descriptor, patience_s, tells)
        super().__init__(
            io.BufferedWriter(self.writer),
            encoding=sys.__stdout__.encoding if sys.__stdout__ else "utf-8",
            errors="backslashreplace",
            line_buffering=not tells or self.writer.isatty(),
        )


def open_streams() -> Output:
    """Replace `sys.stdout` and `sys.stderr` by patient streams; return the latter.

    A closed standard descriptor is opened on the null device, so that no log gets its number.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
    messages = Output(2, 1.0, False)
    patience_s = 10.0 if os.isatty(1) else float("inf")
    sys.stdout, sys.stderr = Output(1, patience_s, True), messages
    return messages


def settle() -> None:
    """Write or drop the standard streams' buffered text, while the writing threads still run.

    Otherwise the interpreter would write the text when it ends, after the threads have ended.
    """
    for stream in (sys.stdout, sys.stderr) * 2:  # the second flush drops the rest
        with suppress(OSError, ValueError):
            stream.flush()


def first_signal_callback(text: bytes) -> Callable[[], None]:
    """Return the callback for the first signal: prints `text` and shortens the output timeout.

    The callback takes no lock and does not wait.
    """
    results, messages = sys.stdout, sys.stderr  # bound now, because a live view replaces them later

    def shorten() -> None:
        if isinstance(results, Output):
            results.writer.patience_s = 2.0
        if isinstance(messages, Output):
            messages.writer.urge(text)

    return shorten


@contextmanager
def hung_up_unread(robots: bool = True, unattended: bool = False) -> Iterator[None]:
    """If `robots` move, send this process SIGHUP once neither stdout nor stderr has a reader.

    Only a pipe, a socket or a terminal has a reader: if both streams are files, no signal is sent.
    If `unattended`, SIGHUP is ignored instead, as by `nohup`. To be called in the main thread,
    before `Interrupt.watch`.
    """
    if not hasattr(select, "poll"):  # Windows, where no robots move
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN) if unattended else None
    main, ended = threading.get_ident(), threading.Event()
    poll, left = select.poll(), 0
    for one in (1, 2) if robots and not unattended else ():
        mode = os.fstat(one).st_mode
        if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(one):
            poll.register(one, 0)  # 0: report errors only
            left += 1

    def watch(left: int) -> None:
        while left and not ended.is_set():
            for one, event in poll.poll(200):
                if event & GONE:
                    poll.unregister(one)
                    left -= 1
        if not ended.is_set():
            signal.pthread_kill(main, signal.SIGHUP)

    thread = threading.Thread(target=watch, args=(left,), name="readers", daemon=True)
    try:
        if left:
            thread.start()
        yield
    finally:
        ended.set()
        if left:
            thread.join()
        if before is not None:
            signal.signal(signal.SIGHUP, before)
