"""Serves trials to log viewers while they run."""

from tetractl.core.clock import Clock
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.log.write.messages import Messages
from tetractl.serve.server import ViewerServer


class ServedRun:
    """Sends what a log would hold of one trial after another: an `Observer` of each.

    A simulated trial, which would be over before it is seen, is slowed to the pace of `wall`.
    """

    def __init__(self, server: ViewerServer, wall: Clock) -> None:
        self._server, self._wall = server, wall

    def on_start(self, start: Start) -> None:
        """Send the scene of a new trial; the viewers' time goes to its start."""
        self._messages = Messages(start)
        self._paced = start.plant.simulated
        self._began_ns = self._wall.now()
        self._server.jump(start.start_unix_ns, self._messages.start())

    def on_samples(self, samples: list[Sample]) -> None:
        """Send camera frames; while nobody looks, only the newest, for those who come."""
        for sample in samples if self._server.watched else samples[-1:]:
            if self._paced:
                self._wall.sleep_until(self._began_ns + sample.observation.received_ns)
            self._server.publish(self._messages.samples([sample]))

    def on_step(self, step: Step) -> None:
        """Send a control step."""
        self._server.publish(self._messages.step(step))

    def on_command(self, command: Command) -> None:
        """Send a command."""
        self._server.publish([self._messages.command(command)])

    def on_note(self, note: Note) -> None:
        """Send a message for people."""
        self._server.publish([self._messages.note(note)])

    def on_stop(self, stop: Command, result: Result) -> None:
        """Send how the trial ended."""
        self._server.publish(self._messages.stop(stop, result))
