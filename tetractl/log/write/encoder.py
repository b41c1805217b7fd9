"""The messages of a trial: encodes its records and adds them to an MCAP file."""

from google.protobuf.message import Message

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.plan import Outcome
from tetractl.core.trial import Result, Start, Step
from tetractl.log import provenance
from tetractl.log.format import channels, codec, layout
from tetractl.log.format.channels import Entry
from tetractl.log.format.metadata import result_metadata, run_metadata, timing_metadata
from tetractl.log.format.scene import Scene, encode_note
from tetractl.log.write.sink import Sink

FLUSH_NS = SECOND
"""A chunk ends after this much trial time, so that a simulation that runs faster than the wall
clock gives the same chunks again. A slower trial is flushed by the wall clock, `sink.CHUNK_S`."""


class Encoder:
    """Adds the records of one trial to a `Sink`.

    A message has two times [Unix ns]: log_time, when the host received or sent it, and
    publish_time, when its content was sampled.
    """

    def __init__(self, sink: Sink, start: Start) -> None:
        self._sink = sink
        self._start_ns = start.start_unix_ns
        self._names, self._unit = start.setup.names, start.setup.unit
        self._scene = Scene(start.setup)
        self._tracked = [True] * len(self._names)
        self._warnings = 0  # the end of the trial is told by its outcome, and does not count
        self._batch: list[Entry] = []
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
        self._add(channels.SCENE, self._scene.static(self._start_ns), 0)
        self._note(Note(0, "info", f"trial {start.trial} of {start.setup.name} starts"))
        self._write()
        self._sink.sync()

    def samples(self, samples: list[Sample]) -> None:
        """Add camera frames: measured, as transforms, and true where known."""
        for sample in samples:
            seen = sample.observation
            received_ns, sampled_ns = seen.received_ns, seen.sampled_ns
            self._add(channels.MOCAP, codec.encode_observation(seen), received_ns, sampled_ns)
            if sample.truth is not None:
                truth = codec.encode_truth(seen, sample.truth)
                self._add(channels.TRUTH, truth, received_ns, sampled_ns)
            transforms = self._scene.transforms(seen, self._start_ns + sampled_ns)
            self._add(channels.TRANSFORMS, transforms, received_ns, sampled_ns)
            self._note_tracking(seen.valid.tolist(), received_ns)
        if samples:
            self._write(samples[-1].observation.received_ns)

    def command(self, command: Command) -> None:
        """Add a command sent outside the control steps."""
        self._add(channels.COMMANDS, codec.encode_command(command), command.sent_ns)
        self._write()

    def note(self, note: Note) -> None:
        """Add a message for people."""
        self._note(note)
        self._write()

    def step(self, step: Step) -> None:
        """Add a control step: decision, command, planned path, time of solving and estimate."""
        path, sent_ns = step.plan.path, step.command.sent_ns
        sampled_ns, unix_ns = step.observation.sampled_ns, self._start_ns + sent_ns
        self._add(channels.STEP, codec.encode_step(step), sent_ns, sampled_ns)
        self._add(channels.COMMANDS, codec.encode_command(step.command), sent_ns)
        self._add(channels.PLAN, self._scene.plan_poses(path, unix_ns), sent_ns, sampled_ns)
        self._add(channels.SCENE_PLAN, self._scene.plan_lines(path, unix_ns), sent_ns, sampled_ns)
        self._add(channels.HOST_TIMING, codec.encode_timing(step), sent_ns)
        if step.plan.estimate is not None:
            estimate = codec.encode_estimate(step.k, step.plan.estimate)
            self._add(channels.ESTIMATE, estimate, sent_ns, sampled_ns)
        for name, delivered in zip(self._names, step.command.delivered, strict=True):
            if not delivered:
                text = f"{name} did not get the command of step {step.k}"
                self._note(Note(sent_ns, "warning", text))
        self._write(sent_ns)

    def stop(self, stop: Command, result: Result) -> None:
        """Add the stop and the result."""
        warnings = self._warnings
        self._add(channels.COMMANDS, codec.encode_command(stop), stop.sent_ns)
        level = "error" if result.outcome is Outcome.ABORTED else "info"
        self._note(Note(stop.sent_ns, level, result.summary))
        self._write()
        timing = timing_metadata(result) | {"ended": provenance.now()}
        self._sink.last_host_metadata(channels.TIMING, timing)
        self._sink.last_metadata(channels.RESULT, result_metadata(result, self._unit, warnings))

    def _add(
        self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None
    ) -> None:
        log_unix = self._start_ns + log_ns
        publish_unix = log_unix if publish_ns is None else self._start_ns + publish_ns
        self._batch.append(Entry(topic, log_unix, publish_unix, message.SerializeToString()))

    def _note(self, note: Note) -> None:
        self._warnings += note.level in ("warning", "error")
        self._add(channels.LOG, encode_note(note, self._start_ns), note.t_ns)

    def _note_tracking(self, valid: list[bool], log_ns: int) -> None:
        if valid == self._tracked:
            return
        for name, was, now in zip(self._names, self._tracked, valid, strict=True):
            if was != now:
                level, word = ("info", "tracked again") if now else ("warning", "lost")
                self._note(Note(log_ns, level, f"{name} is {word}"))
        self._tracked = valid

    def _write(self, trial_ns: int | None = None) -> None:
        """Write the encoded messages; end the chunk after each second of the trial."""
        batch, self._batch = self._batch, []
        self._sink.messages(batch)
        if trial_ns is not None and trial_ns - self._flushed_ns >= FLUSH_NS:
            self._sink.flush()
            self._flushed_ns = trial_ns
