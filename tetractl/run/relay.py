"""An observer called from a background thread, so that a slow screen never delays the loop."""

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.errors import TetractlError
from tetractl.core.protocols import Observer
from tetractl.core.trial import Result, Start, Step
from tetractl.core.worker import Worker

SIZE = 2000  # calls that may wait: over two minutes of a trial
PATIENCE_S = 30.0  # for the last of them, after the robots were stopped


class Relay:
    """Queues every call for `observer`, in order, until it is closed.

    An exception of the observer, or a queue that is full, is raised by the next call; calls after
    that are dropped.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._worker = Worker(
            "observer",
            size=SIZE,
            wait_s=0.0,
            patience_s=PATIENCE_S,
            too_slow=TetractlError("an observer is too slow for the trial"),
        )

    def close(self) -> None:
        """Do the calls in the queue, and end the thread."""
        self._worker.close()

    def on_start(self, start: Start) -> None:
        """Call the observer at once: nothing moves yet."""
        self._observer.on_start(start)

    def on_samples(self, samples: list[Sample]) -> None:
        """Queue the call."""
        self._worker.put(self._observer.on_samples, samples)

    def on_step(self, step: Step) -> None:
        """Queue the call."""
        self._worker.put(self._observer.on_step, step)

    def on_command(self, command: Command) -> None:
        """Queue the call."""
        self._worker.put(self._observer.on_command, command)

    def on_note(self, note: Note) -> None:
        """Queue the call."""
        self._worker.put(self._observer.on_note, note)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Queue the call, and wait until all calls are done."""
        self._worker.put(self._observer.on_stop, stop, result)
        self._worker.drain()
