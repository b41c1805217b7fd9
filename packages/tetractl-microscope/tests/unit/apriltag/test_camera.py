"""Tests of the AprilTag camera with a film in virtual time, and with an emulated network camera."""

import itertools
import threading
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.emulator.acting import act
from testkit.microscope.tag_scene import FLOOR, MM, NAMES, ROBOTS, STANDING, film, rendered, section
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.pictures.apriltag.side import Optics, Renderer
from tetractl_emulator.pictures.network_camera import (
    EmulatedNetworkCamera,
    PictureStream,
)
from tetractl_microscope.apriltag.camera import AprilTagCamera
from tetractl_microscope.apriltag.section import FloorTag
from tetractl_microscope.pictures.feed import Picture
from tetractl_microscope.pictures.source import FileFeed

from tetractl.core.clock import SECOND, MonotonicClock, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Poses

pytestmark = pytest.mark.slow

PATIENCE_S = 120.0  # before a test gives up; nothing waits for it to pass


SETUP = SimpleNamespace(names=NAMES, metres=MM)


class Woken:
    """Counts frames and waits for one that a test looks for."""

    def __init__(self):
        self.count = 0
        self.changed = threading.Condition()

    def __call__(self):
        with self.changed:
            self.count += 1
            self.changed.notify_all()

    def wait(self, done):
        with self.changed:
            assert self.changed.wait_for(done, PATIENCE_S)


def standing(t_ns):
    return STANDING


def built(source, clock=None, **changes):
    woken = Woken()
    options = {"connect": PATIENCE_S, **changes}
    return AprilTagCamera(section(source, **options), SETUP, clock or VirtualClock(), woken), woken


def pictures(renderer, count, poses_at=standing):
    return [renderer.picture(poses_at, k * SECOND // 30) for k in range(count)]


def test_every_picture_of_a_film_is_a_frame(tmp_path):
    def driving(t_ns):
        return replace(STANDING, x=STANDING.x + 200e-9 * t_ns)

    source = film(tmp_path / "film.tif", pictures(rendered(), 12, driving))
    camera, woken = built(source, latency=0.1)
    with camera:
        woken.wait(lambda: woken.count == 12)
        frames = camera.frames()
        assert camera.frames() == []
    assert [frame.number for frame in frames] == list(range(1, 13))
    for k, frame in enumerate(frames):
        assert frame.received_ns == pytest.approx(k * SECOND / 30, abs=1)
        assert frame.sampled_ns == frame.received_ns - SECOND // 10
        assert frame.fault == ""
        truth = driving(k * SECOND // 30)
        x = [pose.x for pose in frame.poses if pose is not None]
        assert x == pytest.approx(truth.x, abs=2.5)
    assert camera.damaged == 0


def test_an_error_of_the_source_is_raised_where_frames_are_asked_for(tmp_path, monkeypatch):
    """A source ends by SourceEndedError; any other error ended the reading thread silently."""
    camera, woken = built(film(tmp_path / "film.tif", pictures(rendered(), 2)))
    read = FileFeed.read
    reads = itertools.count()

    def fail_after_first(feed):
        if next(reads) > 0:
            raise OSError("cable torn")
        return read(feed)

    monkeypatch.setattr(FileFeed, "read", fail_after_first)
    with camera:
        woken.wait(lambda: camera._searches.failure is not None)
        with pytest.raises(OSError, match="cable torn"):
            camera.frames()


def test_the_health_of_a_good_camera_tells_its_facts(tmp_path):
    shots = pictures(rendered(), 8)
    camera, woken = built(film(tmp_path / "film.tif", shots))
    with camera:
        woken.wait(lambda: woken.count == 8)
        health = camera.check()
    assert [line for line in health.problems if "has ended" not in line] == []
    assert health.facts["resolution"] == "640x480"
    assert health.facts["rate"] == "30.0 Hz"
    assert health.facts["latency"] == "0.05 s, as the spec says"
    assert float(health.facts["floor_error"].removesuffix(" mm")) < 1.0
    assert health.facts["focal_length"].endswith(", estimated")


def checked(tmp_path, renderer, rate=30.0, **changes):
    """What the camera says of pictures of a renderer, as lines."""
    camera, woken = built(film(tmp_path / "film.tif", pictures(renderer, 4), rate), **changes)
    with camera:
        woken.wait(lambda: woken.count == 4)
        health = camera.check()
    ended, *problems = health.problems
    assert ended.endswith("film.tif has ended")
    return problems, list(health.warnings)


def turned(heading):
    """Floor tags of which the first lies otherwise than the spec says."""
    return (FLOOR[0].model_copy(update={"heading": heading}), *FLOOR[1:])


TWINS = [
    FloorTag(tag=100, at=(1300, 700), size_mm=120),
    FloorTag(tag=586, at=(1900, 900), size_mm=100),
]
SMALLER = (ROBOTS[0].model_copy(update={"size_mm": 90.0}), *ROBOTS[1:])
DOWN = {"tilt": 0.0}


@pytest.mark.parametrize(
    ("scene", "facing", "changes", "problems", "warning"),
    [
        (
            {"hidden": {101, 103, 7}},
            {},
            {},
            [
                "floor tags 101, 103 are not seen by the camera; tags seen: 0, 100, 102, 586",
                "blue: the camera does not see tag 7",
            ],
            "",
        ),
        (
            {"strays": TWINS},
            {},
            {},
            [
                "floor tag 100 is seen twice, but each",
                "red: the camera sees tag 586 twice, so the robot is not",
            ],
            "",
        ),
        ({}, {}, {"floor": turned(0.06)}, [], "the floor tags are up to "),
        ({}, {}, {"floor": turned(1.5)}, ["the floor tags are up to "], ""),
        (
            {},
            DOWN,
            {},
            ["the floor tags do not determine the lens well, so that robots may be located "],
            "",
        ),
        ({}, DOWN, {"lens": {"focal_px": rendered(facing=DOWN).optics.focal_px}}, [], ""),
        ({}, {}, {"robots": SMALLER}, [], "green: the tag looks 11."),
    ],
)
def test_what_is_wrong_is_named(tmp_path, scene, facing, changes, problems, warning):
    renderer = rendered(facing=facing)
    for name, value in scene.items():
        setattr(renderer, name, value)
    problems_found, warnings = checked(tmp_path, renderer, **changes)
    assert len(problems_found) == len(problems)
    assert all(line.startswith(start) for line, start in zip(problems_found, problems, strict=True))
    assert any(line.startswith(warning) for line in warnings) or not warning


def test_pictures_of_standing_robots_differ():
    """Regression: a trial warned that a picture was not searched, because the emulated camera had
    drawn the same noise twice in a row."""
    same_noise_drawn_twice = 6658
    renderer = rendered(seed=same_noise_drawn_twice)
    first, second = (renderer.picture(standing, 0) for _ in range(2))
    assert (first != second).any()


def printed(tags):
    """Tags as of a page that was printed at 98 %."""
    return [tag.model_copy(update={"size_mm": 0.98 * tag.size_mm}) for tag in tags]


@pytest.mark.parametrize("lens", [True, False])
@pytest.mark.parametrize("facing", [{}, DOWN])
def test_tags_that_were_printed_smaller_are_warned_of(tmp_path, facing, lens):
    """Regression: all tags printed at 98 % were ready."""
    optics = Optics.facing(FLOOR, MM, 1280, 720, **facing)
    renderer = Renderer(printed(ROBOTS), printed(FLOOR), MM, optics)
    _, warnings = checked(tmp_path, renderer, lens={"focal_px": optics.focal_px} if lens else None)
    of_size = [line for line in warnings if " % smaller" in line or " % larger" in line]
    assert [line.split(":")[0] for line in of_size] == list(NAMES)
    assert all("printed at 100 %" in line for line in of_size)


# Over loopback, on the host's clock.


class Served:
    """An emulated network camera of robots at some poses, and the camera that watches it."""

    def __init__(self, poses_at=standing, latency_s=0.02, **changes):
        clock = MonotonicClock()
        draw = partial(rendered().picture, poses_at)
        self.acting = ActingFaults()
        stream = PictureStream(draw, 40.0, latency_s=latency_s, acting=self.acting)
        self.server = EmulatedNetworkCamera(stream, clock)
        source = {"type": "mjpeg", "url": self.server.url}
        self.camera, self.woken = built(source, clock, latency=latency_s, **changes)

    def __enter__(self):
        self.server.__enter__()
        self.camera.__enter__()
        return self

    def __exit__(self, *error):
        self.camera.__exit__(*error)
        self.server.__exit__(*error)


@pytest.mark.long
def test_exposure_times_are_right_to_a_few_milliseconds():
    """A robot that moves by known speed tells when a frame was really exposed."""
    speed = 300.0

    def driving(t_ns):
        return Poses(STANDING.x + 1e-9 * t_ns * speed, STANDING.y, np.zeros(3))

    with Served(driving, latency_s=0.04) as it:
        it.woken.wait(lambda: it.woken.count >= 15)
    late = []
    for frame in it.camera.frames():
        if frame.poses[0] is not None:
            exposed_ns = (frame.poses[0].x - STANDING.x[0]) / speed * SECOND
            late.append((frame.sampled_ns - exposed_ns) / 1e6)
    assert -5.0 < min(late) < 20.0  # ms; a loaded host sends later, but none earlier


def test_a_camera_that_stops_sending_is_told():
    with Served(connect=0.7) as it:
        it.woken.wait(lambda: it.woken.count >= 3)
        act(it.acting, "no_frames")
        problems = it.camera.check().problems
        assert problems == (f"no images come from {it.server.url} any more",)


def test_a_camera_without_pictures_is_no_camera():
    it = Served(connect=0.3)
    act(it.acting, "no_frames")
    with it.server:
        with pytest.raises(AbortError, match=r"no image came from http://127.* within 0.3 s"):
            it.camera.__enter__()
        it.camera.__exit__(None, None, None)  # again: nothing happens


def test_an_error_of_the_search_is_raised_where_frames_are_asked_for(tmp_path, monkeypatch):
    """Regression: it ended the thread that searches, and nothing said why no frames came."""
    camera, woken = built(film(tmp_path / "film.tif", pictures(rendered(), 2)))
    see = camera._see

    def fail_at_second(grey, exposed):
        if woken.count == 1:
            raise ValueError("no such tag")
        return see(grey, exposed)

    monkeypatch.setattr(camera, "_see", fail_at_second)
    with camera:
        woken.wait(lambda: woken.count == 2)
        with pytest.raises(ValueError, match="no such tag"):
            camera.frames()
        (problem, *_) = camera.check().problems
    assert problem == "the search of images has stopped: ValueError: no such tag"


def test_pictures_whose_search_does_not_end_are_told_from_none(monkeypatch):
    """Regression: on a busy computer "no picture comes, URL closed the stream"."""
    it = Served(connect=0.1)
    act(it.acting, "no_frames")
    monkeypatch.setattr(it.camera, "_see", lambda picture, exposed_ns: None)
    it.camera._search(1, Picture(np.zeros((9, 9), np.uint8), 0))
    with pytest.raises(AbortError, match=r"images come .* within 0.1 s") as told:
        it.__enter__()
    it.server.__exit__()
    assert (
        told.value.hint
        == "is this computer busy? With a larger lab.camera.connect, tetractl waits longer"
    )
