"""The messages of a trial: its records, encoded, with topics and times."""

from google.protobuf.message import Message

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.plan import Outcome
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format import channels, codec
from tetractl.log.format.channels import Entry
from tetractl.log.format.scene import Scene, encode_note
from tetractl.log.format.tetractl_pb2 import MocapSample, Truth


class Messages:
    """Encodes the records of one trial, in their order; each method returns what it made of them.

    A message has two times [Unix ns]: log_time, when the host received or sent it, and
    publish_time, when its content was sampled. `warnings` counts the warnings and errors for
    people; the end of the trial is told by its outcome, and does not count.
    """

    def __init__(self, start: Start) -> None:
        self._start = start
        self._start_ns = start.start_unix_ns
        self._scene = Scene(start.setup)
        self._mocap, self._truth = MocapSample(), Truth()  # filled anew for each frame
        self._tracked = [True] * len(start.setup.names)
        self.warnings = 0

    def start(self) -> list[Entry]:
        """Return the scene that stays, and that the trial starts."""
        trial, setup = self._start.trial, self._start.setup
        return [
            self._entry(channels.SCENE, self._scene.static(self._start_ns), 0),
            self.note(Note(0, "info", f"trial {trial} of {setup.name} starts")),
        ]

    def samples(self, samples: list[Sample]) -> list[Entry]:
        """Return camera frames: measured, as transforms, and true where known."""
        made = []
        for sample in samples:
            seen = sample.observation
            log_ns, sampled_ns = self._start_ns + seen.received_ns, self._start_ns + seen.sampled_ns
            mocap = codec.encode_observation(seen, self._mocap).SerializeToString()
            made.append(Entry(channels.MOCAP, log_ns, sampled_ns, mocap))
            if sample.truth is not None:
                truth = codec.encode_truth(seen, sample.truth, self._truth).SerializeToString()
                made.append(Entry(channels.TRUTH, log_ns, sampled_ns, truth))
            transforms = self._scene.transforms(seen, sampled_ns).SerializeToString()
            made.append(Entry(channels.TRANSFORMS, log_ns, sampled_ns, transforms))
            made += self._tracking(seen.valid.tolist(), seen.received_ns)
        return made

    def command(self, command: Command) -> Entry:
        """Return a command."""
        return self._entry(channels.COMMANDS, codec.encode_command(command), command.sent_ns)

    def note(self, note: Note) -> Entry:
        """Return a message for people."""
        self.warnings += note.level in ("warning", "error")
        return self._entry(channels.LOG, encode_note(note, self._start_ns), note.t_ns)

    def step(self, step: Step) -> list[Entry]:
        """Return a control step: decision, command, planned path, time of solving and estimate."""
        path, sent_ns = step.plan.path, step.command.sent_ns
        sampled_ns, unix_ns = step.observation.sampled_ns, self._start_ns + sent_ns
        poses, lines = self._scene.plan_poses(path, unix_ns), self._scene.plan_lines(path, unix_ns)
        made = [
            self._entry(channels.STEP, codec.encode_step(step), sent_ns, sampled_ns),
            self.command(step.command),
            self._entry(channels.PLAN, poses, sent_ns, sampled_ns),
            self._entry(channels.SCENE_PLAN, lines, sent_ns, sampled_ns),
            self._entry(channels.HOST_TIMING, codec.encode_timing(step), sent_ns),
        ]
        if step.plan.estimate is not None:
            estimate = codec.encode_estimate(step.k, step.plan.estimate)
            made.append(self._entry(channels.ESTIMATE, estimate, sent_ns, sampled_ns))
        for name, delivered in zip(self._start.setup.names, step.command.delivered, strict=True):
            if not delivered:
                text = f"{name} did not get the command of step {step.k}"
                made.append(self.note(Note(sent_ns, "warning", text)))
        return made

    def stop(self, stop: Command, result: Result) -> list[Entry]:
        """Return the stop and how the trial ended."""
        level = "error" if result.outcome is Outcome.ABORTED else "info"
        warnings = self.warnings
        made = [self.command(stop), self.note(Note(stop.sent_ns, level, result.summary))]
        self.warnings = warnings
        return made

    def _entry(
        self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None
    ) -> Entry:
        log_unix = self._start_ns + log_ns
        publish_unix = log_unix if publish_ns is None else self._start_ns + publish_ns
        return Entry(topic, log_unix, publish_unix, message.SerializeToString())

    def _tracking(self, valid: list[bool], log_ns: int) -> list[Entry]:
        """Return a note for each robot that was lost or found again."""
        if valid == self._tracked:
            return []
        made = []
        for name, was, now in zip(self._start.setup.names, self._tracked, valid, strict=True):
            if was != now:
                level, word = ("info", "tracked again") if now else ("warning", "lost")
                made.append(self.note(Note(log_ns, level, f"{name} is {word}")))
        self._tracked = valid
        return made
