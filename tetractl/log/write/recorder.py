"""An observer that keeps a trial in memory."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.errors import printable
from tetractl.core.trial import Result, Start, Step, TrialRecords
from tetractl.log.format.channels import TEXT
from tetractl.log.format.codec import Frames
from tetractl.log.format.trial_digest import trial_digest
from tetractl.log.write.messages import Notes


class Recorder:
    """Keeps the records of one trial; `trial` returns them like a trial read from its log."""

    result: Result | None = None

    def on_start(self, start: Start) -> None:
        """Keep the start of the trial."""
        self.start, self._messages = start, Notes(start)
        self._samples: list[Sample] = []
        self._commands: list[Command] = []
        self._steps: list[Step] = []
        self._notes = [self._messages.started()]

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Keep camera frames."""
        self._samples += samples
        frames = Frames.of(samples, len(self.start.setup.names))
        self._notes += self._messages.tracking(frames)

    def on_command(self, command: Command) -> None:
        """Keep a command sent outside the control steps."""
        self._commands.append(command)

    def on_note(self, note: Note) -> None:
        """Keep an operator message."""
        self._notes.append(self._messages.told(note))

    def on_step(self, step: Step) -> None:
        """Keep a control step."""
        self._steps.append(step)
        self._commands.append(step.command)
        self._notes += self._messages.undelivered(step)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Keep the stop and the result."""
        self._commands.append(stop)
        self._notes.append(self._messages.ended(stop, result))
        self.result = result

    @cached_property
    def trial(self) -> TrialRecords:
        """The whole trial, once it has ended."""
        frames = Frames.of(self._samples, len(self.start.setup.names))
        return TrialRecords(
            start=self.start,
            frames=frames.numbers,
            mocap_ns=frames.sampled_ns,
            received_ns=frames.received_ns,
            mocap=frames.poses,
            valid=frames.valid,
            truth=frames.truth,
            commands=tuple(self._commands),
            steps=tuple(self._steps),
            notes=tuple(replace(one, text=printable(one.text, TEXT)) for one in self._notes),
            result=self.result,
        )

    @property
    def trial_digest(self) -> str:
        """The trial digest of the recorded trial."""
        return trial_digest(self.trial)

    @property
    def warnings(self) -> int:
        """The number of operator messages that are warnings or errors."""
        return self._messages.warnings
