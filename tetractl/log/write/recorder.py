"""A trial kept in memory: a writer without a file."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.poses import Floats, Poses
from tetractl.core.text import printable
from tetractl.core.trial import Result, Start, Step, TrialRecords
from tetractl.log.format.channels import TEXT
from tetractl.log.format.trial_digest import trial_digest
from tetractl.log.write.notes import Notes


class Recorder:
    """Keeps the records of one trial as its log gives them back."""

    result: Result | None = None

    def on_start(self, start: Start) -> None:
        """Keep what is known before the first step."""
        self.start, self._messages = start, Notes(start)
        self._samples: list[Sample] = []
        self._commands: list[Command] = []
        self._steps: list[Step] = []
        self._notes = [self._messages.started()]

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Keep camera frames."""
        self._samples += samples
        for sample in samples:
            self._notes += self._messages.tracking(sample.observation)

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
        seen = [sample.observation for sample in self._samples]
        times = [(one.frame, one.sampled_ns, one.received_ns) for one in seen]
        frames, mocap_ns, received_ns = np.array(times, dtype=np.int64).reshape(-1, 3).T
        robots = len(self.start.setup.names)
        true = [sample.truth for sample in self._samples if sample.truth is not None]
        return TrialRecords(
            start=self.start,
            frames=frames,
            mocap_ns=mocap_ns,
            received_ns=received_ns,
            mocap=_array([one.poses for one in seen], robots),
            valid=np.array([one.valid for one in seen], dtype=np.bool_).reshape(-1, robots),
            truth=_array(true, robots) if len(true) == len(seen) else None,
            commands=tuple(self._commands),
            steps=tuple(self._steps),
            notes=tuple(replace(one, text=printable(one.text, TEXT)) for one in self._notes),
            result=self.result,
        )

    @property
    def trial_digest(self) -> str:
        """The digest of the trial."""
        return trial_digest(self.trial)

    @property
    def warnings(self) -> int:
        """The number of operator messages that are warnings or errors."""
        return self._messages.warnings


def _array(poses: Sequence[Poses], robots: int) -> Floats:
    """Return poses at M times as (M, N, 3)."""
    columns = [(one.x, one.y, one.heading) for one in poses]
    return np.array(columns, dtype=np.float64).reshape(-1, 3, robots).transpose(0, 2, 1)
