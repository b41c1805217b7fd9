"""The messages for people in a trial: those of its plant, and those that its records call for."""

from collections.abc import Sequence

from tetractl.core.commands import Command, Note
from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation
from tetractl.core.trial import Result, Start, Step


class Notes:
    """Makes the messages for people of one trial, in the order of its records.

    `warnings` counts the warnings and errors; the end of the trial is told by its outcome, and does
    not count.
    """

    def __init__(self, start: Start) -> None:
        self._start, self._names = start, start.setup.names
        self._tracked = [True] * len(self._names)
        self.warnings = 0

    def started(self) -> Note:
        """Return that the trial starts."""
        return Note(0, "info", f"trial {self._start.trial} of {self._start.setup.name} starts")

    def told(self, note: Note) -> Note:
        """Return a message of the plant, counted."""
        self.warnings += note.level in ("warning", "error")
        return note

    def tracking(self, seen: Observation) -> Sequence[Note]:
        """Return a message for each robot that was lost, or found again, in a camera frame."""
        valid = seen.valid.tolist()
        if valid == self._tracked:
            return ()
        made = []
        for name, was, now in zip(self._names, self._tracked, valid, strict=True):
            if was != now:
                level, word = ("info", "tracked again") if now else ("warning", "lost")
                made.append(self.told(Note(seen.received_ns, level, f"{name} is {word}")))
        self._tracked = valid
        return made

    def undelivered(self, step: Step) -> Sequence[Note]:
        """Return a message for each robot that did not get the command of a control step."""
        if all(step.command.delivered):
            return ()
        return [
            self.told(
                Note(
                    step.command.sent_ns,
                    "warning",
                    f"{name} did not get the command of step {step.k}",
                )
            )
            for name, delivered in zip(self._names, step.command.delivered, strict=True)
            if not delivered
        ]

    def ended(self, stop: Command, result: Result) -> Note:
        """Return how the trial ended."""
        level = "error" if result.outcome is Outcome.ABORTED else "info"
        return Note(stop.sent_ns, level, result.summary)
