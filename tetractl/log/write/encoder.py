"""An observer that encodes the records of one trial as messages with topics and times."""

from collections.abc import Iterable, Sequence
from typing import Protocol

from google.protobuf.message import Message

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation
from tetractl.core.trial import Result, Start, Step
from tetractl.log import provenance
from tetractl.log.format import channels, codec, layout
from tetractl.log.format.channels import Entry
from tetractl.log.format.codec import Frames
from tetractl.log.format.run_records import encode_facts, encode_result, encode_run
from tetractl.log.format.scene import Scene, encode_note
from tetractl.log.format.tetractl_pb2 import Host, HostEnd

CHUNK_NS = 2 * SECOND
"""Length of a simulation's chunks [ns of trial time], so that a repeated simulation has the same
chunks. If a simulation is slower than real time, `sink.CHUNK_S` also ends chunks.
"""
LAB_CHUNK_NS = SECOND // 4  # trial time of a chunk in the lab, which a crash may lose [ns]
MESSAGE_POSES_MAX = 20_000
"""Largest number of poses in a message, which bounds its size."""
SHOWN_HZ = 15
"""Rate of a simulation's transforms for viewers [Hz]; viewers interpolate between transforms."""
PLAN_SHOWN_NS = SECOND * 3 // 20
"""Least time between two plans for viewers [ns]."""


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

    A message has two times [Unix ns]: log_time, when the host received or sent it, and
    publish_time, when its content was sampled. `warnings` counts the operator messages that are
    warnings or errors, except the message on the end of the trial, which repeats the outcome.
    """

    def __init__(self, sink: RecordSink, real_time: bool = False, hosted: bool = False) -> None:
        self._sink, self._real_time, self._hosted = sink, real_time, hosted
        self._waiting: list[Sample] = []  # frames of a simulation's open chunk
        self._chunk_ns = LAB_CHUNK_NS if real_time else CHUNK_NS
        self._flushed_ns = 0
        self.warnings = 0

    def on_start(self, start: Start) -> None:
        """Add what identifies the trial, specs, static scene and the message on the start."""
        setup, plant = start.setup, start.plant
        self._start, self._start_ns = start, start.start_unix_ns
        self._names, self._scene = setup.names, Scene(setup, exact=not plant.simulated)
        self._tracked = b"\1" * len(self._names)  # which robots were tracked in the last frame
        self._every, self._most = 1, 1  # frames per transform shown, and per message
        self._plan_ns = 0  # time of the next plan shown
        if plant.simulated:
            self._every = max(1, round(plant.camera_rate_hz / SHOWN_HZ))
            self._most = max(1, MESSAGE_POSES_MAX // len(self._names))
        self._add(channels.RUN, encode_run(start), 0)
        if self._hosted:
            facts = provenance.host_facts(start.packages)
            self._add(channels.HOST, Host(facts=encode_facts(facts)), 0)
        for name, text in (
            (channels.SPEC, start.spec_text),
            (channels.RESOLVED_SPEC, start.resolved),
            *start.attached,
        ):
            self._attach(name, "application/yaml", text)
        self._attach(channels.LAYOUT, layout.MEDIA_TYPE, layout.layout(setup))
        if self._hosted:  # last, for it may be long, and a log cut off here can still be read
            self._attach(channels.ENVIRONMENT, "application/json", provenance.environment())
        self._add(channels.SCENE, self._scene.static(self._start_ns), 0)
        self._say(0, "info", f"trial {start.trial} of {setup.name} starts")

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Add camera frames; those of a simulation are collected until their chunk ends."""
        if samples:
            for sample in samples:
                self._tell_tracking(sample.observation)
            self._waiting += samples
            if self._real_time:
                self.flush_frames()
            for sample in samples:
                seen = sample.observation
                for topic, data in sample.messages:
                    self._add_bytes(topic, data, seen.received_ns, seen.sampled_ns)
            self._end_chunk(samples[-1].observation.received_ns)

    def flush_frames(self) -> None:
        """Add the collected camera frames to the sink: few messages for a simulation, two per frame
        for a lab.

        A lab's frames cannot be simulated again. Each is therefore stored twice, as poses and as
        transforms with the same times, so that a change of one copy can be detected.
        """
        frames, self._waiting = Frames.of(self._waiting, len(self._names)), []
        begins = range(0, len(frames.numbers), self._most)
        parts = [frames.part(slice(begin, begin + self._most)) for begin in begins]
        shown = [
            part.part(slice((len(part.numbers) - 1) % self._every, None, self._every))
            if self._every > 1
            else part
            for part in parts
        ]
        # of all parts at once, which takes little longer than of one frame
        drawn = self._scene.transforms(shown, self._start_ns) if parts else ()
        for part, some, transforms in zip(parts, shown, drawn, strict=True):
            self._add_frames(part, some, transforms)

    def _add_frames(self, frames: Frames, shown: Frames, transforms: bytes) -> None:
        """Add the message of one or more camera frames, and the transforms of those `shown`.

        The transforms have the time of their first frame, so that a viewer that jumps to a time has
        the transforms before and after it.
        """
        last, first = (
            (int(one.received_ns[i]), int(one.sampled_ns[i]))
            for one, i in ((frames, -1), (shown, 0))
        )
        self._add(channels.FRAMES, codec.encode_frames(frames), *last)
        self._add_bytes(channels.TRANSFORMS, transforms, *first)

    def on_command(self, command: Command) -> None:
        """Add a command sent outside the control steps."""
        self._add(channels.COMMANDS, codec.encode_command(command), command.sent_ns)

    def on_note(self, note: Note) -> None:
        """Add an operator message."""
        self._say(note.t_ns, note.level, note.text)

    def on_step(self, step: Step) -> None:
        """Add a control step: decision, command, planned path, solve time and estimate."""
        sampled_ns, sent_ns = step.observation.sampled_ns, step.command.sent_ns
        command = codec.encode_command(step.command)
        self._add(channels.STEP, codec.encode_step(step, command), sent_ns, sampled_ns)
        self._add(channels.COMMANDS, command, sent_ns)
        if sent_ns >= self._plan_ns:
            self._plan_ns = sent_ns + PLAN_SHOWN_NS
            plan = self._scene.plan(codec.drawn(step.plan.path), self._start_ns + sent_ns)
            self._add_bytes(channels.SCENE_PLAN, plan, sent_ns, sampled_ns)
        self._add(channels.HOST_TIMING, codec.encode_timing(step), sent_ns)
        for name, delivered in zip(self._names, step.command.delivered, strict=True):
            if not delivered:
                self._say(sent_ns, "warning", f"{name} did not get the command of step {step.k}")
        self._end_chunk(sent_ns)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Add the stop and the end; then, in a chunk of its own, the run again, without which a log
        whose first chunk is lost could not be read, and the result.
        """
        self.flush_frames()
        t_ns, warnings = stop.sent_ns, self.warnings
        self._add(channels.COMMANDS, codec.encode_command(stop), t_ns)
        level = "error" if result.outcome is Outcome.ABORTED else "info"
        self._say(t_ns, level, result.summary.replace(result.outcome, result.outcome.logged, 1))
        self._sink.flush()
        if self._hosted:
            end = HostEnd(
                solve_ns=result.solve_ns,
                deadline_misses=result.deadline_misses,
                ended=provenance.now(),
            )
            self._add(channels.HOST_END, end, t_ns)
        self._add(channels.RUN, encode_run(self._start), t_ns)
        stated = encode_result(result, self._start.setup.unit, warnings)
        self._add(channels.RESULT, stated, t_ns)

    def _tell_tracking(self, seen: Observation) -> None:
        """Add a message for each robot that was lost or found again in a camera frame."""
        valid = seen.valid.tobytes()
        if valid == self._tracked:
            return
        for name, was, now in zip(self._names, self._tracked, valid, strict=True):
            if was != now:
                level, word = ("info", "tracked again") if now else ("warning", "lost")
                self._say(seen.received_ns, level, f"{name} is {word}")
        self._tracked = valid

    def _end_chunk(self, trial_ns: int) -> None:
        """End the chunk if it has its full length at `trial_ns`, the time of the trial."""
        if trial_ns - self._flushed_ns >= self._chunk_ns:
            self.flush_frames()
            self._sink.flush()
            self._flushed_ns = trial_ns

    def _say(self, t_ns: int, level: str, text: str) -> None:
        self.warnings += level in ("warning", "error")
        self._add(channels.LOG, encode_note(Note(t_ns, level, text), self._start_ns), t_ns)

    def _attach(self, name: str, media_type: str, text: str) -> None:
        self._sink.attachment(name, media_type, self._start_ns, text.encode())

    def _add(
        self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None
    ) -> None:
        sampled_ns = log_ns if publish_ns is None else publish_ns
        self._add_bytes(topic, message.SerializeToString(), log_ns, sampled_ns)

    def _add_bytes(self, topic: str, data: bytes, log_ns: int, publish_ns: int) -> None:
        begin = self._start_ns
        self._sink.messages([Entry(topic, begin + log_ns, begin + publish_ns, data)])
