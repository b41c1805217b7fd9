"""The log writer: an observer that stores a trial in an MCAP file."""

from pathlib import Path
from types import TracebackType
from typing import Self

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import Message

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.plan import Outcome
from tetractl.core.trial import Result, Start, Step
from tetractl.log import provenance
from tetractl.log.format import channels, codec
from tetractl.log.format.channels import Entry
from tetractl.log.format.metadata import result_metadata, run_metadata, timing_metadata
from tetractl.log.format.scene import Scene, note
from tetractl.log.write.sink import Sink
from tetractl.log.write.spool import Desk

FLUSH_NS = 1_000_000_000
"""A chunk ends after this much trial time, so that a simulated trial gives the same chunks again
while it runs faster than the clock. What runs slower is flushed by the clock, `sink.CHUNK_S`."""


_LEVELS = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}


class LogWriter:
    """Stores one trial as `path`, which is called `path`.part until the trial has ended.

    Every message has two times, Unix ns: log_time is when the host received or sent it and
    publish_time when what it tells of was sampled. Calls only encode; a thread writes. Any call
    raises LogError where the log cannot be written, the call after it was found at the latest; what
    was written until then stays readable.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._desk: Desk | None = None
        self._batch: list[Entry] = []
        self._flushed_ns = 0
        self._tracked: list[bool] = []

    def on_start(self, start: Start) -> None:
        """Create the file; store the run's facts, the specs, and the scene."""
        self._start_ns = start.start_unix_ns
        self._names, self._unit = start.setup.names, start.setup.unit
        self._scene = Scene(start.setup)
        self._tracked = [True] * len(self._names)
        self._desk = desk = Desk(self._path)
        desk.put(Sink.metadata, channels.RUN, run_metadata(start))
        desk.put(Sink.metadata, channels.HOST, provenance.facts(start.packages))
        for name, media_type, text in (
            (channels.SPEC, "application/yaml", start.spec_text),
            (channels.RESOLVED_SPEC, "application/yaml", start.resolved),
            (channels.ENVIRONMENT, "application/json", provenance.environment()),
            *((name, "application/yaml", text) for name, text in start.attached),
        ):
            desk.put(Sink.attachment, name, media_type, self._start_ns, text.encode())
        self._put(channels.SCENE, self._scene.static(self._start_ns), 0)
        self._note(0, Log.INFO, f"trial {start.trial} of {start.setup.name} starts")
        self._hand_on()
        desk.put(Sink.sync)
        desk.drain()  # nothing moves before the log is known to be written

    def on_samples(self, samples: list[Sample]) -> None:
        """Store camera frames: measured, as transforms, and true where known."""
        if self._desk is None:
            return
        for sample in samples:
            seen = sample.observation
            received_ns, sampled_ns = seen.received_ns, seen.sampled_ns
            self._put(channels.MOCAP, codec.encode_observation(seen), received_ns, sampled_ns)
            if sample.truth is not None:
                truth = codec.encode_truth(seen, sample.truth)
                self._put(channels.TRUTH, truth, received_ns, sampled_ns)
            transforms = self._scene.transforms(seen, self._start_ns + sampled_ns)
            self._put(channels.TRANSFORMS, transforms, received_ns, sampled_ns)
            self._note_tracking(seen.valid.tolist(), received_ns)
        if samples:
            self._hand_on(samples[-1].observation.received_ns)

    def on_command(self, command: Command) -> None:
        """Store a command sent outside the control steps."""
        self._put(channels.COMMANDS, codec.encode_command(command), command.sent_ns)
        self._hand_on()

    def on_note(self, note: Note) -> None:
        """Store what a person should know of."""
        self._note(note.t_ns, _LEVELS[note.level], note.text)
        self._hand_on()

    def on_step(self, step: Step) -> None:
        """Store a decision, its command, its picture and how long it took."""
        if self._desk is None:
            return
        path, sent_ns = step.plan.path, step.command.sent_ns
        sampled_ns, unix_ns = step.observation.sampled_ns, self._start_ns + sent_ns
        self._put(channels.STEP, codec.encode_step(step), sent_ns, sampled_ns)
        self._put(channels.COMMANDS, codec.encode_command(step.command), sent_ns)
        self._put(channels.PLAN, self._scene.plan_poses(path, unix_ns), sent_ns, sampled_ns)
        self._put(channels.SCENE_PLAN, self._scene.plan_lines(path, unix_ns), sent_ns, sampled_ns)
        self._put(channels.HOST_TIMING, codec.encode_timing(step), sent_ns)
        for name, delivered in zip(self._names, step.command.delivered, strict=True):
            if not delivered:
                text = f"{name} did not get the command of step {step.k}"
                self._note(sent_ns, Log.WARNING, text)
        self._hand_on(sent_ns)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result, and give the log its name."""
        if self._desk is None:
            return
        self._put(channels.COMMANDS, codec.encode_command(stop), stop.sent_ns)
        level = Log.ERROR if result.outcome is Outcome.ABORTED else Log.INFO
        reason = f" ({result.reason})" if result.reason else ""
        text = f"{result.outcome.value}{reason} after {result.steps} control steps"
        self._note(stop.sent_ns, level, text)
        self._hand_on()
        facts = result_metadata(result, self._unit)
        timing = timing_metadata(result) | {"ended": provenance.now()}
        self._desk.put(Sink.metadata, channels.TIMING, timing)
        self._desk.put(Sink.last_metadata, channels.RESULT, facts)
        self._desk.close(complete=True)

    def close(self) -> None:
        """Close a log whose trial did not end: it keeps its .part."""
        if self._desk:
            self._desk.close(complete=False)

    def drain(self) -> None:
        """Wait until the file system has been handed all chunks that have ended."""
        if self._desk:
            self._desk.drain()

    @property
    def failure(self) -> Exception | None:
        """Why the log can no longer be written, as soon as that is known."""
        return self._desk.failure if self._desk else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _put(
        self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None
    ) -> None:
        if self._desk:
            log_unix = self._start_ns + log_ns
            publish_unix = log_unix if publish_ns is None else self._start_ns + publish_ns
            data = message.SerializeToString()
            self._batch.append(Entry(topic, log_unix, publish_unix, data))

    def _note(self, log_ns: int, level: Log.Level.ValueType, text: str) -> None:
        self._put(channels.LOG, note(self._start_ns + log_ns, level, text), log_ns)

    def _note_tracking(self, valid: list[bool], log_ns: int) -> None:
        if valid == self._tracked:
            return
        for name, was, now in zip(self._names, self._tracked, valid, strict=True):
            if was != now:
                level, word = (Log.INFO, "tracked again") if now else (Log.WARNING, "lost")
                self._note(log_ns, level, f"{name} is {word}")
        self._tracked = valid

    def _hand_on(self, trial_ns: int | None = None) -> None:
        """Give the thread what was encoded; end the chunk where a second of the trial has gone."""
        if self._desk is None:
            return
        batch, self._batch = self._batch, []
        self._desk.put(Sink.messages, batch)
        if trial_ns is not None and trial_ns - self._flushed_ns >= FLUSH_NS:
            self._desk.put(Sink.flush)
            self._flushed_ns = trial_ns
