"""A network camera in memory, in virtual time."""

from collections import deque
from collections.abc import Callable
from typing import Self

from tetractl_microscope.pictures.multipart import Multipart

from tetractl_emulator.pictures.network_camera import BOUNDARY, EmulatedNetworkCamera, coded, part
from tetractl_emulator.virtual_wires import LabClock

WAIT = 32  # pictures that wait on the wire; further ones push out the oldest


class MemoryCamera(EmulatedNetworkCamera):
    """A network camera without threads and sockets, and the `Feed` of the program that watches it.

    Pictures travel as JPEG parts, as over HTTP; they are exposed in true time, and wait on the wire
    while our side stands still. `on_shown(exposed_ns)` is called when one arrives undamaged.
    """

    live = emulated = True
    rate_hz: float | None = None
    _take: Callable[[bytes], None] | None = None
    _clock: LabClock
    on_shown: Callable[[int], None] = staticmethod(lambda exposed_ns: None)

    def _open(self, port: int) -> None:
        self._port = port  # not opened

    def __enter__(self) -> Self:
        self._start = self._clock.true_ns
        self._number = 0  # of the next picture
        self._sent = deque[tuple[int, int, bytes]](maxlen=WAIT)
        self._clock.steps.append(self._turn)
        return self

    def __exit__(self, *_: object) -> None:
        self._clock.steps.remove(self._turn)

    @property
    def port(self) -> int:
        """The port in the spec."""
        return self._port

    @property
    def watched(self) -> bool:
        """Whether a program watches the camera."""
        return self._take is not None

    @property
    def damaged(self) -> int:
        """Number of parts that could not be read."""
        return self._parts.damaged

    def join(self, take: Callable[[bytes], None]) -> Self:
        """Pass each picture, a JPEG file, to `take` from now on; return the feed."""
        self._take = take
        self._parts = Multipart(BOUNDARY)
        return self

    def interrupt(self) -> None:
        """Pass on no further pictures."""
        self._take = None

    def _turn(self) -> None:
        now = self._clock.true_ns
        exposed = self._start + self.timing.middle_ns(self._number)
        if now >= exposed + self.timing.half_ns:
            self._number += 1
            if self.watched and not self.withholds(self._number):
                jpeg = coded(self._draw(exposed))
                self._sent.append((exposed + self._latency_ns, exposed, jpeg))
        while self._sent and self._sent[0][0] <= now:
            _, exposed, jpeg = self._sent.popleft()
            sent_part = part(jpeg)
            body = self.changed(sent_part)
            if self._take is not None:
                if body.startswith(sent_part):
                    self.on_shown(exposed)
                for jpeg in self._parts.feed(body):
                    self._take(jpeg)
