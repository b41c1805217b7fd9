"""Operator messages that follow from other records of a trial, and the names of outcomes in logs.

`Outcome.NO_BETTER_PLAN` has its former name in logs, so that the digests of earlier logs stay
valid.
"""

from collections.abc import Sequence

from tetractl.core.commands import Command
from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation
from tetractl.core.trial import Note, Result, Start, Step

_NO_BETTER_PLAN = "nothing better"


def outcome_to_log(text: str) -> str:
    """Replace an outcome at the beginning of a text by its name in logs."""
    if text.startswith(Outcome.NO_BETTER_PLAN):
        return _NO_BETTER_PLAN + text.removeprefix(Outcome.NO_BETTER_PLAN)
    return text


def outcome_from_log(text: str) -> str:
    """Replace an outcome's name in logs at the beginning of a text by its present name."""
    if text.startswith(_NO_BETTER_PLAN):
        return Outcome.NO_BETTER_PLAN + text.removeprefix(_NO_BETTER_PLAN)
    return text


def start_note(start: Start) -> Note:
    """Create the message in the log that a trial starts, with its number and its setup."""
    return Note(0, "info", f"trial {start.trial} of {start.setup.name} starts")


class TrackingNotes:
    """Collects messages on robots that are lost or found again, from one camera frame to the next.

    Args:
        names: Names of the robots. At first, all of them count as tracked.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._tracked = b"\1" * len(names)

    def add(self, observation: Observation) -> list[Note]:
        """Add the next frame, and return a message for each robot that it loses or finds again."""
        previously_tracked = self._tracked
        self._tracked = observation.valid.tobytes()
        if self._tracked == previously_tracked:
            return []
        notes: list[Note] = []
        for name, was_tracked, is_tracked in zip(
            self._names, previously_tracked, self._tracked, strict=True
        ):
            if is_tracked and not was_tracked:
                notes.append(Note(observation.received_ns, "info", f"{name} is tracked again"))
            elif was_tracked and not is_tracked:
                notes.append(Note(observation.received_ns, "warning", f"{name} is lost"))
        return notes


def undelivered_notes(names: Sequence[str], step: Step) -> list[Note]:
    """Create a warning for each robot that did not receive the command of a step."""
    command = step.command
    return [
        Note(command.sent_ns, "warning", f"{name} did not get the command of step {step.k}")
        for name, delivered in zip(names, command.delivered, strict=True)
        if not delivered
    ]


def end_note(stop: Command, result: Result) -> Note:
    """Create the message in the log that states how a trial ended.

    Its level is "error" if the trial was aborted, and "info" otherwise.
    """
    level = "error" if result.outcome is Outcome.ABORTED else "info"
    return Note(stop.sent_ns, level, outcome_to_log(result.summary))
