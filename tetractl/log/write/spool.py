"""A sink in a thread of its own: no compression, write or sync ever holds up who logs."""

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import LogError
from tetractl.log.write.sink import Sink

WAITING = 256  # jobs that may wait for the disk, each a control step's messages at most
PATIENCE_S = 30.0  # for a disk that stands still

Job = Callable[[], None]


class Desk:
    """Takes jobs for a `Sink` and does them in order, in a thread that ends with `close`.

    While the queue is full, `put` waits: a simulation, which runs faster than any disk, slows down
    instead of losing messages. In the lab it is the log's relay that waits, never the control loop.
    After PATIENCE_S without room the log is given up.

    What went wrong in the thread is raised by the next call and is `failure` from then on; later
    calls do nothing.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._sink = Sink(path)
        self._jobs: queue.Queue[Job | None] = queue.Queue(WAITING)
        self._told = self._closed = False
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._work, name=f"log {path.name}", daemon=True)
        self._thread.start()

    def put(self, job: Callable[..., None], *args: object) -> None:
        """Hand on a call of one of the sink's methods."""
        self._tell()
        if self.failure is None:
            self._hand(lambda: job(self._sink, *args))

    def drain(self) -> None:
        """Wait until everything so far is done, and raise if it could not be."""
        done = threading.Event()
        self._tell()
        if self.failure is None:
            self._hand(done.set)
            if not done.wait(PATIENCE_S):
                self._give_up()
        self._tell()

    def close(self, complete: bool) -> None:
        """Finish the file and end the thread; only a complete log gets its name.

        What went wrong is raised for a log that was to be complete; without an end it is known to
        be a part.
        """
        if not self._thread.is_alive():
            return
        self._told |= not complete
        self._closed = True
        stalled = self.failure is not None and self._jobs.full()
        if not stalled:
            self._hand(lambda: self._sink.close(complete))
            self._hand(None)
            self._thread.join(PATIENCE_S)
            if self._thread.is_alive():
                self._give_up()
        self._tell()

    def _hand(self, job: Job | None) -> None:
        try:
            self._jobs.put(job, timeout=PATIENCE_S)
        except queue.Full:
            self._give_up()

    def _give_up(self) -> None:
        self.failure = self.failure or LogError(
            f"{self._path}: the disk took nothing for {PATIENCE_S:g} s",
            f"what was written until then is in {self._path}.part",
        )
        self._tell()

    def _tell(self) -> None:
        if self.failure is not None and not self._told:
            self._told = True
            raise self.failure

    def _work(self) -> None:
        wait: float | None = None
        while not (self._closed and self.failure and self._jobs.empty()):
            try:
                job = self._jobs.get(timeout=wait)
            except queue.Empty:
                job = _nothing
            if job is None:
                break
            try:
                job()  # with the sink closed by a failure, its methods do nothing
                wait = self._sink.tend()
            except Exception as error:
                self.failure, wait = self.failure or error, None
        with suppress(LogError):
            self._sink.close(complete=False)  # where it could not be done in its turn


def _nothing() -> None:
    pass
