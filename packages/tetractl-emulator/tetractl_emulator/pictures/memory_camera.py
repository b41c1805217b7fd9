"""A network camera in memory: gives our program the parts of a picture stream in virtual time.

They are the parts that `network_camera` would send over HTTP, and our side takes them apart as it
does those. Pictures are exposed in true time, and wait on the wire while our process stands still.
"""

from collections import deque
from collections.abc import Callable
from typing import Self

from tetractl_microscope.pictures.multipart import Multipart

from tetractl_emulator.pictures.network_camera import (
    BOUNDARY,
    WAITING_MAX,
    DuePart,
    PictureStream,
    url_at,
)
from tetractl_emulator.virtual_lab import LabClock


class MemoryCamera:
    """A camera on a LabClock that shows a stream of images in memory; a context manager.

    It is also the `Feed` of the program that watches it, which `join` returns. While no program
    watches, before `join` and after `interrupt`, nothing is drawn. If more than `WAITING_MAX`
    images are on the wire, the oldest are lost.

    Args:
        stream: The images.
        clock: The clock for times.
        port: The spec's port, which is not opened.
        shown: Called with the time of an exposure [ns] when its image arrives undamaged.
    """

    live = emulated = True
    rate_hz: float | None = None

    def __init__(
        self, stream: PictureStream, clock: LabClock, port: int, shown: Callable[[int], None]
    ) -> None:
        self.port = port
        self.url = url_at(port)
        self._stream = stream
        self._clock = clock
        self._shown = shown
        self._start_ns = 0  # when the camera was entered
        self._next = 0  # number of the next picture
        self._wire = deque[DuePart](maxlen=WAITING_MAX)
        self._parts = Multipart(BOUNDARY)
        self._take: Callable[[bytes], None] | None = None  # None while no program watches

    def __enter__(self) -> Self:
        self._start_ns = self._clock.true_ns
        self._clock.steps.append(self._step)
        return self

    def __exit__(self, *_: object) -> None:
        self._clock.steps.remove(self._step)

    @property
    def watched(self) -> bool:
        """Whether a program watches the camera."""
        return self._take is not None

    @property
    def damaged(self) -> int:
        """Number of parts that could not be read, since the last `join`."""
        return self._parts.damaged

    def join(self, take: Callable[[bytes], None]) -> Self:
        """Pass each picture, a JPEG file, to `take` from now on; return the feed."""
        self._take = take
        self._parts = Multipart(BOUNDARY)
        return self

    def interrupt(self) -> None:
        """Pass on no further pictures."""
        self._take = None

    def _step(self) -> None:
        now_ns = self._clock.true_ns
        self._expose(now_ns)
        while self._wire and self._wire[0].due_ns <= now_ns:
            self._deliver(self._wire.popleft())

    def _expose(self, now_ns: int) -> None:
        """Put the next picture on the wire, if its exposure has ended."""
        stream = self._stream
        exposed_ns = self._start_ns + stream.middle_ns(self._next)
        if now_ns < exposed_ns + stream.half_ns:
            return
        self._next += 1
        if self.watched and not stream.withholds(self._next):
            self._wire.append(stream.drawn_part(exposed_ns))

    def _deliver(self, due: DuePart) -> None:
        """Pass a part to the program that watches, changed by the present faults."""
        sent = self._stream.send(due.drawn)
        if self._take is None:
            return
        if sent.startswith(due.drawn):
            self._shown(due.exposed_ns)
        for jpeg in self._parts.feed(sent):
            self._take(jpeg)
