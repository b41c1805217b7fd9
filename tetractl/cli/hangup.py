"""Hang-up: a command that moves robots is ended once nobody can read what it prints."""

import os
import select
import signal
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager

POLL_S = 0.2
GONE = select.POLLERR | select.POLLHUP | select.POLLNVAL


@contextmanager
def hung_up_unread(robots: bool = True, unattended: bool = False) -> Iterator[None]:
    """Where `robots` move, send this process SIGHUP once neither stdout nor stderr has a reader.

    Only a pipe, a socket or a terminal has one: where both are files, nothing is sent. Where
    `unattended`, SIGHUP is ignored instead, as by `nohup`. Main thread only, before `watch`.
    """
    read = [] if unattended or not robots else [one for one in (1, 2) if _has_reader(one)]
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN) if unattended else None
    main, closing = threading.get_ident(), threading.Event()

    def watch() -> None:
        poll = select.poll()
        for one in read:
            poll.register(one, 0)  # errors are always reported
        left = len(read)
        while left and not closing.is_set():
            for one, event in poll.poll(1000 * POLL_S):
                if event & GONE:
                    poll.unregister(one)
                    left -= 1
        if not closing.is_set():
            signal.pthread_kill(main, signal.SIGHUP)

    thread = threading.Thread(target=watch, name="readers", daemon=True)
    try:
        if read:
            thread.start()
        yield
    finally:
        closing.set()
        if read:
            thread.join()
        if before is not None:
            signal.signal(signal.SIGHUP, before)


def _has_reader(descriptor: int) -> bool:
    mode = os.fstat(descriptor).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(descriptor)
