"""Set up stdout and stderr so that a slow or missing reader of the output delays no robot.

Printing a message raises no error, and handling a signal does not wait for a reader.

Printed text waits for the reader of its stream, as in any program. In real time, this delays only
the thread of the observers (`run.observer_relay`). If the delay lasts, the trial ends and robots
stop.
"""

import io
import os
import select
import signal
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

STDOUT = 1
STDERR = 2
READER_CHECK_MS = 200
"""Time between two checks of whether the readers or the run have ended [ms]."""
CLOSED_EVENTS = sum(getattr(select, name, 0) for name in ("POLLERR", "POLLHUP", "POLLNVAL"))
"""Events that `poll` reports for a closed stream. Windows has no `poll`."""


class MessageStream(io.FileIO):
    """A stream to stderr on which writing never fails.

    Text that cannot be written, as on a closed terminal or a full disk, is lost.

    It has no buffer, because the lock of one would keep a thread from handling signals while
    another thread waits for a reader.
    """

    def __init__(self) -> None:
        super().__init__(STDERR, "w", closefd=False)

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write bytes, wait for the reader, and return their number, as if all were written."""
        content = bytes(data)
        unwritten = content
        with suppress(OSError):
            while unwritten:
                count = super().write(unwritten)
                if count is None:  # another program made the terminal non-blocking
                    select.select([], [self], [])
                else:
                    unwritten = unwritten[count:]
        return len(content)


def open_streams() -> None:
    """Replace `sys.stderr` by a `MessageStream`, and make both streams safe for any character.

    Characters that a stream's encoding lacks are escaped. A closed standard descriptor is opened on
    the null device, so that no log gets its number.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
    encoding = sys.__stdout__.encoding if sys.__stdout__ else "utf-8"
    escapes = "backslashreplace"
    if isinstance(sys.stdout, io.TextIOWrapper):
        binary = sys.stdout.buffer
        by_line = sys.stdout.line_buffering
    else:  # the descriptor was closed
        binary = os.fdopen(STDOUT, "wb", closefd=False)
        by_line = False
    sys.stdout = io.TextIOWrapper(binary, encoding, escapes, line_buffering=by_line)
    sys.stderr = io.TextIOWrapper(MessageStream(), encoding, escapes, line_buffering=True)


def close_stdout() -> None:
    """Write the rest of the results. If that fails, they are lost.

    Otherwise the interpreter, which writes them again when it ends, would also fail.
    """
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        _discard_output(STDOUT)


def write_at_once(line: bytes) -> None:
    """Write a short line to stderr if it accepts text now. This is safe in a signal handler."""
    if _accepts_output(STDERR):
        with suppress(OSError):
            os.write(STDERR, line)


def create_signal_notice(notice_text: bytes) -> Callable[[int], None]:
    """Return the function by which an `Interrupt` reports signals to the user.

    The function prints `notice_text` at the first signal, and never waits for a reader.
    """

    def notice(count: int) -> None:
        discard_unread_output()
        if count == 1:
            write_at_once(notice_text)

    return notice


def discard_unread_output() -> None:
    """Discard all further output to those standard streams that accept nothing now.

    Threads that wait for such a stream's reader then go on. Call this in the main thread only.
    """
    stuck_streams = [stream for stream in (STDOUT, STDERR) if not _accepts_output(stream)]
    for stream in stuck_streams:
        _discard_output(stream)
    if stuck_streams:  # a signal ends the wait of a thread, which then writes to the null device
        signal.signal(signal.SIGURG, lambda *_: None)
        for thread in threading.enumerate():
            if thread is not threading.main_thread() and thread.ident is not None:
                signal.pthread_kill(thread.ident, signal.SIGURG)


def _accepts_output(stream: int) -> bool:
    """Check, without waiting, whether a stream accepts a line or fails at once."""
    if not hasattr(select, "poll"):  # Windows
        return True
    poll = select.poll()
    poll.register(stream, select.POLLOUT)
    return bool(poll.poll(0))


def _discard_output(stream: int) -> None:
    """Connect a standard stream to the null device, so that its output is discarded."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream)
    os.close(null)


@contextmanager
def hang_up_without_reader(moves_robots: bool = True, unattended: bool = False) -> Iterator[None]:
    """While robots move, send SIGHUP to this process once nobody reads its output.

    The signal is sent if `moves_robots` is True, once neither stdout nor stderr has a reader.

    Only a pipe, a socket or a terminal has a reader: if both streams are files, no signal is sent.
    If `unattended`, SIGHUP is ignored instead, as by `nohup`. To be called in the main thread,
    before `Interrupt.watch`.
    """
    if not hasattr(select, "poll"):  # Windows, where no robots move
        yield
        return
    if unattended:
        previous_handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)
        try:
            yield
        finally:
            signal.signal(signal.SIGHUP, previous_handler)
        return
    modes = {stream: os.fstat(stream).st_mode for stream in (STDOUT, STDERR)}
    streams = [
        stream
        for stream, mode in modes.items()
        if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(stream)
    ]
    if not moves_robots or not streams:
        yield
        return
    main_thread = threading.get_ident()
    has_ended = threading.Event()
    thread = threading.Thread(
        target=_watch_readers, args=(streams, has_ended, main_thread), name="readers", daemon=True
    )
    thread.start()
    try:
        yield
    finally:
        has_ended.set()
        thread.join()


def _watch_readers(streams: list[int], has_ended: threading.Event, main_thread: int) -> None:
    """Send SIGHUP to the main thread if no stream has a reader before `has_ended` is set."""
    poll = select.poll()
    for stream in streams:
        poll.register(stream, 0)  # 0: report errors only
    with_reader = set(streams)
    while with_reader and not has_ended.is_set():
        for stream, event in poll.poll(READER_CHECK_MS):
            if event & CLOSED_EVENTS:
                poll.unregister(stream)
                with_reader.discard(stream)
    if not has_ended.is_set():
        signal.pthread_kill(main_thread, signal.SIGHUP)
