"""The log writer: an observer that stores a trial in an MCAP file."""

from pathlib import Path
from typing import Self

from tetractl.core.commands import Command
from tetractl.core.errors import LogError
from tetractl.core.trial import Result, Start
from tetractl.log.write.encoder import Encoder
from tetractl.log.write.sink import Sink
from tetractl.tools.worker import Relay, Worker

QUEUE_MAX = 1000
"""Calls in the queue for the disk: over a minute of a trial in the lab."""
DISK_PATIENCE_S = 30.0
"""Time after which a disk that accepts no data is given up [s]."""
BATCH_S = 0.5
"""Time for which the calls of a simulation are collected [s]."""


class LogWriter(Relay):
    """Stores one trial as `path`, which is called `path`.part until the trial has ended.

    One thread encodes and writes; calls only put records in a queue. While the queue is full, a
    call waits: up to DISK_PATIENCE_S in a simulation, which runs faster than any disk, and not at
    all in `real_time`. If the queue stays full or a write fails, the log is given up: the next
    call raises LogError, later calls do nothing, and the records in the file stay readable.
    """

    def __init__(self, path: Path, real_time: bool = False) -> None:
        self._path = path
        self._real_time = real_time
        self._early_failure: OSError | None = None  # of the disk, before the log began

    @property
    def digest(self) -> str:
        """The content digest of the records written so far."""
        return self._sink.digests.content

    @property
    def warnings(self) -> int:
        """The number of operator warnings and errors so far."""
        return self._encoder.warnings if self.worker else 0

    @property
    def failure(self) -> Exception | None:
        """The reason why the log can no longer be written; None while it can."""
        return self.worker.failure if self.worker else None

    def on_start(self, start: Start) -> None:
        """Create the file; store metadata, specs and scene, and wait until the disk has them."""
        self._start_ns = start.start_unix_ns
        self._sink = Sink(self._path)
        self._encoder = Encoder(self._sink, self._real_time, hosted=True)
        self.observer = self._encoder
        self.worker = Worker(
            f"log {self._path.name}",
            size=QUEUE_MAX,
            wait_s=0.0 if self._real_time else DISK_PATIENCE_S,
            patience_s=DISK_PATIENCE_S,
            too_slow=LogError(
                f"{self._path}: the disk is too slow for this log",
                f"the log so far is in {self._path}.part",
            ),
            idle=self._sink.flush_if_due,
            batch_s=0.0 if self._real_time else BATCH_S,
        )
        self.put(lambda: self.observer.on_start(start))
        if self._early_failure is not None:
            self.worker.put(self._sink.fail, self._early_failure)
        self.worker.put(self._sink.sync)
        self.worker.drain()  # no robot moves before the start of the log is on the disk

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result, wait until the disk has them, and rename the log."""
        if self.worker:
            self.put(lambda: self.observer.on_stop(stop, result))
            self.worker.put(self._sink.seal, self._start_ns + stop.sent_ns)
            self._close(complete=True)
            self.worker.check()

    def fail(self, error: OSError) -> None:
        """Let the disk fail from now on, as an emulated lab does: the next call raises LogError."""
        if self.worker is None:
            self._early_failure = error
        elif self.worker.failure is None:
            self.worker.put(self._sink.fail, error)
            self.worker.wait()

    def close(self) -> None:
        """Close the log; if the trial has not ended, the file keeps the suffix .part."""
        self._close(complete=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _close(self, complete: bool) -> None:
        """Process the calls in the queue, finish the file and end the thread."""
        if self.worker:
            self.worker.close(lambda: self._finish(complete and self.failure is None))

    def _finish(self, complete: bool) -> None:
        self._encoder.flush_frames()
        self._sink.close(complete)
