"""The whole camera: a film in virtual time, and an emulated network camera over loopback."""

import threading
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from support.tag_scene import FLOOR, MM, NAMES, ROBOTS, STANDING, film, rendered, section
from support.trials import experiment

from tetractl.core.clock import SECOND, MonotonicClock, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Poses
from tetractl.emulate.network_camera import EmulatedNetworkCamera
from tetractl.experiment.lab_section import LabLimits
from tetractl.lab.cameras.apriltag.camera import AprilTagCamera
from tetractl.lab.cameras.apriltag.section import FloorTag
from tetractl.lab.guard import Guard
from tetractl.lab.rig import guard_rules

PATIENCE_S = 20.0  # how long a test waits for what should come at once


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
    made = section(source, **{"connect": PATIENCE_S, **changes})
    return AprilTagCamera(made, SETUP, clock or VirtualClock(), woken), woken


def pictures(renderer, count, poses_at=standing):
    return [renderer.picture(poses_at, k * SECOND // 30) for k in range(count)]


def test_every_picture_of_a_film_is_a_frame(tmp_path):
    def driving(t_ns):
        return replace(STANDING, x=STANDING.x + 200e-9 * t_ns)

    source = film(tmp_path / "film.avi", pictures(rendered(), 12, driving))
    camera, woken = built(source, latency=0.1)
    with camera:
        woken.wait(lambda: woken.count == 12)
        frames = camera.frames()
        assert camera.frames() == []
        assert camera.newest == frames[-1]
    assert [frame.number for frame in frames] == list(range(1, 13))
    for k, frame in enumerate(frames):
        assert frame.received_ns == pytest.approx(k * SECOND / 30, abs=1)
        assert frame.sampled_ns == frame.received_ns - SECOND // 10
        assert frame.fault == ""
        truth = driving(k * SECOND // 30)
        found = [pose.x for pose in frame.poses if pose is not None]
        assert found == pytest.approx(truth.x, abs=2.5)
    assert camera.damaged == 0


def test_the_health_of_a_good_camera_tells_its_facts(tmp_path):
    camera, woken = built(film(tmp_path / "film.avi", pictures(rendered(), 8)))
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
    camera, woken = built(film(tmp_path / "film.avi", pictures(renderer, 4), rate), **changes)
    with camera:
        woken.wait(lambda: woken.count == 4)
        health = camera.check()
    ended, *problems = health.problems
    assert ended.endswith("film.avi has ended")
    return problems, list(health.warnings)


def test_missing_tags_are_named_beside_those_seen(tmp_path):
    renderer = rendered()
    renderer.hidden = {101, 103, 7}
    problems, _ = checked(tmp_path, renderer)
    assert problems == [
        "floor tags 101, 103 are not seen; tags seen: 0, 100, 102, 586",
        "blue: tag 7 is not seen; tags seen: 0, 100, 102, 586",
    ]


def test_tags_seen_twice_are_named(tmp_path):
    renderer = rendered()
    renderer.strays = [
        FloorTag(tag=100, at=(1300, 700), size_mm=120),
        FloorTag(tag=586, at=(1900, 900), size_mm=100),
    ]
    problems, _ = checked(tmp_path, renderer)
    assert problems == [
        "floor tag 100 is seen twice: every number may be used once only",
        "red: tag 586 is seen twice, so it is not tracked",
    ]


def test_floor_tags_that_are_not_where_the_spec_says_are_told(tmp_path):
    wrong = (FLOOR[0].model_copy(update={"heading": 0.06}), *FLOOR[1:])
    problems, warnings = checked(tmp_path, rendered(), floor=wrong)
    assert problems == []
    assert warnings[0].startswith("the floor tags lie up to ")
    wrong = (FLOOR[0].model_copy(update={"heading": 1.5}), *FLOOR[1:])
    problems, _ = checked(tmp_path, rendered(), floor=wrong)
    assert problems[0].startswith("the floor tags lie up to ")


def test_looking_straight_down_asks_for_the_lens(tmp_path):
    problems, _ = checked(tmp_path, rendered(facing={"tilt": 0.0}))
    assert problems[0].startswith("the floor tags say too little about the lens: robots may be ")
    focal = rendered(facing={"tilt": 0.0}).optics.focal_px
    problems, warnings = checked(tmp_path, rendered(facing={"tilt": 0.0}), lens={"focal_px": focal})
    assert (problems, warnings) == ([], [])


def test_a_wrong_size_or_height_is_told(tmp_path):
    robots = (ROBOTS[0].model_copy(update={"size_mm": 90.0}), *ROBOTS[1:])
    _, warnings = checked(tmp_path, rendered(), robots=robots)
    line = "green: its tag looks 11 % smaller than it should: are size_mm and height_mm right?"
    assert line in warnings


def test_a_slow_and_a_blurred_camera_are_warned_of(tmp_path):
    _, warnings = checked(tmp_path, rendered((1280, 720), blur_px=1.6), rate=10.0)
    assert any(line.startswith("only 10 pictures a second come") for line in warnings)
    assert any(line.startswith("tags are too small or blurred") for line in warnings)


def test_pictures_of_another_size_are_damaged(tmp_path, monkeypatch):
    from tetractl.lab.cameras.pictures import picture_camera as module

    shots = pictures(rendered(), 3)
    shots[1] = np.ascontiguousarray(shots[1][:100])
    feed = iter(shots)
    monkeypatch.setattr(module, "decoded", lambda picture, size: next(feed))
    camera, woken = built(film(tmp_path / "film.avi", pictures(rendered(), 3)))
    with camera:
        woken.wait(lambda: woken.count == 2)
        assert [frame.number for frame in camera.frames()] == [1, 3]
        assert camera.damaged == 1


# Over loopback, on the host's clock.


class Served:
    """An emulated network camera and the camera that watches it."""

    def __init__(self, rate_hz=40.0, **changes):
        clock = MonotonicClock()
        draw = partial(rendered().picture, standing)
        self.server = EmulatedNetworkCamera(draw, clock, rate_hz, latency_s=0.02)
        source = {"type": "mjpeg", "url": self.server.url}
        self.camera, self.woken = built(source, clock, **{"latency": 0.02, **changes})

    def __enter__(self):
        self.server.__enter__()
        self.camera.__enter__()
        return self

    def __exit__(self, *error):
        self.camera.__exit__(*error)
        self.server.__exit__(*error)


def test_over_http_poses_come_at_the_cameras_rate_with_their_time_of_exposure():
    with Served() as it:
        it.woken.wait(lambda: it.woken.count >= 12)
        frames = it.camera.frames()
        health = it.camera.check()
    for frame in frames:
        assert [pose.x for pose in frame.poses] == pytest.approx(STANDING.x, abs=3.0)
        assert frame.received_ns - frame.sampled_ns == SECOND // 50
    assert (health.problems, health.emulated) == ((), True)
    assert it.camera.damaged == 0


def test_exposure_times_are_right_to_a_few_milliseconds():
    """A robot that moves by known speed tells when a frame was really exposed."""
    speed = 300.0
    clock = MonotonicClock()

    def driving(t_ns):
        return Poses(STANDING.x + 1e-9 * t_ns * speed, STANDING.y, np.zeros(3))

    draw = partial(rendered().picture, driving)
    with EmulatedNetworkCamera(draw, clock, 30.0, latency_s=0.04) as server:
        source = {"type": "mjpeg", "url": server.url}
        camera, woken = built(source, clock, latency=0.04)
        with camera:
            woken.wait(lambda: woken.count >= 15)
    late = []
    for frame in camera.frames():
        if frame.poses[0] is not None:
            exposed_ns = (frame.poses[0].x - STANDING.x[0]) / speed * SECOND
            late.append((frame.sampled_ns - exposed_ns) / 1e6)
    assert -5.0 < min(late) < 20.0  # ms; a loaded host sends later, but none earlier


def test_spoiled_parts_are_counted_and_survived():
    with Served() as it:
        it.woken.wait(lambda: it.woken.count >= 3)
        rng = np.random.default_rng(1)
        spoilt = 0

        def spoil(part):
            nonlocal spoilt
            if spoilt == 8:
                return part
            spoilt += 1
            cut = int(rng.integers(1, len(part)))
            return part[:cut] if spoilt % 2 else part[:cut] + b"garbage" + part[cut + 30 :]

        count = it.woken.count
        it.server.mangle = spoil
        it.woken.wait(lambda: spoilt == 8 and it.woken.count > count + 3)
        assert it.camera.damaged >= 8
        health = it.camera.check()
    assert health.problems == ()
    assert any(line.endswith("pictures were damaged") for line in health.warnings)


def test_a_camera_that_stops_sending_is_told():
    with Served(connect=0.7) as it:
        it.woken.wait(lambda: it.woken.count >= 3)
        it.server.frozen.set()
        problems = it.camera.check().problems
        assert problems == (f"no picture comes from {it.server.url} any more",)


def test_a_camera_without_pictures_is_no_camera():
    clock = MonotonicClock()
    with EmulatedNetworkCamera(partial(rendered().picture, standing), clock) as server:
        server.frozen.set()
        camera, _ = built({"type": "mjpeg", "url": server.url}, clock, connect=0.3)
        with pytest.raises(AbortError, match=r"no picture comes from http://127.*\(0.3 s\)"):
            camera.__enter__()
        camera.__exit__(None, None, None)  # again: nothing happens


@pytest.mark.parametrize(
    ("noisy", "reason"),
    [
        (False, "green is not tracked: its pose repeats to the last bit"),
        (True, "green does not move though commanded to: is a wheel stuck"),
    ],
)
def test_a_frozen_picture_stops_the_robots_within_half_a_second(tmp_path, noisy, reason):
    """`noisy`: what is in the picture stands still, but the pictures differ."""
    frozen_ns = 2 * SECOND // 3

    def driving(t_ns):
        x = np.array([900.0, 900.0, 900.0]) + 200e-9 * min(t_ns, frozen_ns)
        return Poses(x, STANDING.y, np.zeros(3))

    shown = pictures(rendered(), 40, driving)
    if not noisy:
        shown[21:] = [shown[20]] * 19
    camera, woken = built(film(tmp_path / "film.avi", shown))
    with camera:
        woken.wait(lambda: woken.count == 40)
        frames = camera.frames()
    setup = experiment().setup
    guard = Guard(replace(guard_rules(setup, LabLimits()), speeds=(200.0,) * 3))
    guard.see(frames[0])
    guard.ready()
    guard.go(frames[0].received_ns)
    for frame in frames[1:]:
        guard.sent(frame.received_ns - SECOND // 30, (200.0,) * 3, (0.0,) * 3)
        guard.see(frame)
        guard.steered(frame.received_ns)
        ruling = guard.tick(frame.received_ns)
        since_s = (frame.received_ns - frozen_ns) / SECOND
        assert since_s > 0.05 or all(ruling.moving), ruling
        assert since_s < 0.35 or not any(ruling.moving)
    assert guard.reason.startswith(reason)
