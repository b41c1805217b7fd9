"""An emulated network camera in memory, which passes images to our program in virtual time.

The images have the same form as those that `network_camera` sends over HTTP, and our program
decodes them in the same way. Images are exposed in true time. They wait in a queue while a fault
suspends our process.
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
    """An emulated network camera on a `LabClock`; a context manager.

    The camera is also the `Feed` that its reader gets from `join`. While no program reads, nothing
    is drawn. If more than WAITING_MAX images wait, the oldest images are lost.

    Args:
        stream: The images.
        clock: The clock.
        port: The port in the spec, for display. It is not opened.
        shown: Called with the exposure time [ns] of each image that arrives undamaged.
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
        """Whether a program reads the images."""
        return self._take is not None

    @property
    def damaged(self) -> int:
        """Number of parts that could not be decoded since the last `join`."""
        return self._parts.damaged

    def join(self, take: Callable[[bytes], None]) -> Self:
        """Pass each image to a function, starting with the next image. It replaces an earlier one.

        Args:
            take: Called with each image as a JPEG file.

        Returns:
            The camera itself, as the feed.
        """
        self._take = take
        self._parts = Multipart(BOUNDARY)
        return self

    def interrupt(self) -> None:
        """Stop passing images. `join` starts to pass images again."""
        self._take = None

    def _step(self) -> None:
        """Expose and deliver the images that are due. Called in each step of the clock."""
        now_ns = self._clock.true_ns
        self._expose(now_ns)
        while self._wire and self._wire[0].due_ns <= now_ns:
            self._deliver(self._wire.popleft())

    def _expose(self, now_ns: int) -> None:
        """Queue the next image if its exposure has ended.

        The image is skipped if no program reads the images, or if a fault withholds the image.
        """
        stream = self._stream
        exposed_ns = self._start_ns + stream.middle_ns(self._next)
        if now_ns < exposed_ns + stream.half_ns:
            return
        self._next += 1
        if self.watched and not stream.withholds(self._next):
            self._wire.append(stream.drawn_part(exposed_ns))

    def _deliver(self, due: DuePart) -> None:
        """Pass an image, which faults may damage, to the reader. It is lost without a reader.

        Bodies count as shown only if the image is undamaged.
        """
        sent = self._stream.send(due.drawn)
        if self._take is None:
            return
        if sent.startswith(due.drawn):
            self._shown(due.exposed_ns)
        for jpeg in self._parts.feed(sent):
            self._take(jpeg)
