"""Measures how late this computer wakes sleeping programs, which spoils tests in real time."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

NAP_S = 0.005


class Lateness:
    """The most that a thread of this process was woken too late, `most_s` [s]."""

    def __init__(self) -> None:
        self.most_s = 0.0


@contextmanager
def lateness() -> Iterator[Lateness]:
    """Watch how late a thread that sleeps again and again is woken, inside the block."""
    lateness = Lateness()
    over = threading.Event()

    def watch() -> None:
        while not over.is_set():
            before = time.monotonic()
            time.sleep(NAP_S)
            late_s = time.monotonic() - before - NAP_S
            lateness.most_s = max(lateness.most_s, late_s)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield lateness
    finally:
        over.set()
        thread.join()
