"""The messages of a trial: its records, encoded, with topics and times."""

from google.protobuf.message import Message

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format import channels, codec
from tetractl.log.format.channels import Entry
from tetractl.log.format.scene import Scene, encode_note
from tetractl.log.format.tetractl_pb2 import MocapSample, Truth
from tetractl.log.write.notes import Notes


class Messages:
    """Encodes the records of one trial, in their order; each method returns what it made of them.

    A message has two times [Unix ns]: log_time, when the host received or sent it, and
    publish_time, when its content was sampled.
    """

    def __init__(self, start: Start) -> None:
        self._start_ns, self._notes = start.start_unix_ns, Notes(start)
        self._scene = Scene(start.setup)
        self._mocap, self._truth = MocapSample(), Truth()  # filled anew for each frame

    @property
    def warnings(self) -> int:
        """The number of warnings and errors for people so far."""
        return self._notes.warnings

    def start(self) -> list[Entry]:
        """Return the scene that stays, and that the trial starts."""
        return [
            self._entry(channels.SCENE, self._scene.static(self._start_ns), 0),
            self._said(self._notes.started()),
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
            made += map(self._said, self._notes.tracking(seen))
        return made

    def command(self, command: Command) -> Entry:
        """Return a command."""
        return self._entry(channels.COMMANDS, codec.encode_command(command), command.sent_ns)

    def note(self, note: Note) -> Entry:
        """Return a message for people."""
        return self._said(self._notes.told(note))

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
        made += map(self._said, self._notes.undelivered(step))
        return made

    def stop(self, stop: Command, result: Result) -> list[Entry]:
        """Return the stop and how the trial ended."""
        return [self.command(stop), self._said(self._notes.ended(stop, result))]

    def _said(self, note: Note) -> Entry:
        return self._entry(channels.LOG, encode_note(note, self._start_ns), note.t_ns)

    def _entry(
        self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None
    ) -> Entry:
        log_unix = self._start_ns + log_ns
        publish_unix = log_unix if publish_ns is None else self._start_ns + publish_ns
        return Entry(topic, log_unix, publish_unix, message.SerializeToString())
