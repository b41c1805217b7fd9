"""Convert the events of a running trial to the messages of its log.

Each call adds these messages, in this order. `channels` explains the topics:

    on_start     /run, /host/machine; attachments: specs, files they name, layout, environment;
                 /scene/static, /log
    on_samples   /log of robots lost and found, /frames with /tf, the camera's own messages
    on_command   /commands
    on_note      /log
    on_step      /controller/step, /commands, /scene/plan, /host/timing, /log of lost commands
    on_stop      /frames with /tf, /commands, /log; in a chunk of their own /host/end, /run, /result

The times of records count from the trial's start [ns], and messages have Unix times [ns]. Camera
frames of a simulation are collected until their chunk ends. Camera frames of a lab are added as
they arrive.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

from google.protobuf.message import Message
from mcap.records import Attachment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.loggable import round_for_drawing
from tetractl.core.poses import Frames, Sample
from tetractl.core.trial import Note, Result, Start, Step
from tetractl.log import provenance
from tetractl.log.format import channels, codec, layout
from tetractl.log.format.channels import Entry, Record
from tetractl.log.format.derived_messages import (
    TrackingNotes,
    end_note,
    start_note,
    undelivered_notes,
)
from tetractl.log.format.run_records import encode_facts, encode_result, encode_run
from tetractl.log.format.scene import Scene, encode_note
from tetractl.log.format.tetractl_pb2 import Host, HostEnd, StepTiming

CHUNK_NS = 2 * SECOND
"""Duration of a chunk of a simulation's log [ns of trial time].

A repeated simulation therefore has the same chunks. If a simulation is slower than real time,
`sink.CHUNK_S` also ends chunks.
"""
LAB_CHUNK_NS = SECOND // 4
"""Duration of a chunk of a lab's log [ns of trial time]. A crash may lose one chunk."""
MESSAGE_POSES_MAX = 20_000
"""Maximum number of poses in a message, which limits its size."""
SHOWN_HZ = 15
"""Rate at which a simulation's poses are written as transforms for viewers [Hz].

Viewers interpolate between transforms.
"""
PLAN_SHOWN_NS = SECOND * 3 // 20
"""Minimum time between two plans that are written for viewers [ns of trial time]."""


class RecordSink(Protocol):
    """A destination for the records of a log, such as a file or a connection to a viewer.

    Chunks have no meaning for most destinations.
    """

    @abstractmethod
    def add(self, record: Record) -> None:
        """Add one record of the log, such as a message or an attachment."""

    def flush(self) -> None:
        """End the present chunk, a block of messages that is written as a whole.

        By default, this does nothing.
        """


class Encoder:
    """An observer that adds the records of one trial to a sink.

    A message has two times [Unix ns]. At log_time, the host received or sent its content. At
    publish_time, the content was sampled.

    Args:
        sink: Receives the records.
        real_time: Whether the trial runs in real time.
        hosted: Whether to add the host records, which differ from run to run.

    Attributes:
        warnings: Number of operator messages that are warnings or errors. The message about the end
            of the trial does not count, because it repeats the outcome.
    """

    def __init__(self, sink: RecordSink, real_time: bool = False, hosted: bool = False) -> None:
        self._sink = sink
        self._real_time = real_time
        self._hosted = hosted
        self._chunk_ns = LAB_CHUNK_NS if real_time else CHUNK_NS
        self._collected_samples: list[Sample] = []  # frames of a simulation's open chunk
        self._flushed_ns = 0  # trial time at which the open chunk began
        self._next_plan_ns = 0  # trial time from which the next plan is shown
        self.warnings = 0

    def on_start(self, start: Start) -> None:
        """Add the start of a trial: its identity, specs, static scene, and a message about it."""
        setup = start.setup
        self._start = start
        self._scene = Scene(setup, exact=not start.plant.simulated)
        self._tracking = TrackingNotes(setup.names)
        # in the lab each frame is a message and is shown by transforms
        self._frames_per_message = 1
        self._frames_per_shown = 1
        if start.plant.simulated:
            self._frames_per_message = max(1, MESSAGE_POSES_MAX // len(setup.names))
            self._frames_per_shown = max(1, round(start.plant.camera_rate_hz / SHOWN_HZ))
        self._add(channels.RUN, encode_run(start), 0)
        if self._hosted:
            facts = provenance.host_facts(start.packages)
            self._add(channels.HOST, Host(facts=encode_facts(facts)), 0)
        self._attach(channels.SPEC, "application/yaml", start.spec_text)
        self._attach(channels.RESOLVED_SPEC, "application/yaml", start.resolved)
        for name, contents in start.attached:
            self._attach(name, "application/yaml", contents)
        self._attach(channels.LAYOUT, layout.MEDIA_TYPE, layout.layout(setup))
        if self._hosted:  # last, for it may be long, and a log cut off here can still be read
            self._attach(channels.ENVIRONMENT, "application/json", provenance.environment())
        self._add(channels.SCENE, self._scene.static(start.start_unix_ns), 0)
        self.on_note(start_note(start))

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Add camera frames. Frames of a simulation are collected until their chunk ends."""
        if not samples:
            return
        for sample in samples:
            for note in self._tracking.add(sample.observation):
                self.on_note(note)
        self._collected_samples += samples
        if self._real_time:
            self.flush_frames()
        start_unix_ns = self._start.start_unix_ns
        for sample in samples:
            received_ns = start_unix_ns + sample.observation.received_ns
            sampled_ns = start_unix_ns + sample.observation.sampled_ns
            for topic, data in sample.messages:
                self._sink.add(Entry(topic, received_ns, sampled_ns, data))
        self._end_chunk(samples[-1].observation.received_ns)

    def flush_frames(self) -> None:
        """Add the collected camera frames to the sink.

        They become few messages for a simulation, and two for each frame of a lab. A message has
        the times of its last frame. Transforms have the times of their first frame, so that a
        viewer that jumps to a time has the transforms before and after it.

        A lab's frames cannot be simulated again. Each is therefore stored twice, as poses and as
        transforms with the same times, so that a change of one copy can be detected.
        """
        if not self._collected_samples:
            return
        frames = Frames.from_samples(self._collected_samples, len(self._start.setup.names))
        self._collected_samples = []
        frames_per_message = self._frames_per_message
        first_rows = range(0, len(frames.numbers), frames_per_message)
        messages = [
            frames.select(slice(first_row, first_row + frames_per_message))
            for first_row in first_rows
        ]
        shown_frames: list[Frames] = []
        for message in messages:
            first_shown_row = (
                len(message.numbers) - 1
            ) % self._frames_per_shown  # so the last one is shown
            shown_frames.append(
                message.select(slice(first_shown_row, None, self._frames_per_shown))
            )
        # for all messages at once, which takes hardly longer than for one frame
        transforms = self._scene.transforms(shown_frames, self._start.start_unix_ns)
        for message, shown, transform in zip(messages, shown_frames, transforms, strict=True):
            last_received_ns = int(message.received_ns[-1])
            last_sampled_ns = int(message.sampled_ns[-1])
            encoded = codec.encode_frames(message)
            self._add(channels.FRAMES, encoded, last_received_ns, last_sampled_ns)
            first_received_ns = int(shown.received_ns[0])
            first_sampled_ns = int(shown.sampled_ns[0])
            self._add(channels.TRANSFORMS, transform, first_received_ns, first_sampled_ns)

    def on_command(self, command: Command) -> None:
        """Add a command that was sent outside the control steps to the log."""
        self._add(channels.COMMANDS, codec.encode_command(command), command.sent_ns)

    def on_note(self, note: Note) -> None:
        """Add an operator message, and count it in `warnings` if it is a warning or an error."""
        if note.level in ("warning", "error"):
            self.warnings += 1
        self._add(channels.LOG, encode_note(note, self._start.start_unix_ns), note.t_ns)

    def on_step(self, step: Step) -> None:
        """Add a control step: decision, command, planned path, solve time and estimate."""
        sampled_ns = step.observation.sampled_ns
        sent_ns = step.command.sent_ns
        command = codec.encode_command(step.command)
        self._add(channels.STEP, codec.encode_step(step, command), sent_ns, sampled_ns)
        self._add(channels.COMMANDS, command, sent_ns)
        if sent_ns >= self._next_plan_ns:
            self._next_plan_ns = sent_ns + PLAN_SHOWN_NS
            path = round_for_drawing(step.plan.path)
            plan = self._scene.plan(path, self._start.start_unix_ns + sent_ns)
            self._add(channels.SCENE_PLAN, plan, sent_ns, sampled_ns)
        timing = StepTiming(k=step.k, solve_ns=step.solve_ns, deadline_missed=step.deadline_missed)
        self._add(channels.HOST_TIMING, timing, sent_ns)
        for note in undelivered_notes(self._start.setup.names, step):
            self.on_note(note)
        self._end_chunk(sent_ns)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Add the stop, the end of the trial, and its result.

        The result is in a chunk of its own. This chunk repeats the record of the run, because a log
        that has lost its first chunk could not be read without it.
        """
        self.flush_frames()
        t_ns = stop.sent_ns
        warnings = self.warnings  # without the message on the end
        self._add(channels.COMMANDS, codec.encode_command(stop), t_ns)
        self.on_note(end_note(stop, result))
        self._sink.flush()
        if self._hosted:
            host_end = HostEnd(
                solve_ns=result.solve_ns,
                deadline_misses=result.deadline_misses,
                ended=provenance.utc_now(),
                drove=result.drove,
            )
            self._add(channels.HOST_END, host_end, t_ns)
        self._add(channels.RUN, encode_run(self._start), t_ns)
        result_message = encode_result(result, self._start.setup.unit, warnings)
        self._add(channels.RESULT, result_message, t_ns)

    def _end_chunk(self, trial_ns: int) -> None:
        """End the chunk if it has its full length at `trial_ns`, the time of the trial."""
        if trial_ns - self._flushed_ns >= self._chunk_ns:
            self.flush_frames()
            self._sink.flush()
            self._flushed_ns = trial_ns

    def _attach(self, name: str, media_type: str, contents: str) -> None:
        start_unix_ns = self._start.start_unix_ns
        self._sink.add(Attachment(0, start_unix_ns, name, media_type, contents.encode()))

    def _add(
        self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None
    ) -> None:
        """Add a message to the log, with times on the trial's clock [ns]."""
        start_unix_ns = self._start.start_unix_ns
        sampled_ns = log_ns if publish_ns is None else publish_ns
        data = message.SerializeToString()
        self._sink.add(Entry(topic, start_unix_ns + log_ns, start_unix_ns + sampled_ns, data))
