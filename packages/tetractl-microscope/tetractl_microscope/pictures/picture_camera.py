"""A camera that searches pictures: one thread reads the source, another finds the robots."""

import queue
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import cv2
import numpy as np

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.commands import Health
from tetractl.core.errors import AbortError, text_of
from tetractl.core.poses import CameraFrame, Grey, Pose
from tetractl.tools.worker import LOOK_S, WAITING_MAX, drained
from tetractl_microscope.pictures.feed import Feed, Picture, SourceEndedError
from tetractl_microscope.pictures.looks import LOOKS, Look, rate_hz, search_ms, stream_lines
from tetractl_microscope.pictures.picture_section import PictureSection
from tetractl_microscope.pictures.source import decoded

Join = Callable[[Callable[[bytes], None]], Feed]
"""Opens a source in memory, which calls a function with each picture, a JPEG file."""


class SearchedPicture(Protocol):
    """The result for one picture: poses of the robots and of other objects."""

    @property
    def poses(self) -> tuple[Pose | None, ...]:
        """The robots' poses, one per robot, None if not tracked."""
        ...

    @property
    def strangers(self) -> tuple[Pose, ...]:
        """Poses of objects that are not robots of the spec."""
        ...


S = TypeVar("S", bound=SearchedPicture)


@dataclass(frozen=True, slots=True)
class FreshFrame(Generic[S]):
    """A frame that was not returned yet, and what was seen in its picture."""

    frame: CameraFrame
    seen: S


class PictureCamera(ABC, Generic[S]):
    """Base class of cameras that track robots in pictures; subclasses implement `_see` and `check`.

    `wake` is called, in the searching thread, after every new frame. A frame has its picture's
    number: if a live source is faster than the search, numbers are missing. The `fault` of a frame
    is never set; a picture that repeats the one before is no frame. `join` opens a source in memory
    that calls a function with each picture, without a thread; None opens the spec's source.
    """

    def __init__(
        self,
        section: PictureSection,
        clock: Clock,
        wake: Callable[[], None],
        join: Join | None = None,
    ) -> None:
        self._source = section
        self._join = join
        self._clock = clock
        self._wake = wake
        self._fresh: deque[FreshFrame[S]] = deque(maxlen=WAITING_MAX)
        self._looks: deque[Look[S]] = deque(maxlen=LOOKS)
        self._feed: Feed | None = None
        self._size: tuple[int, ...] | None = None
        self._next: queue.Queue[tuple[int, Picture]] = queue.Queue(maxsize=1)
        self._unread = 0  # number of pictures that could not be decoded
        self._newest: Grey | None = None
        self._number = self._skipped = 0
        self._ended = ""
        self._failure: Exception | None = None  # that of the thread that searches
        self._changed = threading.Condition()
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []

    @abstractmethod
    def _see(self, picture: Grey, exposed_ns: int) -> S | None:
        """Search a picture; return its robots and strangers, None if it does not become a frame."""

    @abstractmethod
    def check(self) -> Health:
        """Examine some pictures; return problems, warnings and facts."""

    @property
    def damaged(self) -> int:
        """Number of pictures and of parts of the stream that could not be read."""
        return self._unread + (0 if self._feed is None else self._feed.damaged)

    @property
    def emulated(self) -> bool:
        """Whether the source states that its robots are not real."""
        return self._feed is not None and self._feed.emulated

    def frames(self) -> list[CameraFrame]:
        """Return the frames since the last call, oldest first; raise what ended the search."""
        if self._failure is not None:
            raise self._failure
        return [fresh.frame for fresh in drained(self._fresh) if self._is_current(fresh.seen)]

    def _is_current(self, seen: S) -> bool:
        """Return whether what was seen in a picture is of the present robots, as it is unless a
        subclass can go on with others."""
        return True

    def __enter__(self) -> Self:
        """Open the source and wait for a first frame; AbortError if none comes."""
        patience = self._source.connect
        if self._join is not None:
            self._feed = self._join(self._take)
        else:
            self._feed = feed = self._source.source.open(self._clock, patience)
            self._threads = [
                threading.Thread(target=self._read, args=(feed,), name="pictures", daemon=True),
                threading.Thread(target=self._find, name="finding", daemon=True),
            ]
        for thread in self._threads:
            thread.start()
        if not self._wait(lambda: bool(self._looks), patience):
            self.__exit__()
            damaged = f"{self.damaged} pictures were damaged" if self.damaged else None
            raise AbortError(
                f"no picture comes from {self._source.source_name} ({patience:g} s)",
                self._ended or damaged,
            )
        return self

    def __exit__(self, *_: object) -> None:
        """End both threads and close the source."""
        self._closing.set()
        if self._feed is not None:
            self._feed.interrupt()
        for thread in self._threads:
            thread.join(2.0)

    def _look(self) -> tuple[Look[S], ...]:
        """Wait until 20 more pictures have come or the source has ended, up to `connect`; return
        the results for the last 20, oldest first.
        """
        first = self._looks[-1].number if self._looks else 0

        def enough() -> bool:
            newest = self._looks[-1].number if self._looks else 0
            return newest >= first + LOOKS or bool(self._ended)

        self._wait(enough, self._source.connect)
        return tuple(self._looks)

    def _stream_lines(self, looks: Sequence[Look[S]]) -> tuple[list[str], list[str]]:
        """Return problems and warnings of the stream of pictures."""
        rate = None if self._feed is None else self._feed.rate_hz
        name = self._source.source_name
        now_ns = self._clock.now()
        return stream_lines(looks, name, self._ended, now_ns, rate, self.damaged)

    def _stream_facts(self, looks: Sequence[Look[S]]) -> dict[str, str]:
        """Return resolution, rate of pictures and duration of the search, as far as known."""
        facts: dict[str, str] = {}
        if self._size is not None:
            facts["resolution"] = f"{self._size[1]}x{self._size[0]}"
        if (rate := rate_hz(looks)) is not None:
            facts["rate"] = f"{rate:.1f} Hz"
        if looks:
            facts["search"] = f"{search_ms(looks):.1f} ms"
        return facts

    def _read(self, feed: Feed) -> None:
        """Read pictures into the queue, which keeps only the newest picture of a live source."""
        number = 0
        try:
            while not self._closing.is_set():
                picture = feed.read()
                number += 1
                self._offer((number, picture), feed.live)
        except SourceEndedError as error:
            self._ended = str(error)
            with self._changed:
                self._changed.notify_all()
        finally:
            feed.close()

    def _take(self, jpeg: bytes) -> None:
        self._number += 1
        self._search(self._number, Picture(jpeg, self._clock.now()))

    def _offer(self, picture: tuple[int, Picture], live: bool) -> None:
        while not self._closing.is_set():
            try:
                self._next.put(picture, timeout=None if live else LOOK_S, block=not live)
                return
            except queue.Full:
                if live:
                    with suppress(queue.Empty):
                        self._next.get_nowait()
                        self._skipped += 1

    def _find(self) -> None:
        try:
            while not self._closing.is_set():
                with suppress(queue.Empty):
                    number, picture = self._next.get(timeout=LOOK_S)
                    self._search(number, picture)
        except Exception as error:  # the thread that asks for frames raises it
            self._failure = error
            self._ended = f"the search of pictures has ended: {text_of(error)}"
            with self._changed:
                self._changed.notify_all()
            self._wake()

    def _search(self, number: int, picture: Picture) -> None:
        began = self._clock.now()
        exposed = picture.received_ns - round(self._source.latency * SECOND)
        try:
            grey = decoded(picture, self._size)
            if grey is None or (self._size is not None and grey.shape != self._size):
                self._unread += 1  # a picture of another size does not fit the calibration
                return
            if self._repeats(grey):
                return
            looked = self._see(grey, exposed)
        except cv2.error:  # OpenCV cannot process this picture
            self._unread += 1
            return
        self._size = grey.shape
        if looked is None:
            return
        frame = CameraFrame(number, exposed, picture.received_ns, looked.poses, looked.strangers)
        self._fresh.append(FreshFrame(frame, looked))
        self._looks.append(Look(number, picture.received_ns, self._clock.now() - began, looked))
        with self._changed:
            self._changed.notify_all()
        self._wake()

    def _repeats(self, grey: Grey) -> bool:
        """Return whether a picture is the newest one again, noise and all, and not just black."""
        before = self._newest
        self._newest = grey
        return before is not None and np.array_equal(before, grey) and int(np.ptp(grey)) > 0

    def _wait(self, done: Callable[[], bool], timeout_s: float) -> bool:
        if self._join is not None:
            return wait_for(self._clock, done, timeout_s)
        with self._changed:
            return self._changed.wait_for(done, timeout_s)
