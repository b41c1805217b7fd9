"""Tests of what cameras of images share: remembered scenes, and which bodies were shown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.emulator.device_specs import APRILTAG_SPEC
from testkit.emulator.lab_processes import emulated
from testkit.emulator.virtual_lab import virtual_dish, virtual_lab
from testkit.microscope.needs_opencv import cv2
from tetractl_emulator.pictures.stream_side import SceneHistory, ShownBodies

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import SpecError

assert cv2


def history(*scenes):
    made = SceneHistory()
    for time_ns, scene in scenes:
        made.add(time_ns, np.array(scene, float))
    return made


@given(when_ns=st.integers(-50, 450), slope=st.floats(-3, 3))
def test_a_scene_between_two_is_interpolated_and_one_outside_is_the_nearest(when_ns, slope):
    scenes = [(time_ns, [slope * time_ns, 7.0]) for time_ns in (0, 100, 150, 400)]
    expected = slope * min(max(when_ns, 0), 400)
    assert history(*scenes).at(when_ns) == pytest.approx([expected, 7.0], abs=1e-9)


def test_one_scene_is_the_scene_of_all_times():
    made = history((5, [1.0, 2.0]))
    for when_ns in (0, 5, 900):
        assert made.at(when_ns).tolist() == [1.0, 2.0]


def test_a_cell_that_has_just_divided_appears_at_the_second_of_two_scenes():
    made = history((0, [[0.0, 10.0]]), (10, [[1.0, 12.0, 12.0]]), (20, [[2.0, 14.0, 15.0]]))
    assert made.at(5).tolist() == [[0.5, 11.0]]
    assert made.at(15).tolist() == [[1.5, 13.0, 13.5]]


def test_the_newest_200_scenes_are_remembered():
    made = history(*((k, [float(k)]) for k in range(250)))
    assert made.at(60).tolist() == [60.0]
    assert made.at(0).tolist() == [50.0]


def test_a_body_was_last_shown_by_the_newest_image_that_came_and_has_it():
    shown = ShownBodies(2)
    shown.expose(100, [True, True])
    shown.expose(200, [True, False])
    shown.expose(300, [False, False])
    assert shown.newest_ns == [0, 0]
    shown.come(100, 5000)
    assert shown.newest_ns == [5100, 5100]
    shown.come(200, 5000)
    shown.come(300, 5000)
    assert shown.newest_ns == [5200, 5100]


def test_an_image_that_comes_twice_or_after_a_lost_one_counts():
    shown = ShownBodies(1)
    for exposed_ns in (100, 200, 300):
        shown.expose(exposed_ns, [True])
    shown.come(200, 0)  # that of 100 was lost
    shown.come(200, 0)
    assert shown.newest_ns == [200]
    shown.come(300, 0)
    assert shown.newest_ns == [300]


@pytest.fixture
def dish():
    with virtual_dish(None) as lab:
        yield lab


def seen_by(lab):
    """Let our side read the images of the emulated camera; return how many have come."""
    images = []
    lab.emulation.camera.join(images.append)
    return images


def ages_s(lab):
    """For how long each body was not shown [s]."""
    return [(lab.clock.true_ns - at_ns) / SECOND for at_ns in lab.emulation.camera.shown_ns]


@pytest.mark.slow
def test_exposures_come_at_the_rate_and_images_after_the_latency_unless_robots_are_carried(dish):
    camera = dish.emulation.camera
    images = seen_by(dish)
    began_s = dish.clock.true_ns / SECOND
    dish.clock.sleep_until(dish.clock.now() + SECOND // 3)
    assert len(images) == pytest.approx(camera.pictures.rate_hz / 3, abs=3)
    period_s = 1 / camera.pictures.rate_hz
    latency_s = camera.pictures.latency_ns / SECOND
    for age_s in ages_s(dish):
        assert latency_s <= age_s <= latency_s + period_s + 2 * MILLISECOND / SECOND
    dish.emulation.injector.acting.robots_are_carried = True
    dish.clock.sleep_until(dish.clock.now() + SECOND // 3)
    assert min(ages_s(dish)) > 0.3
    ran_s = began_s + 2 / 3
    assert camera.close()["pictures"] == pytest.approx(ran_s * camera.pictures.rate_hz, abs=2)


DEVICE = "lab.camera.source={type: device}"
FILM = "lab.camera.source={type: file, path: film.avi}"


def test_over_http_only_a_stream_can_be_emulated(tmp_path):
    for source in (DEVICE, FILM):
        with pytest.raises(SpecError, match="cannot be emulated"):
            emulated(tmp_path, source, spec=APRILTAG_SPEC)


@pytest.mark.slow
def test_in_memory_a_connected_camera_can_be_emulated_too_but_no_film():
    with virtual_dish(None, sets=[DEVICE]) as lab:
        assert lab.emulation.camera.camera.port == 0
    with (
        pytest.raises(SpecError, match="type file cannot be emulated"),
        virtual_dish(None, sets=[FILM]),
    ):
        pass


def test_a_stream_in_memory_has_the_address_of_the_spec():
    with virtual_lab(None, spec=APRILTAG_SPEC) as lab:
        assert lab.emulation.camera.camera.url == "http://127.0.0.1:8080/"
