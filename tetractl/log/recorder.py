"""Keep a trial in memory, with the same contents as its log has when it is read."""

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from tetractl.core.commands import Command
from tetractl.core.poses import PICTURE_TOPIC, Frames, Sample
from tetractl.core.protocols import Observer
from tetractl.core.trial import Note, Result, Start, Step
from tetractl.log.format.derived_messages import (
    TrackingNotes,
    end_note,
    start_note,
    undelivered_notes,
)
from tetractl.log.read.trial_log import TrialLog
from tetractl.spec.load import parse_resolved


class TrialRecorder(Observer):
    """An observer that keeps one trial in memory.

    `trial_log` returns what `read_trial` returns for the log of the same trial, with these
    differences: the true poses and the predicted paths are not rounded, there is no `digest`, and
    there are no `facts` about the computer.
    """

    def __init__(self) -> None:
        self._samples: list[Sample] = []
        self._commands: list[Command] = []
        self._steps: list[Step] = []
        self._notes: list[Note] = []
        self._result: Result | None = None

    def on_start(self, start: Start) -> None:
        """Store the start of the trial, and a message about it."""
        self._start = start
        self._tracking = TrackingNotes(start.setup.names)
        self._notes.append(start_note(start))

    def on_samples(self, samples: list[Sample]) -> None:
        """Store camera frames, and messages about robots that they lose or find again."""
        self._samples += samples
        for sample in samples:
            self._notes += self._tracking.add(sample.observation)

    def on_command(self, command: Command) -> None:
        """Store a command that was sent outside the control steps."""
        self._commands.append(command)

    def on_note(self, note: Note) -> None:
        """Store a message to the operator."""
        self._notes.append(note)

    def on_step(self, step: Step) -> None:
        """Store a control step and its command, with warnings about undelivered commands."""
        self._steps.append(step)
        self._commands.append(step.command)
        self._notes += undelivered_notes(self._start.setup.names, step)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the stop and the result, and a message about the end of the trial."""
        self._commands.append(stop)
        self._notes.append(end_note(stop, result))
        self._result = result

    def trial_log(self, name: str) -> TrialLog:
        """Return the trial, which must have started.

        Args:
            name: Name of the trial, instead of the path of a log.
        """
        start = self._start
        spec = parse_resolved(start.resolved, start.spec_name)  # a plant may have chosen its robots
        frames = Frames.from_samples(self._samples, len(start.setup.names))
        stops = [command for command in self._commands if command.stops]
        return TrialLog(
            log=name,
            experiment=spec.experiment,
            start=start,
            mocap_ns=frames.sampled_ns,
            mocap=frames.poses,
            valid=frames.valid,
            truth=frames.truth if start.plant.simulated else None,
            steps=tuple(self._steps),
            stop=stops[-1] if stops else None,
            result=self._result,
            damage=None,
            facts={},
            frames=frames.numbers,
            received_ns=frames.received_ns,
            exposed_ns=frames.exposed_ns,
            commands=tuple(self._commands),
            notes=tuple(self._notes),
            pictures=tuple(
                (sample.observation.sampled_ns, CompressedImage.FromString(data).data)
                for sample in self._samples
                for topic, data in sample.messages
                if topic == PICTURE_TOPIC
            ),
        )
