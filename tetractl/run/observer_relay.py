"""Call an observer that may be slow in a thread of its own, so that it never delays a trial."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager

from tetractl.core.commands import Command
from tetractl.core.errors import TetractlError
from tetractl.core.protocols import Observer
from tetractl.core.trial import Result, Start
from tetractl.tools.worker import Relay, Worker

QUEUED_CALLS_MAX = 2000
"""Maximum number of queued calls of an observer: more than two minutes of a trial."""
LAST_CALLS_S = 30.0
"""Maximum time for an observer's last calls after the robots were stopped [s]."""


class ObserverRelay(Relay):
    """Passes calls to an observer that may be slow, in a thread of its own.

    If the observer has raised an exception, or if the queue is full, the next call raises an
    exception, and later calls are dropped.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._worker = Worker(
            "observer",
            size=QUEUED_CALLS_MAX,
            wait_s=0.0,
            patience_s=LAST_CALLS_S,
            too_slow=TetractlError("an observer takes too long for the trial"),
        )

    def put(self, call: Callable[[Observer], object]) -> None:
        """Queue a call of the observer, which its own thread makes."""
        self._worker.put(call, self._observer)

    def on_start(self, start: Start) -> None:
        """Pass the start to the observer directly, since no robot moves yet."""
        self._observer.on_start(start)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Queue the stop and the result, and wait until the observer has received everything."""
        super().on_stop(stop, result)
        self._worker.drain()

    def close(self) -> None:
        """Make all calls of observers that are still queued, and end the thread."""
        self._worker.close()


@contextmanager
def relayed(observers: Sequence[Observer], real_time: bool) -> Iterator[Sequence[Observer]]:
    """Yield observers that can be called without delaying a trial in real time.

    Args:
        observers: The observers.
        real_time: Whether the trial runs in real time. If not, the observers themselves are
            yielded, and a simulation waits for them.
    """
    if not real_time:
        yield observers
        return
    with ExitStack() as relays:
        yield [relays.enter_context(closing(ObserverRelay(observer))) for observer in observers]
