"""Serves trials to log viewers while they run."""

from tetractl.core.clock import Clock
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.log.write.messages import Messages
from tetractl.serve.live import Viewers


class ServedRun:
    """Sends what a log would hold of one trial after another: an `Observer` of each.

    A simulated trial, which would end before it is seen, is slowed to the pace of `wall`.
    """

    def __init__(self, viewers: Viewers, wall: Clock) -> None:
        self._viewers, self._wall = viewers, wall

    def on_start(self, start: Start) -> None:
        """Send the scene of a new trial; the viewers' time goes to its start."""
        self._messages = Messages(start)
        self._paced = start.plant.simulated
        self._began_ns = self._wall.now()
        self._viewers.jump(start.start_unix_ns, self._messages.start())

    def on_samples(self, samples: list[Sample]) -> None:
        """Send camera frames; while no viewer reads, only the newest, for those that come."""
        for sample in samples if self._viewers.watched else samples[-1:]:
            if self._paced:
                self._wall.sleep_until(self._began_ns + sample.observation.received_ns)
            self._viewers.publish(self._messages.samples([sample]))

    def on_step(self, step: Step) -> None:
        """Send a control step."""
        self._viewers.publish(self._messages.step(step))

    def on_command(self, command: Command) -> None:
        """Send a command."""
        self._viewers.publish([self._messages.command(command)])

    def on_note(self, note: Note) -> None:
        """Send a message for people."""
        self._viewers.publish([self._messages.note(note)])

    def on_stop(self, stop: Command, result: Result) -> None:
        """Send how the trial ended."""
        self._viewers.publish(self._messages.stop(stop, result))
