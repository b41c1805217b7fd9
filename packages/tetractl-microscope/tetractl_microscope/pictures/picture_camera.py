"""Base class of cameras that find robots in the images of a webcam, a microscope or a film.

A search can take longer than the time between two images. Two threads therefore work: "pictures"
reads the source and puts each image into a queue that holds one image (`PictureQueue`), and
"finding" takes it from there, searches it, and adds the result to `PictureSearches`. The program's
own thread asks for frames. The threads share only these two objects, each of which has its own
lock. In virtual time, there is no thread: the source in memory calls the search with each image.

A live source does not wait: an image that is still in the queue is replaced by the next one.
"""

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import cv2
import numpy as np

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import AbortError, describe_error
from tetractl.core.poses import CameraFrame, GreyImage, Pose
from tetractl.core.protocols import Health
from tetractl.tools.worker import QUEUE_MAX, take_all
from tetractl_microscope.pictures.feed import Feed, Picture, SourceEndedError
from tetractl_microscope.pictures.picture_section import PictureSection
from tetractl_microscope.pictures.searches import (
    KEPT_SEARCHES,
    PictureSearch,
    compute_image_rate_hz,
    compute_median_search_ms,
    describe_stream,
)
from tetractl_microscope.pictures.source import decode_to_grey

# Maximum wait for a thread to stop. A thread that runs longer ends with the process.
THREAD_STOP_MAX_S = 2.0

OpenMemorySource = Callable[[Callable[[bytes], None]], Feed]
"""Function that opens a source in memory, which calls a function with each image, as JPEG."""


class PictureResult(Protocol):
    """The poses that a search found in one image."""

    @property
    def poses(self) -> tuple[Pose | None, ...]:
        """The pose of each robot. None for an untracked robot."""
        ...

    @property
    def unknown_objects(self) -> tuple[Pose, ...]:
        """Poses of objects that are not robots of the spec."""
        ...


SearchResult = TypeVar("SearchResult", bound=PictureResult)


@dataclass(frozen=True, slots=True)
class NumberedPicture:
    """An image and its number in the source, counted from 1."""

    number: int
    picture: Picture


class PictureQueue:
    """A queue for one image: one thread puts images into the queue, and another takes them out.

    Attributes:
        skipped: Number of images of a live source that were replaced before they were searched.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._queued: NumberedPicture | None = None
        self._closed = False
        self.skipped = 0

    def put(self, picture: NumberedPicture, live: bool) -> None:
        """Add an image to the queue, which has space for one.

        If the source is live, the image replaces an image that still waits. Otherwise, the method
        waits until the space is free. Nothing happens once the queue is closed.
        """
        with self._changed:
            if live and self._queued is not None:
                self.skipped += 1
            elif not live:
                self._changed.wait_for(lambda: self._queued is None or self._closed)
            self._queued = picture
            self._changed.notify_all()

    def take(self) -> NumberedPicture | None:
        """Wait for an image, and remove it from the queue.

        Returns:
            The image. None once the queue is closed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._queued is not None or self._closed)
            if self._closed:
                return None
            picture = self._queued
            self._queued = None
            self._changed.notify_all()
            return picture

    def close(self) -> None:
        """Close the queue, which ends all present and later waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """Whether the queue was closed."""
        return self._closed


class PictureSearches(Generic[SearchResult]):
    """The results of the searches of images, and the reason why no more will follow.

    The camera's threads write it, and the program's own thread reads it, under one lock
    (`changed`).

    Attributes:
        changed: Notified after each change.
        end_reason: Why no more images arrive. Empty while they do.
        failure: The unexpected error behind `end_reason`. None if there was none.
    """

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.end_reason = ""
        self.failure: Exception | None = None
        self._frames: deque[tuple[CameraFrame, SearchResult]] = deque(maxlen=QUEUE_MAX)
        self._last: deque[PictureSearch[SearchResult]] = deque(maxlen=KEPT_SEARCHES)

    def add(self, frame: CameraFrame, search: PictureSearch[SearchResult]) -> None:
        """Add a camera frame, and the search of the image in which its poses were found."""
        with self.changed:
            self._frames.append((frame, search.result))
            self._last.append(search)
            self.changed.notify_all()

    def end(self, reason: str) -> None:
        """Record that no more images arrive, and why, unless an error was recorded before.

        Waiting threads are woken in both cases.
        """
        with self.changed:
            if self.failure is None:
                self.end_reason = reason
            self.changed.notify_all()

    def fail(self, thread: str, error: Exception) -> None:
        """Record the error that ended a thread, so that the program's own thread raises it."""
        with self.changed:
            self.end_reason = f"the {thread} of images has stopped: {describe_error(error)}"
            self.failure = error
            self.changed.notify_all()

    def take_frames(self) -> list[tuple[CameraFrame, SearchResult]]:
        """Return the frames since the last call, oldest first, each with its result.

        If an unexpected error has ended the reading or the search, it is raised here.
        """
        if self.failure is not None:
            raise self.failure
        with self.changed:
            return take_all(self._frames)

    def last(self) -> tuple[PictureSearch[SearchResult], ...]:
        """Return the last KEPT_SEARCHES searches, or fewer at the start, oldest first."""
        with self.changed:
            return tuple(self._last)

    def newest_number(self) -> int:
        """Return the number of the newest image that was searched. 0 if there is none."""
        with self.changed:
            return self._last[-1].number if self._last else 0


class PictureCamera(ABC, Generic[SearchResult]):
    """Base class of cameras that track robots in images. Subclasses implement `_see` and `_health`.

    A frame has the number of its image: if a live source is faster than the search, numbers are
    missing. The `fault` of a frame is never set. An image that repeats the previous one is no
    frame.

    Only the searching thread uses `_size`, `_newest_picture`, and what a subclass adds. Only that
    thread counts in `_undecoded_count`.

    Args:
        section: The fields of the camera in the spec.
        clock: The clock for times.
        wake: Called, in the searching thread, after every new frame.
        join: Opens a source in memory that calls a function with each image, without a thread. None
            for the spec's source.
    """

    def __init__(
        self,
        section: PictureSection,
        clock: Clock,
        wake: Callable[[], None],
        join: OpenMemorySource | None = None,
    ) -> None:
        self._source = section
        self._join = join
        self._clock = clock
        self._wake = wake
        self._feed: Feed | None = None
        self._threads: list[threading.Thread] = []
        self._queue = PictureQueue()
        self._searches = PictureSearches[SearchResult]()
        self._size: tuple[int, ...] | None = None  # height and width of the first picture
        self._newest_picture: GreyImage | None = None
        self._undecoded_count = 0  # number of pictures that could not be decoded
        self._memory_count = 0  # number of pictures of a source in memory

    @abstractmethod
    def _see(self, picture: GreyImage, exposed_ns: int) -> SearchResult | None:
        """Search an image for robots and other objects.

        Args:
            picture: The grey image, shape (height, width).
            exposed_ns: When it was exposed [ns].

        Returns:
            The robots and other objects that were found. None if the image makes no frame.
        """

    @abstractmethod
    def _health(self, searches: Sequence[PictureSearch[SearchResult]]) -> Health:
        """Check what was found in the given images: problems, warnings and facts."""

    def check(self) -> Health:
        """Wait for some images, and check the stream and what it shows; see `Device.check`.

        It waits for KEPT_SEARCHES more images, or the source's end, up to `connect`.
        """
        last_number = self._searches.newest_number() + KEPT_SEARCHES
        self._wait(
            lambda: (
                self._searches.newest_number() >= last_number or bool(self._searches.end_reason)
            ),
            self._source.connect,
        )
        searches = self._searches.last()
        problems, warnings = describe_stream(
            searches,
            self._source.source_name,
            self._searches.end_reason,
            self._clock.now(),
            None if self._feed is None else self._feed.rate_hz,
            self.damaged,
        )
        robots_health = self._health(searches)
        facts = {
            "source": self._source.source_name,
            **robots_health.facts,
            **self._stream_facts(searches),
            "damaged": str(self.damaged),
            "skipped": str(self._queue.skipped),
        }
        return Health(
            (*problems, *robots_health.problems),
            (*warnings, *robots_health.warnings),
            facts,
            emulated=self.emulated,
        )

    @property
    def damaged(self) -> int:
        """Number of images and of parts of the stream that could not be decoded."""
        return self._undecoded_count + (0 if self._feed is None else self._feed.damaged)

    @property
    def emulated(self) -> bool:
        """Whether the source reports that its robots are not real."""
        return self._feed is not None and self._feed.emulated

    def frames(self) -> list[CameraFrame]:
        """Return the frames since the last call, oldest first.

        If an unexpected error has ended the reading or the search, it is raised here.
        """
        return [frame for frame, _ in self._searches.take_frames()]

    def __enter__(self) -> Self:
        """Open the source and wait for a first frame.

        Raises:
            AbortError: If none arrives.
        """
        timeout_s = self._source.connect
        if self._join is not None:
            self._feed = self._join(self._search_jpeg)
        else:
            feed = self._source.source.open(self._clock, timeout_s)
            self._feed = feed
            reading_thread = threading.Thread(
                target=self._read_source, args=(feed,), name="pictures", daemon=True
            )
            search_thread = threading.Thread(target=self._search_queue, name="finding", daemon=True)
            self._threads = [reading_thread, search_thread]
        for thread in self._threads:
            thread.start()
        if not self._wait(lambda: self._searches.newest_number() > 0, timeout_s):
            end_reason = self._searches.end_reason  # closing the source ends it too
            self.__exit__()
            name = self._source.source_name
            if self._newest_picture is not None and not end_reason:
                raise AbortError(
                    f"images come from {name}, but none was searched to its end within "
                    f"{timeout_s:g} s",
                    "is this computer busy? With a larger lab.camera.connect, tetractl waits "
                    "longer",
                )
            damaged = f"{self.damaged} images were damaged" if self.damaged else None
            raise AbortError(
                f"no image came from {name} within {timeout_s:g} s", end_reason or damaged
            )
        return self

    def __exit__(self, *_: object) -> None:
        """Stop both threads and close the source. Waits up to THREAD_STOP_MAX_S for each thread."""
        self._queue.close()
        if self._feed is not None:
            self._feed.interrupt()
        for thread in self._threads:
            thread.join(THREAD_STOP_MAX_S)

    def _stream_facts(self, searches: Sequence[PictureSearch[SearchResult]]) -> dict[str, str]:
        """Describe the resolution, image rate and search time, as far as they are known."""
        facts: dict[str, str] = {}
        if self._size is not None:
            facts["resolution"] = f"{self._size[1]}x{self._size[0]}"
        rate = compute_image_rate_hz(searches)
        if rate is not None:
            facts["rate"] = f"{rate:.1f} Hz"
        if searches:
            facts["search"] = f"{compute_median_search_ms(searches):.1f} ms"
        return facts

    def _read_source(self, feed: Feed) -> None:
        """Put the images of the source into the queue until it ends, in the thread "pictures".

        The source is closed in any case. Errors are recorded instead of raised.
        """
        number = 0
        try:
            while not self._queue.closed:
                picture = feed.read()
                number += 1
                self._queue.put(NumberedPicture(number, picture), feed.live)
        except SourceEndedError as error:
            self._searches.end(str(error))
        except Exception as error:  # `frames` raises it in the program's thread
            self._searches.fail("reading", error)
            self._wake()
        finally:
            feed.close()

    def _search_queue(self) -> None:
        """Search the images in the queue until it is closed, in the thread "finding".

        Errors are recorded instead of raised.
        """
        try:
            waiting = self._queue.take()
            while waiting is not None:
                self._search(waiting.number, waiting.picture)
                waiting = self._queue.take()
        except Exception as error:  # `frames` raises it in the program's thread
            self._searches.fail("search", error)
            self._wake()

    def _search_jpeg(self, jpeg: bytes) -> None:
        """Search the next image of a source in memory."""
        self._memory_count += 1
        self._search(self._memory_count, Picture(jpeg, self._clock.now()))

    def _search(self, number: int, picture: Picture) -> None:
        """Decode and search an image, and add a frame if the search returns a result.

        An image that cannot be decoded, or that has another size than the first one, only
        counts as damaged. An image that repeats the previous one is skipped.
        """
        began_ns = self._clock.now()
        exposed_ns = picture.received_ns - round(self._source.latency * SECOND)
        try:
            grey = decode_to_grey(picture, self._size)
            if grey is None or (self._size is not None and grey.shape != self._size):
                self._undecoded_count += 1  # a picture of another size does not fit the calibration
                return
            is_repeated = self._repeats(grey)
            self._newest_picture = grey
            if is_repeated:
                return
            result = self._see(grey, exposed_ns)
        except cv2.error:  # OpenCV cannot process this picture
            self._undecoded_count += 1
            return
        self._size = grey.shape
        if result is None:
            return
        received_ns = picture.received_ns
        frame = CameraFrame(number, exposed_ns, received_ns, result.poses, result.unknown_objects)
        search_ns = self._clock.now() - began_ns
        self._searches.add(frame, PictureSearch(number, received_ns, search_ns, result))
        self._wake()

    def _repeats(self, grey: GreyImage) -> bool:
        """Check whether an image is equal to the previous image.

        An image of one grey level, such as a black image, never counts as a repetition.
        """
        newest = self._newest_picture
        return newest is not None and np.array_equal(newest, grey) and int(np.ptp(grey)) > 0

    def _wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition holds.

        Args:
            condition: Returns whether the condition holds.
            timeout_s: Maximum time to wait [s].

        Returns:
            Whether the condition holds. False after the timeout.
        """
        if self._join is not None:
            return wait_for(self._clock, condition, timeout_s)
        with self._searches.changed:
            return self._searches.changed.wait_for(condition, timeout_s)
