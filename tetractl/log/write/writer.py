"""The log writer: an observer that stores a trial in an MCAP file."""

from collections.abc import Callable
from pathlib import Path
from typing import Self

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.errors import LogError
from tetractl.core.trial import Result, Start, Step
from tetractl.core.worker import Worker
from tetractl.log import provenance
from tetractl.log.format import channels, layout
from tetractl.log.format.codec import Frames
from tetractl.log.format.digest import DIGEST, HOST_DIGEST
from tetractl.log.format.metadata import result_metadata, run_metadata, timing_metadata
from tetractl.log.write.messages import Messages
from tetractl.log.write.sink import Sink

SIZE = 1000  # length of the queue for the disk: over a minute of a trial in the lab
PATIENCE_S = 30.0  # time after which a disk that accepts no data is given up [s]
BATCH_S = 0.5  # time for which calls are collected in a simulation [s]

CHUNK_NS = 2 * SECOND
"""Length of a simulation's chunks [ns of trial time], so that a repeated simulation has the same
chunks. If a simulation is slower than real time, `sink.CHUNK_S` also ends chunks.
"""
LAB_CHUNK_NS = SECOND // 4  # trial time of a chunk in the lab, which a crash may lose [ns]


class Encoder:
    """Adds the records of one trial to a `Sink`."""

    def __init__(self, sink: Sink, start: Start, real_time: bool) -> None:
        self._sink, self._real_time = sink, real_time
        self._start_ns = start.start_unix_ns
        self._unit = start.setup.unit
        self._messages = Messages(start)
        self._robots = len(start.setup.names)
        self._waiting: list[Frames] = []  # frames of a simulation's open chunk
        self._chunk_ns = LAB_CHUNK_NS if real_time else CHUNK_NS
        self._flushed_ns = 0

    def start(self, start: Start) -> None:
        """Add metadata, specs and scene, and sync the file."""
        self._sink.metadata(channels.RUN, run_metadata(start))
        self._sink.metadata(channels.HOST, provenance.host_metadata(start.packages))
        for name, media_type, text in (
            (channels.SPEC, "application/yaml", start.spec_text),
            (channels.RESOLVED_SPEC, "application/yaml", start.resolved),
            (channels.ENVIRONMENT, "application/json", provenance.environment()),
            (channels.LAYOUT, layout.MEDIA_TYPE, layout.layout(start.setup)),
            *((name, "application/yaml", text) for name, text in start.attached),
        ):
            self._sink.attachment(name, media_type, self._start_ns, text.encode())
        self._sink.messages(self._messages.start())
        self._sink.sync()

    def samples(self, samples: list[Sample]) -> None:
        """Add camera frames; those of a simulation are collected until their chunk ends."""
        if samples:
            frames = Frames.of(samples, self._robots)
            self._sink.messages(self._messages.tracking(frames))
            self._waiting.append(frames)
            if self._real_time:
                self.flush_frames()
            for sample in samples:
                self._sink.messages(self._messages.film(sample))
            self._end_chunk(samples[-1].observation.received_ns)

    def flush_frames(self) -> None:
        """Add the collected camera frames to the sink."""
        if self._waiting:
            self._sink.messages(self._messages.frames(Frames.joined(self._waiting)))
            self._waiting = []

    def command(self, command: Command) -> None:
        """Add a command sent outside the control steps."""
        self._sink.messages([self._messages.command(command)])

    def note(self, note: Note) -> None:
        """Add an operator message."""
        self._sink.messages([self._messages.note(note)])

    def step(self, step: Step) -> None:
        """Add a control step."""
        self._sink.messages(self._messages.step(step))
        self._end_chunk(step.command.sent_ns)

    def stop(self, stop: Command, result: Result) -> None:
        """Add the stop and the result."""
        self.flush_frames()
        self._sink.messages(self._messages.stop(stop, result))
        timing = timing_metadata(result) | {"ended": provenance.now()}
        self._sink.metadata(channels.TIMING, timing, HOST_DIGEST)
        stated = result_metadata(result, self._unit, self._messages.warnings)
        self._sink.metadata(channels.RESULT, stated, DIGEST)

    def _end_chunk(self, trial_ns: int) -> None:
        """End the chunk if it has its full length at `trial_ns`, the time of the trial."""
        if trial_ns - self._flushed_ns >= self._chunk_ns:
            self.flush_frames()
            self._sink.flush()
            self._flushed_ns = trial_ns


class LogWriter:
    """Stores one trial as `path`, which is called `path`.part until the trial has ended.

    One thread encodes and writes; calls only put records in a queue. While the queue is full, a
    call waits: up to PATIENCE_S in a simulation, which runs faster than any disk, and not at
    all in `real_time`. If the queue stays full or a write fails, the log is given up: the next
    call raises LogError, later calls do nothing, and the records in the file stay readable.
    """

    def __init__(self, path: Path, real_time: bool = False) -> None:
        self._path, self._real_time = path, real_time
        self._worker: Worker | None = None

    @property
    def failure(self) -> Exception | None:
        """The reason why the log can no longer be written; None while it can."""
        return self._worker.failure if self._worker else None

    def on_start(self, start: Start) -> None:
        """Create the file; store metadata, specs and scene, and wait until the disk has them."""
        self._sink = Sink(self._path)
        self._encoder = Encoder(self._sink, start, self._real_time)
        self._worker = Worker(
            f"log {self._path.name}",
            size=SIZE,
            wait_s=0.0 if self._real_time else PATIENCE_S,
            patience_s=PATIENCE_S,
            too_slow=LogError(
                f"{self._path}: the disk is too slow for this log",
                f"the log so far is in {self._path}.part",
            ),
            idle=self._sink.flush_if_due,
            batch_s=0.0 if self._real_time else BATCH_S,
        )
        self._put(Encoder.start, start)
        self._worker.drain()  # no robot moves before the start of the log is on the disk

    def on_samples(self, samples: list[Sample]) -> None:
        """Queue camera frames."""
        self._put(Encoder.samples, samples)

    def on_command(self, command: Command) -> None:
        """Queue a command sent outside the control steps."""
        self._put(Encoder.command, command)

    def on_note(self, note: Note) -> None:
        """Queue an operator message."""
        self._put(Encoder.note, note)

    def on_step(self, step: Step) -> None:
        """Queue a control step."""
        self._put(Encoder.step, step)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result, wait until the disk has them, and rename the log."""
        self._put(Encoder.stop, stop, result)
        self._close(complete=True)
        if self._worker:
            self._worker.check()

    def close(self) -> None:
        """Close the log; if the trial has not ended, the file keeps the suffix .part."""
        self._close(complete=False)

    def drain(self) -> None:
        """Wait until every chunk that has ended is written."""
        if self._worker:
            self._worker.drain()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _put(self, call: Callable[..., None], *records: object) -> None:
        if self._worker:
            self._worker.put(call, self._encoder, *records)

    def _close(self, complete: bool) -> None:
        """Process the calls in the queue, finish the file and end the thread."""
        if self._worker:
            self._worker.close(lambda: self._finish(complete and self.failure is None))

    def _finish(self, complete: bool) -> None:
        self._encoder.flush_frames()
        self._sink.close(complete)
