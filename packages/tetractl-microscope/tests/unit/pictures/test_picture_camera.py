"""Tests of a camera that searches images: its queue, its threads, and what it says of a source."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.microscope.needs_opencv import cv2
from tetractl_microscope.pictures.feed import Feed, Picture, SourceEndedError
from tetractl_microscope.pictures.picture_camera import (
    NumberedPicture,
    PictureCamera,
    PictureQueue,
    PictureSearches,
)
from tetractl_microscope.pictures.searches import KEPT_SEARCHES

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.core.protocols import Health

PATIENCE_S = 60.0  # before a test gives up; nothing waits for it to pass


def noise(seed, shape=(40, 60)):
    return np.random.default_rng(seed).integers(0, 255, shape).astype(np.uint8)


class Listed(Feed):
    """A source that delivers some images and then ends, or waits until it is closed."""

    rate_hz = 30.0

    def __init__(self, pictures, live=False, ends=True, error=None):
        self.pictures = list(pictures)
        self.live = live
        self.ends = ends
        self.error = error
        self.interrupted = threading.Event()
        self.closed = threading.Event()

    def read(self):
        if self.pictures:
            return Picture(self.pictures.pop(0), SECOND)
        if self.error is not None:
            raise self.error
        if not self.ends:
            self.interrupted.wait(PATIENCE_S)
        raise SourceEndedError("the film has ended")

    def interrupt(self):
        self.interrupted.set()

    def close(self):
        self.closed.set()


class Searching(PictureCamera):
    """A camera that finds the same robot in every image."""

    def __init__(self, feed, connect=PATIENCE_S, join=None):
        opened = SimpleNamespace(open=lambda clock, wait_s: feed)
        section = SimpleNamespace(
            source=opened, latency=0.05, connect=connect, source_name="camera 7"
        )
        self.woken = 0
        self.exposed = []
        self.result = SimpleNamespace(poses=(Pose(1.0, 2.0, 3.0),), unknown_objects=())
        super().__init__(section, VirtualClock(), self._count, join)

    def _count(self):
        self.woken += 1

    def _see(self, picture, exposed_ns):
        self.exposed.append(exposed_ns)
        return self.result

    def _health(self, searches):
        return Health(("of robots",), ("of light",), {"robots": str(len(searches))})


def ended(camera):
    assert camera._wait(lambda: bool(camera._searches.end_reason), PATIENCE_S)
    return camera


# ---- the queue ----


def numbered(number):
    return NumberedPicture(number, Picture(noise(number), number))


def test_a_live_source_replaces_an_image_that_waits():
    queue = PictureQueue()
    for number in (1, 2, 3):
        queue.put(numbered(number), live=True)
    assert queue.take().number == 3
    assert queue.skipped == 2
    queue.put(numbered(4), live=True)
    assert queue.take().number == 4 and queue.skipped == 2


def test_each_image_of_a_film_waits_for_its_turn():
    queue = PictureQueue()
    taken = []

    def take():
        while (picture := queue.take()) is not None:
            taken.append(picture.number)

    thread = threading.Thread(target=take)
    thread.start()
    for number in range(1, 30):
        queue.put(numbered(number), live=False)
    queue.put(numbered(30), live=False)
    queue.close()
    thread.join(PATIENCE_S)
    assert taken[:29] == list(range(1, 30)) and queue.skipped == 0
    assert queue.closed
    assert queue.take() is None
    queue.put(numbered(31), live=False)  # nobody waits for a closed queue


# ---- the results ----


def test_the_first_error_is_the_reason_and_is_raised():
    searches = PictureSearches()
    assert searches.newest_number() == 0 and searches.last() == () and searches.end_reason == ""
    error = ValueError("torn cable")
    searches.fail("reading", error)
    searches.end("closed")
    assert searches.end_reason == "the reading of images has stopped: ValueError: torn cable"
    with pytest.raises(ValueError, match="torn cable"):
        searches.take_frames()


def test_only_the_newest_searches_are_kept():
    camera = Searching(None)
    for number in range(1, KEPT_SEARCHES + 6):
        camera._search(number, Picture(noise(number), number * SECOND))
    last = camera._searches.last()
    assert [search.number for search in last] == list(range(6, KEPT_SEARCHES + 6))
    assert camera._searches.newest_number() == KEPT_SEARCHES + 5
    assert len(camera.frames()) == KEPT_SEARCHES + 5 and camera.frames() == []


# ---- single images ----


def test_a_frame_has_the_times_of_its_image_and_wakes_the_loop():
    camera = Searching(None)
    camera._search(4, Picture(noise(1), 3 * SECOND))
    (frame,) = camera.frames()
    assert (frame.number, frame.received_ns) == (4, 3 * SECOND)
    assert frame.sampled_ns == camera.exposed[0] == 3 * SECOND - SECOND // 20
    assert frame.poses == (Pose(1.0, 2.0, 3.0),)
    assert camera.woken == 1


def test_an_image_that_comes_again_is_not_searched_unless_it_is_black():
    camera = Searching(None)
    black = np.zeros((40, 60), np.uint8)
    for number, picture in enumerate([noise(1), noise(1), noise(2), noise(1), black, black], 1):
        camera._search(number, Picture(picture, number * SECOND))
    assert [frame.number for frame in camera.frames()] == [1, 3, 4, 5, 6]
    assert camera.damaged == 0


def test_images_of_another_size_and_broken_files_are_damaged():
    camera = Searching(None)
    camera._search(1, Picture(noise(1), SECOND))
    camera._search(2, Picture(noise(2, (60, 40)), 2 * SECOND))
    camera._search(3, Picture(b"no jpeg", 3 * SECOND))
    camera._search(4, Picture(noise(4), 4 * SECOND))
    assert [frame.number for frame in camera.frames()] == [1, 4]
    assert camera.damaged == 2 and camera.woken == 2


def test_an_image_that_opencv_cannot_process_is_damaged(monkeypatch):
    camera = Searching(None)

    def fail(picture, exposed_ns):
        raise cv2.error("no")

    monkeypatch.setattr(camera, "_see", fail)
    camera._search(1, Picture(noise(1), SECOND))
    assert camera.frames() == [] and camera.damaged == 1


def test_an_image_without_a_result_makes_no_frame():
    camera = Searching(None)
    camera.result = None
    camera._search(1, Picture(noise(1), SECOND))
    assert camera.frames() == [] and camera.woken == 0 and camera.damaged == 0


# ---- sources ----


def test_all_images_of_a_film_are_searched_and_then_its_end_is_a_problem():
    feed = Listed([noise(k) for k in range(12)])
    with Searching(feed) as camera:
        ended(camera)
        assert camera._wait(lambda: camera._searches.newest_number() == 12, PATIENCE_S)
        health = camera.check()
    assert [frame.number for frame in camera.frames()] == list(range(1, 13))
    assert health.problems == ("the film has ended", "of robots")
    assert health.warnings[-1] == "of light"
    assert health.facts["source"] == "camera 7"
    assert health.facts["resolution"] == "60x40"
    assert health.facts["robots"] == "12"
    assert health.facts["damaged"] == health.facts["skipped"] == "0"
    assert not health.emulated
    assert feed.closed.wait(PATIENCE_S)


def test_leaving_ends_a_source_that_waits():
    feed = Listed([noise(1)], live=True, ends=False)
    with Searching(feed) as camera:
        assert camera._searches.newest_number() == 1
    assert feed.closed.is_set()
    assert all(not thread.is_alive() for thread in camera._threads)


@pytest.mark.parametrize(
    ("feed", "hint"),
    [
        (Listed([]), "the film has ended"),
        (Listed([b"no jpeg", b"none"], live=False, ends=False), "2 images were damaged"),
        (Listed([], ends=False), None),
    ],
)
def test_a_source_without_an_image_is_refused_with_its_reason(feed, hint):
    camera = Searching(feed, connect=0.05)
    with pytest.raises(AbortError, match=r"no image came from camera 7 within 0.05 s") as error:
        camera.__enter__()
    assert error.value.hint == hint
    assert feed.closed.wait(PATIENCE_S)


def test_an_unexpected_error_of_a_source_wakes_the_loop_and_is_raised():
    with Searching(Listed([noise(1)], error=OSError("torn"))) as camera:
        ended(camera)
        with pytest.raises(OSError, match="torn"):
            camera.frames()
        assert camera._searches.end_reason.startswith("the reading of images has stopped")
    assert camera.woken == 2


def test_a_source_in_memory_is_searched_without_threads():
    """It calls the camera with each image, a JPEG file, in virtual time."""
    calls = []
    feed = Listed([])
    feed.emulated = True

    def join(search):
        calls.append(search)
        search(cv2.imencode(".jpg", noise(1))[1].tobytes())
        return feed

    with Searching(None, join=join) as camera:
        (search,) = calls
        search(b"no jpeg")
        search(cv2.imencode(".jpg", noise(2))[1].tobytes())
        assert [frame.number for frame in camera.frames()] == [1, 3]
        assert camera.damaged == 1 and camera.emulated
        assert camera._threads == []
    assert feed.interrupted.is_set()


def test_a_camera_that_is_not_open_is_not_emulated_and_has_no_damage():
    camera = Searching(None)
    assert not camera.emulated and camera.damaged == 0
