"""The log writer: an observer that stores a trial in an MCAP file."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Protocol, Self

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.errors import LogError
from tetractl.core.trial import Result, Start, Step
from tetractl.core.worker import Worker
from tetractl.log import provenance
from tetractl.log.format import channels, layout
from tetractl.log.format.channels import Entry
from tetractl.log.format.codec import Frames
from tetractl.log.format.run_records import encode_facts
from tetractl.log.format.tetractl_pb2 import Host, HostEnd
from tetractl.log.write.messages import Messages
from tetractl.log.write.sink import Sink

QUEUE_MAX = 1000  # length of the queue for the disk: over a minute of a trial in the lab
PATIENCE_S = 30.0  # time after which a disk that accepts no data is given up [s]
BATCH_S = 0.5  # time for which calls are collected in a simulation [s]

CHUNK_NS = 2 * SECOND
"""Length of a simulation's chunks [ns of trial time], so that a repeated simulation has the same
chunks. If a simulation is slower than real time, `sink.CHUNK_S` also ends chunks.
"""
LAB_CHUNK_NS = SECOND // 4  # trial time of a chunk in the lab, which a crash may lose [ns]


class RecordSink(Protocol):
    """Takes the records of a log, in their order."""

    def messages(self, entries: Iterable[Entry]) -> None:
        """Add messages."""
        ...

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        """Add an attachment."""
        ...

    def flush(self) -> None:
        """End the chunk of the messages so far."""
        ...


class Encoder:
    """An observer that adds the records of one trial to a sink; without the host records, which
    differ from run to run, if not `hosted`.
    """

    def __init__(self, sink: RecordSink, real_time: bool = False, hosted: bool = False) -> None:
        self._sink, self._real_time, self._hosted = sink, real_time, hosted
        self._waiting: list[Frames] = []  # frames of a simulation's open chunk
        self._chunk_ns = LAB_CHUNK_NS if real_time else CHUNK_NS
        self._flushed_ns = 0

    @property
    def warnings(self) -> int:
        """The number of operator warnings and errors so far."""
        return self._messages.warnings

    def on_start(self, start: Start) -> None:
        """Add what identifies the trial, specs and scene."""
        self._start_ns, self._messages = start.start_unix_ns, Messages(start)
        self._robots = len(start.setup.names)
        run, *scene = self._messages.start()
        self._sink.messages([run])
        if self._hosted:
            host = Host(facts=encode_facts(provenance.host_facts(start.packages)))
            self._sink.messages([Entry.of(channels.HOST, host, self._start_ns)])
            self._attach(channels.ENVIRONMENT, "application/json", provenance.environment())
        for name, text in (
            (channels.SPEC, start.spec_text),
            (channels.RESOLVED_SPEC, start.resolved),
            *start.attached,
        ):
            self._attach(name, "application/yaml", text)
        self._attach(channels.LAYOUT, layout.MEDIA_TYPE, layout.layout(start.setup))
        self._sink.messages(scene)

    def _attach(self, name: str, media_type: str, text: str) -> None:
        self._sink.attachment(name, media_type, self._start_ns, text.encode())

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Add camera frames; those of a simulation are collected until their chunk ends."""
        if samples:
            frames = Frames.of(samples, self._robots)
            self.on_frames(frames)
            for sample in samples:
                self._sink.messages(self._messages.film(sample))
            self._end_chunk(int(frames.received_ns[-1]))

    def on_frames(self, frames: Frames) -> None:
        """Add camera frames without their film."""
        self._sink.messages(self._messages.tracking(frames))
        self._waiting.append(frames)
        if self._real_time:
            self.flush_frames()

    def flush_frames(self) -> None:
        """Add the collected camera frames to the sink."""
        if self._waiting:
            self._sink.messages(self._messages.frames(Frames.joined(self._waiting)))
            self._waiting = []

    def on_command(self, command: Command) -> None:
        """Add a command sent outside the control steps."""
        self._sink.messages([self._messages.command(command)])

    def on_note(self, note: Note) -> None:
        """Add an operator message."""
        self._sink.messages([self._messages.note(note)])

    def on_step(self, step: Step) -> None:
        """Add a control step."""
        self._sink.messages(self._messages.step(step))
        self._end_chunk(step.command.sent_ns)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Add the stop and, in a chunk of its own, the result."""
        self.flush_frames()
        *ended, run, stated = self._messages.stop(stop, result)
        self._sink.messages(ended)
        self._sink.flush()
        if self._hosted:
            end = HostEnd(
                solve_ns=result.solve_ns,
                deadline_misses=result.deadline_misses,
                ended=provenance.now(),
            )
            self._sink.messages([Entry.of(channels.HOST_END, end, stated.log_ns)])
        self._sink.messages([run, stated])

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
    def digest(self) -> str:
        """The content digest of the records written so far."""
        return self._sink.digests.stated().content

    @property
    def warnings(self) -> int:
        """The number of operator warnings and errors so far."""
        return self._encoder.warnings if self._worker else 0

    @property
    def failure(self) -> Exception | None:
        """The reason why the log can no longer be written; None while it can."""
        return self._worker.failure if self._worker else None

    def on_start(self, start: Start) -> None:
        """Create the file; store metadata, specs and scene, and wait until the disk has them."""
        self._sink, self._start_ns = Sink(self._path), start.start_unix_ns
        self._encoder = Encoder(self._sink, self._real_time, hosted=True)
        self._worker = Worker(
            f"log {self._path.name}",
            size=QUEUE_MAX,
            wait_s=0.0 if self._real_time else PATIENCE_S,
            patience_s=PATIENCE_S,
            too_slow=LogError(
                f"{self._path}: the disk is too slow for this log",
                f"the log so far is in {self._path}.part",
            ),
            idle=self._sink.flush_if_due,
            batch_s=0.0 if self._real_time else BATCH_S,
        )
        self._put(Encoder.on_start, start)
        self._worker.put(self._sink.sync)
        self._worker.drain()  # no robot moves before the start of the log is on the disk

    def on_samples(self, samples: list[Sample]) -> None:
        """Queue camera frames."""
        self._put(Encoder.on_samples, samples)

    def on_command(self, command: Command) -> None:
        """Queue a command sent outside the control steps."""
        self._put(Encoder.on_command, command)

    def on_note(self, note: Note) -> None:
        """Queue an operator message."""
        self._put(Encoder.on_note, note)

    def on_step(self, step: Step) -> None:
        """Queue a control step."""
        self._put(Encoder.on_step, step)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result, wait until the disk has them, and rename the log."""
        if self._worker:
            self._put(Encoder.on_stop, stop, result)
            self._worker.put(self._sink.seal, self._start_ns + stop.sent_ns)
            self._close(complete=True)
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
        """Queue a call of the encoder's, unless the file could not be created."""
        if self._worker:
            self._worker.put(call, self._encoder, *records)

    def _close(self, complete: bool) -> None:
        """Process the calls in the queue, finish the file and end the thread."""
        if self._worker:
            self._worker.close(lambda: self._finish(complete and self.failure is None))

    def _finish(self, complete: bool) -> None:
        self._encoder.flush_frames()
        self._sink.close(complete)
