"""The log writer: an observer that stores a trial in an MCAP file."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from tetractl.core.commands import Command
from tetractl.core.errors import LogError
from tetractl.core.protocols import Observer
from tetractl.core.trial import Result, Start
from tetractl.log.write.encoder import Encoder
from tetractl.log.write.sink import TRIAL_PART_SUFFIX, Sink
from tetractl.tools.worker import Relay, Worker

QUEUE_MAX = 1000
"""Maximum number of calls in the queue. In the lab, they last for more than a minute."""
DISK_PATIENCE_S = 30.0
"""Maximum time for which the disk may accept no data, before the log is given up [s]."""
BATCH_S = 0.5
"""Time for which the calls of a simulation are collected, before all are processed [s]."""


@dataclass(frozen=True, slots=True)
class _OpenLog:
    """A log that is being written. The thread of `worker` encodes and stores its records."""

    sink: Sink
    encoder: Encoder
    worker: Worker
    start_unix_ns: int


class LogWriter(Relay):
    """An observer that stores one trial in a log file, in a thread of its own.

    Until the trial has ended, the file has another suffix. The thread encodes and writes, and calls
    only put records in a queue. While the queue is full, a call waits: up to DISK_PATIENCE_S in a
    simulation, which runs faster than any disk, and not at all in real time. If the queue stays
    full or a write fails, the log is given up: the next call raises LogError, later calls do
    nothing, and the records in the file stay readable.

    Args:
        path: Path of the log after the trial has ended.
        real_time: Whether the trial runs in real time.
        part_suffix: Suffix of the file until then. The copy of a log has another suffix.
        keeps_part: Whether the file keeps this suffix at the end, because another log takes its
            place.
    """

    def __init__(
        self,
        path: Path,
        real_time: bool = False,
        *,
        part_suffix: str = TRIAL_PART_SUFFIX,
        keeps_part: bool = False,
    ) -> None:
        self._path = path
        self._real_time = real_time
        self._part_suffix = part_suffix
        self._keeps_part = keeps_part
        self._log: _OpenLog | None = None  # None before the start, or if the start failed
        self._early_failure: OSError | None = None  # of the disk, before the log began

    @property
    def failure(self) -> Exception | None:
        """The reason why the log can no longer be written. None while it can."""
        return None if self._log is None else self._log.worker.failure

    def on_start(self, start: Start) -> None:
        """Create the file, store metadata, specs and scene, and wait until they are on the disk."""
        sink = Sink(self._path, self._part_suffix)
        encoder = Encoder(sink, self._real_time, hosted=True)
        worker = Worker(
            f"log {self._path.name}",
            size=QUEUE_MAX,
            wait_s=0.0 if self._real_time else DISK_PATIENCE_S,
            patience_s=DISK_PATIENCE_S,
            too_slow=LogError(
                f"{self._path}: the disk is too slow to write this log",
                f"the log written so far is in {self._path}{self._part_suffix}",
            ),
            idle=sink.flush_if_due,
            batch_s=0.0 if self._real_time else BATCH_S,
        )
        self._log = _OpenLog(sink, encoder, worker, start.start_unix_ns)
        worker.put(encoder.on_start, start)
        if self._early_failure is not None:
            worker.put(sink.fail, self._early_failure)
        worker.put(sink.sync)
        worker.drain()  # no robot moves before the start of the log is on the disk

    def put(self, call: Callable[[Observer], object]) -> None:
        """Queue a call of the encoder, which the writing thread makes later.

        Nothing happens before the start of the trial. Raises LogError if the log was given up.
        """
        if self._log is not None:
            self._log.worker.put(call, self._log.encoder)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result, wait until they are on the disk, and rename the log.

        The log is not renamed if it keeps its suffix.
        """
        log = self._log
        if log is None:
            return
        super().on_stop(stop, result)
        log.worker.put(log.sink.seal, log.start_unix_ns + stop.sent_ns)
        self._close(complete=not self._keeps_part)
        log.worker.check()

    def drain(self) -> None:
        """Wait until the writing thread has processed all calls so far."""
        if self._log is not None:
            self._log.worker.drain()

    def fail(self, error: OSError) -> None:
        """Simulate a disk failure, as an emulated lab does: the next call raises LogError."""
        log = self._log
        if log is None:
            self._early_failure = error
        elif log.worker.failure is None:
            log.worker.put(log.sink.fail, error)
            log.worker.wait()

    def close(self) -> None:
        """Close the log. If the trial has not ended, the file keeps the suffix .part."""
        self._close(complete=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _close(self, complete: bool) -> None:
        """Process the calls in the queue, finish the file and end the thread."""
        log = self._log
        if log is None:
            return

        def finish() -> None:
            log.encoder.flush_frames()
            log.sink.close(complete and log.worker.failure is None)

        log.worker.close(finish)
