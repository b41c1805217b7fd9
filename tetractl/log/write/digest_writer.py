"""A writer without a file: of a trial it keeps the digest, and the number of warnings."""

from collections.abc import Sequence

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format.trial_digest import TrialDigest
from tetractl.log.write.notes import Notes


class DigestWriter:
    """Computes the digest of one trial; `trial_digest` is "" until `on_stop`."""

    trial_digest = ""

    def on_start(self, start: Start) -> None:
        """Add what is known before the first step."""
        self._trial, self._notes = TrialDigest(start), Notes(start)
        self._trial.note(self._notes.started())

    def on_samples(self, samples: list[Sample]) -> None:
        """Add camera frames."""
        self._trial.samples(samples)
        for sample in samples:
            self._said(self._notes.tracking(sample.observation))

    def on_command(self, command: Command) -> None:
        """Add a command sent outside the control steps."""
        self._trial.command(command)

    def on_note(self, note: Note) -> None:
        """Add a message for people."""
        self._trial.note(self._notes.told(note))

    def on_step(self, step: Step) -> None:
        """Add a control step."""
        self._trial.step(step)
        self._trial.command(step.command)
        self._said(self._notes.undelivered(step))

    def on_stop(self, stop: Command, result: Result) -> None:
        """Add the stop and the result."""
        self._trial.command(stop)
        self._trial.note(self._notes.ended(stop, result))
        self.trial_digest = self._trial.hexdigest(result)

    @property
    def warnings(self) -> int:
        """The number of messages for people that warn or tell of an error."""
        return self._notes.warnings

    def _said(self, notes: Sequence[Note]) -> None:
        for note in notes:
            self._trial.note(note)
