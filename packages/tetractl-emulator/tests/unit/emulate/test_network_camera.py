"""Tests of a stream of images: when they are exposed and sent, and what faults make of them."""

import numpy as np
import pytest
from testkit.emulator.acting import act
from testkit.microscope.needs_opencv import cv2
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.pictures.memory_camera import MemoryCamera
from tetractl_emulator.pictures.network_camera import (
    BOUNDARY,
    SPOILT,
    PictureStream,
    coded,
    part,
    url_at,
)
from tetractl_emulator.virtual_lab import LabClock
from tetractl_microscope.pictures.multipart import Multipart

from tetractl.core.clock import MILLISECOND, SECOND

RATE_HZ = 25.0
PERIOD_NS = 40 * MILLISECOND


def image(exposed_ns):
    """An image that shows its exposure's number as its grey level."""
    return np.full((16, 24), 4 * (exposed_ns // PERIOD_NS % 50), np.uint8)


def number(jpeg):
    """The number of the exposure of such an image."""
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    return round(float(picture.mean()) / 4)


def stream(**more):
    acting = ActingFaults()
    return PictureStream(image, RATE_HZ, acting=acting, **more), acting


class Reader:
    """An emulated camera in memory, entered at 5 ms, and the images that a program reads."""

    def __init__(self, **more):
        self.stream, self.acting = stream(**more)
        self.clock = LabClock()
        self.clock.sleep_until(5 * MILLISECOND)
        self.shown_ns = []
        self.came = []
        self.camera = MemoryCamera(self.stream, self.clock, 8080, self.shown_ns.append)
        self.camera.__enter__()

    def take(self, jpeg):
        self.came.append((self.clock.true_ns, number(jpeg)))

    def read_until(self, ms):
        self.clock.sleep_until(ms * MILLISECOND)
        return [k for _, k in self.came]


def test_the_middle_of_exposure_k_is_k_periods_after_the_beginning():
    made, _ = stream()
    assert [made.middle_ns(k) for k in (0, 1, 25)] == [0, PERIOD_NS, SECOND]
    assert PictureStream(image, 30.0).middle_ns(1) == 33_333_333
    assert stream(exposure_s=0.01)[0].half_ns == 5 * MILLISECOND


def test_images_are_late_by_the_latency_and_by_all_faults_together():
    made, acting = stream(latency_s=0.02)
    assert made.latency_ns == 20 * MILLISECOND
    first = act(acting, "late_pictures", by=0.5)
    act(acting, "late_pictures", by=0.25)
    assert made.latency_ns == 770 * MILLISECOND
    due = made.drawn_part(SECOND)
    assert (due.exposed_ns, due.due_ns) == (SECOND, SECOND + 770 * MILLISECOND)
    acting.remove(first)
    assert made.latency_ns == 270 * MILLISECOND


def test_a_camera_may_send_every_nth_image_or_none():
    made, acting = stream()
    assert not any(made.withholds(k) for k in range(10))
    third = act(acting, "half_rate", every=3)
    assert [k for k in range(10) if not made.withholds(k)] == [0, 3, 6, 9]
    act(acting, "half_rate", every=2)
    assert [k for k in range(10) if not made.withholds(k)] == [0, 6]
    acting.remove(third)
    act(acting, "no_frames")
    assert all(made.withholds(k) for k in range(10))


def test_a_frozen_stream_repeats_the_part_before_the_fault():
    made, acting = stream()
    assert made.send(b"first") == b"first"
    frozen = act(acting, "repeat")
    assert [made.send(b"second"), made.send(b"third")] == [b"first"] * 2
    acting.remove(frozen)
    assert made.send(b"fourth") == b"fourth"


def test_a_stream_that_is_frozen_from_the_start_repeats_its_first_part():
    made, acting = stream()
    act(acting, "repeat")
    assert [made.send(b"first"), made.send(b"second")] == [b"first"] * 2


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_fraction_of_the_images_is_spoilt(share):
    made, acting = stream(seed=620917)
    act(acting, "bad_pictures", share=share, how="lost")
    lost = [made.send(b"part") for _ in range(2000)].count(b"")
    assert lost == pytest.approx(2000 * share, abs=4 * np.sqrt(2000 * share * (1 - share)))


def test_a_damaged_image_is_damaged_again_only_by_chance_when_it_is_repeated():
    made, acting = stream()
    fault = act(acting, "bad_pictures", share=1.0, how="lost")
    assert made.send(b"first") == b""
    acting.remove(fault)
    act(acting, "repeat")
    assert made.send(b"second") == b"first"


def bodies(data):
    """The bodies that our side reads from a part that another part follows, and the damaged."""
    parts = Multipart(BOUNDARY)
    return parts.feed(data + part(b"next")), parts.damaged


JPEG = coded(image(7 * PERIOD_NS))


def test_a_part_is_read_back():
    assert bodies(part(JPEG)) == ([JPEG, b"next"], 0)
    assert number(JPEG) == 7
    assert url_at(8081) == "http://127.0.0.1:8081/"


def test_the_quality_of_an_image_is_that_of_its_jpeg():
    noisy = np.random.default_rng(3).integers(0, 256, (64, 64), dtype=np.uint8)
    assert len(coded(noisy, 20)) < len(coded(noisy, 90)) < len(coded(noisy, 100))


def test_each_way_of_damage_does_what_it_says():
    whole = part(JPEG)
    assert SPOILT["lost"](whole) == b""
    assert bodies(SPOILT["doubled"](whole)) == ([JPEG, JPEG, b"next"], 0)
    cut = SPOILT["cut"](whole)
    assert whole.startswith(cut)
    assert abs(len(cut) - len(whole) / 2) < 1
    assert JPEG not in bodies(cut)[0]
    (short, _), damaged = bodies(SPOILT["cut_ended"](whole))
    assert damaged == 0
    assert JPEG.startswith(short[:-2])
    assert abs(len(short[:-2]) - len(JPEG) / 2) < 2
    assert short.endswith(b"\xff\xd9")


def test_an_oversized_image_states_a_size_that_it_has_not():
    whole = part(JPEG)
    changed = SPOILT["oversized"](whole)
    assert len(changed) == len(whole)
    size_at = whole.index(b"\xff\xc0") + 5
    assert changed[size_at : size_at + 4] == b"\x7f\xff\x7f\xff"
    assert whole[size_at : size_at + 4] == bytes((0, 16, 0, 24))  # rows, columns
    assert changed.replace(b"\x7f\xff\x7f\xff", bytes((0, 16, 0, 24))) == whole
    assert SPOILT["oversized"](b"no image") == b"no image"


def test_an_image_comes_once_its_exposure_and_its_latency_are_over():
    reader = Reader(exposure_s=0.01, latency_s=0.02)
    reader.camera.join(reader.take)
    assert reader.read_until(130) == [0, 1, 2]
    middles_ms = [5, 45, 85]
    assert [at_ns // MILLISECOND for at_ns, _ in reader.came] == [ms + 20 for ms in middles_ms]
    assert reader.shown_ns == [ms * MILLISECOND for ms in middles_ms]


def test_an_image_with_a_long_exposure_comes_at_the_end_of_its_exposure():
    reader = Reader(exposure_s=0.03)
    reader.camera.join(reader.take)
    reader.read_until(110)
    assert [at_ns // MILLISECOND for at_ns, _ in reader.came] == [20, 60, 100]


def test_nothing_is_drawn_while_nobody_reads_and_exposures_go_on():
    reader = Reader()
    assert not reader.camera.watched
    assert reader.read_until(90) == []
    reader.camera.join(reader.take)
    assert reader.camera.watched
    assert reader.read_until(170) == [3, 4]
    reader.camera.interrupt()
    assert not reader.camera.watched
    assert reader.read_until(300) == [3, 4]


def test_a_camera_that_is_left_exposes_no_more():
    reader = Reader()
    reader.camera.join(reader.take)
    reader.read_until(50)
    reader.camera.__exit__()
    assert reader.read_until(300) == [0, 1]


def test_every_other_image_is_the_even_ones():
    reader = Reader()
    act(reader.acting, "half_rate", every=2)
    reader.camera.join(reader.take)
    assert reader.read_until(250) == [1, 3, 5]


def test_a_damaged_image_shows_nobody_and_is_counted_since_the_reader_came():
    reader = Reader()
    reader.camera.join(reader.take)
    reader.read_until(50)
    fault = act(reader.acting, "bad_pictures", share=1.0, how="cut")
    reader.read_until(130)
    reader.acting.remove(fault)
    reader.read_until(210)
    assert reader.shown_ns == [(5 + 40 * k) * MILLISECOND for k in (0, 1, 4, 5)]
    assert reader.camera.damaged > 0
    reader.camera.join(reader.take)
    assert reader.camera.damaged == 0


def test_a_doubled_image_comes_twice():
    reader = Reader()
    act(reader.acting, "bad_pictures", share=1.0, how="doubled")
    reader.camera.join(reader.take)
    reader.read_until(100)
    assert [k for _, k in reader.came] == [0, 0, 1, 1, 2, 2]


def test_images_exposed_while_the_program_was_suspended_come_afterwards_in_their_order():
    reader = Reader()
    timeline = Timeline(lambda when_ns: None)
    reader.clock.set_emulation(timeline, acting=reader.acting)
    reader.camera.join(reader.take)
    suspended = act(reader.acting, "stopped")
    timeline.at(500 * MILLISECOND, lambda: reader.acting.remove(suspended))
    assert reader.read_until(500) == [0]
    assert reader.read_until(515) == [*range(13)]
    assert reader.came[0][0] == 500 * MILLISECOND
    assert reader.shown_ns == [(5 + 40 * k) * MILLISECOND for k in range(13)]
