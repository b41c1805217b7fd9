"""Encodes the records of a trial as messages with topics and times."""

from collections.abc import Sequence

import numpy as np
from google.protobuf.message import Message

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.plan import Outcome
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format import channels, codec
from tetractl.log.format.channels import Entry
from tetractl.log.format.codec import Frames
from tetractl.log.format.crop_images import encode_film
from tetractl.log.format.run_records import encode_result, encode_run
from tetractl.log.format.scene import Scene, encode_note

POSES_MAX = 20_000
"""Largest number of poses in a message, which bounds its size."""
SHOWN_HZ = 30
"""Rate of a simulation's transforms for viewers [Hz]; viewers interpolate between transforms.
"""


class Messages:
    """Encodes the records of one trial in their order; each method returns a record's messages.

    A message has two times [Unix ns]: log_time, when the host received or sent it, and
    publish_time, when its content was sampled. `warnings` counts the operator messages that are
    warnings or errors, except the message on the end of the trial, which repeats the outcome.
    """

    def __init__(self, start: Start) -> None:
        self._start, self._start_ns = start, start.start_unix_ns
        self._names = start.setup.names
        self._scene, self._robots = Scene(start.setup), len(self._names)
        # which robots were tracked in the last frame
        self._tracked = np.ones(self._robots, dtype=np.bool_)
        self.warnings = 0
        self._every, self._most = 1, 1
        if start.plant.simulated:
            self._every = max(1, round(start.plant.camera_rate_hz / SHOWN_HZ))
            self._most = max(1, POSES_MAX // self._robots)

    def start(self) -> list[Entry]:
        """Return the messages for what identifies the trial, its static scene and its start."""
        return [
            self._entry(channels.RUN, encode_run(self._start), 0),
            self._entry(channels.SCENE, self._scene.static(self._start_ns), 0),
            self._said(0, "info", f"trial {self._start.trial} of {self._start.setup.name} starts"),
        ]

    def samples(self, samples: Sequence[Sample]) -> list[Entry]:
        """Return the messages for camera frames, including operator messages about tracking."""
        frames = Frames.of(samples, self._robots)
        films = (entry for sample in samples for entry in self.film(sample))
        return [*self.tracking(frames), *self.frames(frames), *films]

    def tracking(self, frames: Frames) -> list[Entry]:
        """Return a message for each robot that was lost or found again in camera frames."""
        valid, made = frames.valid, list[Entry]()
        if valid.all() and self._tracked.all():
            return made
        for i in np.flatnonzero((valid != np.vstack([self._tracked, valid])[:-1]).any(axis=1)):
            t_ns = int(frames.received_ns[i])
            for name, was, now in zip(self._names, self._tracked, valid[i], strict=True):
                if was != now:
                    level, word = ("info", "tracked again") if now else ("warning", "lost")
                    made.append(self._said(t_ns, level, f"{name} is {word}"))
            self._tracked = valid[i]
        return made

    def frames(self, frames: Frames) -> list[Entry]:
        """Return the messages for camera frames: few for a simulation, two per frame for a lab.

        A lab's frames cannot be simulated again. Each is therefore stored twice, as poses and as
        transforms with the same times, so that a change of one copy can be detected.
        """
        made = list[Entry]()
        for begin in range(0, len(frames.numbers), self._most):
            made += self.block(frames.part(slice(begin, begin + self._most)))
        return made

    def film(self, sample: Sample) -> list[Entry]:
        """Return the messages of the microscope's picture in a camera frame; none if there is no
        picture.
        """
        if sample.film is None:
            return []
        seen = sample.observation
        made = encode_film(sample.film, seen, self._start_ns)
        times = seen.received_ns, seen.sampled_ns
        return [self._entry(topic, message, *times) for topic, message in made.items()]

    def block(self, frames: Frames) -> list[Entry]:
        """Return the message of one or more camera frames, and their transforms for viewers.

        The transforms have the time of their first frame, so that a viewer that jumps to a time has
        the transforms before and after it.
        """
        shown = frames.part(slice((len(frames.numbers) - 1) % self._every, None, self._every))
        last, first = (
            (int(one.received_ns[i]), int(one.sampled_ns[i]))
            for one, i in ((frames, -1), (shown, 0))
        )
        return [
            self._entry(channels.FRAMES, codec.encode_frames(frames), *last),
            self._entry(channels.TRANSFORMS, self._scene.transforms(shown, self._start_ns), *first),
        ]

    def command(self, command: Command) -> Entry:
        """Return the message for a command."""
        return self._entry(channels.COMMANDS, codec.encode_command(command), command.sent_ns)

    def note(self, note: Note) -> Entry:
        """Return the message for an operator note."""
        return self._said(note.t_ns, note.level, note.text)

    def step(self, step: Step) -> list[Entry]:
        """Return the messages for a control step: decision, command, planned path, solve time and
        estimate.
        """
        path, sent_ns = step.plan.path, step.command.sent_ns
        sampled_ns, unix_ns = step.observation.sampled_ns, self._start_ns + sent_ns
        plan = self._scene.plan(path, unix_ns)
        made = [
            self._entry(channels.STEP, codec.encode_step(step), sent_ns, sampled_ns),
            self.command(step.command),
            self._entry(channels.SCENE_PLAN, plan, sent_ns, sampled_ns),
            self._entry(channels.HOST_TIMING, codec.encode_timing(step), sent_ns),
        ]
        if step.plan.estimate is not None:
            estimate = codec.encode_estimate(step.k, step.plan.estimate)
            made.append(self._entry(channels.ESTIMATE, estimate, sent_ns, sampled_ns))
        made += (
            self._said(sent_ns, "warning", f"{name} did not get the command of step {step.k}")
            for name, delivered in zip(self._names, step.command.delivered, strict=True)
            if not delivered
        )
        return made

    def stop(self, stop: Command, result: Result) -> list[Entry]:
        """Return the messages for the stop and the end, then for the run again, without which a log
        whose first chunk is lost could not be read, and its result.
        """
        t_ns, warnings = stop.sent_ns, self.warnings
        level = "error" if result.outcome is Outcome.ABORTED else "info"
        ended = self._said(t_ns, level, result.summary)
        stated = encode_result(result, self._start.setup.unit, warnings)
        return [
            self.command(stop),
            ended,
            self._entry(channels.RUN, encode_run(self._start), t_ns),
            self._entry(channels.RESULT, stated, t_ns),
        ]

    def _said(self, t_ns: int, level: str, text: str) -> Entry:
        self.warnings += level in ("warning", "error")
        note = encode_note(Note(t_ns, level, text), self._start_ns)
        return self._entry(channels.LOG, note, t_ns)

    def _entry(
        self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None
    ) -> Entry:
        publish_unix = None if publish_ns is None else self._start_ns + publish_ns
        return Entry.of(topic, message, self._start_ns + log_ns, publish_unix)
