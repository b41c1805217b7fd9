"""Tests of poses from rendered images against the emulated truth."""

import math

import numpy as np
import pytest
from testkit.microscope.needs_opencv import finds_small_tags
from testkit.microscope.tag_scene import (
    FLOOR,
    LARGE,
    SMALL,
    STANDING,
    errors,
    look,
    rendered,
    tracker,
)
from tetractl_microscope.apriltag.section import FloorTag

from tetractl.core.poses import Poses

pytestmark = pytest.mark.slow


def off(looked, i=0, truth=STANDING):
    pose = looked.poses[i]
    return math.hypot(pose.x - truth.x[i], pose.y - truth.y[i])


@pytest.mark.long
@finds_small_tags
@pytest.mark.parametrize(
    ("size", "mm", "mm_95", "rad", "rad_95"),
    [(SMALL, 0.6, 1.5, 0.005, 0.02), (LARGE, 0.3, 0.7, 0.002, 0.006)],
)
def test_poses_are_right(size, mm, mm_95, rad, rad_95):
    distances, angles, lost = errors(tracker(), rendered(size), pictures=40)
    assert lost <= 0.02
    assert np.median(distances) < mm
    assert np.quantile(distances, 0.95) < mm_95
    assert np.median(angles) < rad
    assert np.quantile(angles, 0.95) < rad_95


@pytest.mark.long
@finds_small_tags
def test_poses_are_right_from_jpeg_in_bad_light_and_of_moving_robots():
    renderer = rendered(LARGE, gain=0.5, noise=4.0, exposure_s=0.01)
    speed = np.array([180.0, 200.0, 150.0])

    def moving(t_ns):
        t = t_ns * 1e-9
        x = STANDING.x + t * speed * np.cos(STANDING.heading)
        y = STANDING.y + t * speed * np.sin(STANDING.heading)
        return Poses(x, y, STANDING.heading + 2.0 * t)

    mine = tracker()
    distances = []
    for k in range(10):
        time_ns = k * 33_000_000
        looked = mine.track_image(renderer.picture(moving, time_ns))
        distances += [off(looked, i, moving(time_ns)) for i in range(3)]
    assert np.median(distances) < 1.0
    assert max(distances) < 3.0


def test_tilted_the_focal_length_is_found():
    renderer = rendered(LARGE)
    mine = tracker()
    look(mine, renderer, times=8)
    assert mine.floor.plane.focal_px == pytest.approx(renderer.optics.focal_px, rel=0.005)
    assert mine.floor.plane.lens_error_mm < 1.5


@pytest.mark.long
@pytest.mark.parametrize("bend", [-0.2, 0.05])
def test_the_bend_of_a_simple_lens_is_found_from_the_floor(bend):
    renderer = rendered(LARGE, distortion=(bend, 0.0, 0.0, 0.0))
    mine = tracker()
    right, _, _ = errors(mine, renderer, pictures=10)
    assert np.median(right) < 0.5
    assert mine.floor.plane.distortion[0] == pytest.approx(bend, abs=0.02)
    straight = {"focal_px": renderer.optics.focal_px}
    wrong, _, _ = errors(tracker(lens=straight), renderer, pictures=10)
    assert np.median(wrong) > 2.0


def test_nothing_is_tracked_before_all_floor_tags_were_seen_at_once():
    mine = tracker()
    renderer = rendered()
    renderer.hidden = {102}
    assert look(mine, renderer).poses == (None, None, None)
    renderer.hidden = {101}
    assert look(mine, renderer).poses == (None, None, None)
    renderer.hidden = set()
    assert None not in look(mine, renderer).poses
    renderer.hidden = {100, 101, 102, 103}
    looked = look(mine, renderer)
    assert None not in looked.poses
    assert off(looked) < 2.0


def test_a_camera_that_is_moved_is_calibrated_again_but_not_by_part_of_the_floor():
    mine = tracker()
    renderer = rendered()
    look(mine, renderer, times=3)
    x, y, z = renderer.optics.position
    moved = rendered(position=(x + 0.1, y, z))
    moved.hidden = {103}
    assert look(mine, moved).poses == (None, None, None)
    moved.hidden = set()
    assert off(look(mine, moved)) < 2.0


def test_a_floor_that_does_not_fit_the_spec_is_not_used():
    crossed = (FLOOR[0], FLOOR[2].model_copy(update={"tag": 101}), FLOOR[1], FLOOR[3])
    crossed = (*crossed[:2], crossed[2].model_copy(update={"tag": 102}), crossed[3])
    mine = tracker(floor=crossed)
    assert look(mine, rendered()).poses == (None, None, None)
    assert mine.floor.misfit.error_max_mm > 10.0


def test_a_number_seen_twice_is_no_robot_and_no_stranger():
    mine = tracker()
    renderer = rendered()
    renderer.strays = [FloorTag(tag=0, at=(1900, 900), size_mm=100)]
    looked = look(mine, renderer)
    assert looked.poses[0] is None
    assert looked.poses[1] is not None
    assert looked.unknown_objects == ()
    assert looked.tags.count(0) == 2
