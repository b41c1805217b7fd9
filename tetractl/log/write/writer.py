"""The log writer: an observer that stores a trial in an MCAP file."""

from pathlib import Path
from types import TracebackType
from typing import Self

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.errors import LogError
from tetractl.core.trial import Result, Start, Step
from tetractl.core.worker import Worker
from tetractl.log.write.encoder import Encoder
from tetractl.log.write.sink import Sink

SIZE = 1000  # calls that may wait for the disk: over a minute of a trial in the lab
PATIENCE_S = 30.0  # for a disk that stands still
GATHER_S = 0.5  # in which calls gather in a simulation


class LogWriter:
    """Stores one trial as `path`, which is called `path`.part until the trial has ended.

    One thread encodes and writes; the calls only queue. While the queue is full a call waits: up to
    PATIENCE_S in a simulation, which runs faster than any disk, and not at all in `real_time`. If
    the queue stays full, or the file system refuses a write, the log is given up: the next call
    raises LogError, once, and later calls do nothing. What is in the file stays readable.
    """

    def __init__(self, path: Path, real_time: bool = False) -> None:
        self._path, self._real_time = path, real_time
        self._worker: Worker | None = None

    @property
    def failure(self) -> Exception | None:
        """Why the log can no longer be written, None while it can."""
        return self._worker.failure if self._worker else None

    def on_start(self, start: Start) -> None:
        """Create the file; store metadata, specs and scene, and wait until the disk has them."""
        self._sink = Sink(self._path)
        self._encoder = Encoder(self._sink, start)
        self._worker = Worker(
            f"log {self._path.name}",
            size=SIZE,
            wait_s=0.0 if self._real_time else PATIENCE_S,
            patience_s=PATIENCE_S,
            too_slow=LogError(
                f"{self._path}: the disk is too slow for the log",
                f"what was written until then is in {self._path}.part",
            ),
            tend=self._sink.tend,
            gather_s=0.0 if self._real_time else GATHER_S,
        )
        self._worker.put(self._encoder.start, start)
        self._worker.drain()  # nothing moves before the log is known to be written

    def on_samples(self, samples: list[Sample]) -> None:
        """Queue camera frames."""
        if self._worker:
            self._worker.put(self._encoder.samples, samples)

    def on_command(self, command: Command) -> None:
        """Queue a command sent outside the control steps."""
        if self._worker:
            self._worker.put(self._encoder.command, command)

    def on_note(self, note: Note) -> None:
        """Queue a message for people."""
        if self._worker:
            self._worker.put(self._encoder.note, note)

    def on_step(self, step: Step) -> None:
        """Queue a control step."""
        if self._worker:
            self._worker.put(self._encoder.step, step)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result, wait until the disk has them, and rename the log."""
        if self._worker:
            self._worker.put(self._encoder.stop, stop, result)
            self._close(complete=True)
            self._worker.check()

    def close(self) -> None:
        """Close the log; that of a trial without an end stays a .part."""
        self._close(complete=False)

    def drain(self) -> None:
        """Wait until every chunk that has ended is written."""
        if self._worker:
            self._worker.drain()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _close(self, complete: bool) -> None:
        """Do what waits, finish the file and end the thread."""
        if self._worker:
            self._worker.close(lambda: self._sink.close(complete and self.failure is None))
