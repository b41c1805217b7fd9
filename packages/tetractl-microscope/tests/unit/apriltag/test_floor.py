"""Tests of the calibration by floor tags, for a camera with known pose and lens."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit.microscope.needs_opencv import cv2
from tetractl_microscope.apriltag.floor import (
    IMAGES_AVERAGED_MAX,
    MISFIT_MM,
    MOVED_PX,
    Floor,
    calibrate_camera,
    compute_floor_corners,
)
from tetractl_microscope.apriltag.section import FloorTag, Lens

MM = 1e-3
SIZE = (1280, 960)
FOCAL_PX = 1100.0
MIDDLE = (639.5, 479.5)
AT = ((200, 200), (1800, 250), (1750, 1400), (250, 1350), (1000, 800))
TAGS = [
    FloorTag(tag=50 + number, at=at, size_mm=120.0, heading=0.4 * number)
    for number, at in enumerate(AT)
]
PLACES = np.array([compute_floor_corners(tag, MM) for tag in TAGS])
LENS = Lens(focal_px=FOCAL_PX)


def camera(position=(1.0, -0.4, 2.2), target=(1.0, 0.8, 0.0), focal_px=FOCAL_PX, bend=0.0):
    """Return a function from points (..., 3) [m] to pixels of a camera that looks at a target."""
    forward = np.subtract(target, position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    turn, _ = cv2.Rodrigues(rotation)
    matrix = np.array([[focal_px, 0, MIDDLE[0]], [0, focal_px, MIDDLE[1]], [0, 0, 1.0]])
    shift = -rotation @ np.array(position)

    def pixels(points):
        flat = np.asarray(points, float).reshape(-1, 3)
        seen, _ = cv2.projectPoints(flat, turn, shift, matrix, np.array([bend, 0, 0, 0.0]))
        return seen.reshape(*np.shape(points)[:-1], 2)

    return pixels


def on_floor(places, height=0.0):
    return np.concatenate([places, np.full((*places.shape[:-1], 1), height)], axis=-1)


def seen_by(pixels):
    return {tag.tag: corners for tag, corners in zip(TAGS, pixels(on_floor(PLACES)), strict=True)}


@given(st.floats(-math.pi, math.pi), st.floats(10, 300))
def test_a_floor_tag_is_a_square_at_its_place_read_in_its_direction(heading, size_mm):
    top_left, top_right, low_right, low_left = compute_floor_corners(
        FloorTag(tag=1, at=(300, 500), size_mm=size_mm, heading=heading), MM
    )
    middle = (top_left + low_right) / 2
    assert middle == pytest.approx((0.3, 0.5))
    reading = np.array([math.cos(heading), math.sin(heading)])
    upwards = np.array([-math.sin(heading), math.cos(heading)])
    assert top_right - top_left == pytest.approx(size_mm * MM * reading, abs=1e-12)
    assert low_right - low_left == pytest.approx(size_mm * MM * reading, abs=1e-12)
    assert top_left - low_left == pytest.approx(size_mm * MM * upwards, abs=1e-12)


@given(
    x=st.floats(0.3, 1.7),
    y=st.floats(0.3, 1.3),
    height=st.floats(0.0, 0.2),
    away=st.tuples(st.floats(-0.8, 0.8), st.floats(-1.2, 0.5), st.floats(1.6, 3.0)),
)
@settings(max_examples=25)
def test_with_a_known_lens_places_at_any_height_are_found(x, y, height, away):
    pixels = camera(position=(1.0 + away[0], 0.8 + away[1], away[2]))
    plane = calibrate_camera(pixels(on_floor(PLACES)), PLACES, SIZE, LENS)
    seen = pixels(np.array([[x, y, height]]))
    assert plane.locate(seen, height) == pytest.approx(np.array([[x, y]]), abs=2e-4)
    assert plane.camera_height_mm == pytest.approx(1000 * away[2], abs=1.0)
    assert plane.focal_px == FOCAL_PX
    assert plane.error_max_mm < 0.1
    assert plane.lens_error_mm == 0.0


@pytest.mark.parametrize(("focal_px", "bend"), [(900.0, 0.0), (1100.0, -0.15), (1400.0, 0.05)])
def test_an_unknown_lens_is_fitted_to_a_slanted_view(focal_px, bend):
    pixels = camera(focal_px=focal_px, bend=bend)
    plane = calibrate_camera(pixels(on_floor(PLACES)), PLACES, SIZE, None, 0.1)
    assert plane.focal_px == pytest.approx(focal_px, rel=0.02)
    assert plane.distortion[0] == pytest.approx(bend, abs=0.03)
    assert plane.error_mm < 0.3
    assert plane.error_mm <= plane.error_max_mm
    assert 0 < plane.lens_error_mm < 10
    seen = pixels(np.array([[0.9, 0.7, 0.1]]))
    assert plane.locate(seen, 0.1) == pytest.approx(np.array([[0.9, 0.7]]), abs=2e-3)


def test_straight_down_a_lens_is_in_doubt_above_the_floor_alone():
    pixels = camera(position=(1.0, 0.8, 2.2))
    on_the_floor = calibrate_camera(pixels(on_floor(PLACES)), PLACES, SIZE, None, 0.0)
    above = calibrate_camera(pixels(on_floor(PLACES)), PLACES, SIZE, None, 0.1)
    assert on_the_floor.lens_error_mm < 2.0
    assert above.lens_error_mm > 5 * on_the_floor.lens_error_mm


def floor():
    return Floor(TAGS, MM, LENS, 100.0)


def test_a_floor_is_calibrated_once_a_picture_shows_all_tags_and_stays_so():
    calibration = floor()
    corners = seen_by(camera())
    some = {number: corners[number] for number in list(corners)[:-1]}
    calibration.update(some, SIZE)
    assert calibration.plane is None
    calibration.update(corners, SIZE)
    plane = calibration.plane
    assert plane.error_max_mm < 0.1
    assert calibration.misfit is None
    calibration.update(some, SIZE)
    calibration.update({}, SIZE)
    assert calibration.plane is plane


@pytest.mark.parametrize(("off_mm", "fits"), [(MISFIT_MM / 3, True), (MISFIT_MM * 3, False)])
def test_a_tag_that_is_not_where_the_spec_says_is_a_misfit(off_mm, fits):
    calibration = floor()
    moved = on_floor(PLACES)
    moved[4, :, 0] += off_mm * MM
    pixels = camera()(moved)
    calibration.update({tag.tag: pixels[i] for i, tag in enumerate(TAGS)}, SIZE)
    assert (calibration.plane is not None) == fits
    assert (calibration.misfit is not None) == (not fits)


@pytest.mark.parametrize(("by_px", "kept"), [(0.8 * MOVED_PX, True), (1.3 * MOVED_PX, False)])
def test_a_camera_or_a_tag_that_was_moved_discards_the_calibration(by_px, kept):
    calibration = floor()
    corners = seen_by(camera())
    calibration.update(corners, SIZE)
    moved = {50: corners[50] + [[by_px, 0.0]]}  # one tag is enough, whatever else is hidden
    calibration.update(moved, SIZE)
    assert (calibration.plane is not None) == kept
    calibration.update(seen_by(camera(position=(1.1, -0.4, 2.2))), SIZE)
    assert calibration.plane is not None


def test_the_noise_of_corners_is_averaged():
    rng = np.random.default_rng(3)
    corners = seen_by(camera())
    calibration = floor()
    errors = []
    for _ in range(32):
        noisy = {number: c + rng.normal(0, 0.5, (4, 2)) for number, c in corners.items()}
        calibration.update(noisy, SIZE)
        errors.append(calibration.plane.error_mm)
    assert errors[-1] < 0.4 * errors[0]


def test_the_corners_of_a_calibration_are_the_mean_of_the_pictures():
    rng = np.random.default_rng(5)
    corners = seen_by(camera())
    calibration = Floor(TAGS, MM, None, 100.0)
    pictures = []
    for count in range(1, 5):
        noisy = {number: c + rng.normal(0, 0.5, (4, 2)) for number, c in corners.items()}
        pictures.append([noisy[tag.tag] for tag in TAGS])
        calibration.update(noisy, SIZE)
        if count in (1, 2, 4):
            expected = calibrate_camera(np.mean(pictures, axis=0), PLACES, SIZE, None, 0.1)
            assert calibration.plane.error_mm == pytest.approx(expected.error_mm, rel=1e-3)
            assert calibration.plane.lens_error_mm == pytest.approx(
                expected.lens_error_mm, rel=1e-3
            )
            assert calibration.plane.translation == pytest.approx(expected.translation, rel=1e-6)


def test_a_camera_that_looks_straight_down_does_not_know_its_lens():
    """A robot 300 mm above the floor would be located tens of mm off; one on the floor not."""
    down = camera(position=(1.0, 0.8, 2.2), target=(1.0, 0.801, 0.0))
    slanted = camera(position=(1.0, -0.4, 2.2))
    seen = down(on_floor(PLACES))
    high = calibrate_camera(seen, PLACES, SIZE, None, 0.3)
    low = calibrate_camera(seen, PLACES, SIZE, None, 0.0)
    assert 10.0 < high.lens_error_mm < 500.0
    assert low.lens_error_mm < high.lens_error_mm / 3
    known = calibrate_camera(slanted(on_floor(PLACES)), PLACES, SIZE, None, 0.3)
    assert known.lens_error_mm < high.lens_error_mm / 3


def test_the_errors_of_the_floor_are_those_of_its_tags():
    pixels = camera()(on_floor(PLACES))
    moved = PLACES.copy()
    moved[2] += (0.02, 0.0)
    plane = calibrate_camera(pixels, moved, SIZE, LENS)
    off_mm = 1000 * np.linalg.norm(plane.locate(pixels) - moved, axis=-1)
    assert plane.error_max_mm == pytest.approx(off_mm.max())
    assert plane.error_mm == pytest.approx(np.sqrt(np.mean(off_mm**2)))
    assert 5.0 < plane.error_max_mm < 20.0


def test_corners_are_averaged_and_the_calibration_follows_the_mean():
    """It is repeated after 1, 2, 4, 8 and 16 images, and then after each 32."""
    floor = Floor(TAGS, MM, LENS, 0.0)
    exact = seen_by(camera())
    planes = []
    for k in range(3 * IMAGES_AVERAGED_MAX):
        sign = 1 if k % 2 else -1
        floor.update({tag: corners + sign * 1.0 for tag, corners in exact.items()}, SIZE)
        planes.append(id(floor.plane))
    changes = [k + 1 for k in range(len(planes)) if k == 0 or planes[k] != planes[k - 1]]
    assert changes == [1, 2, 4, 8, 16, 32, 64, 96]
    point = np.array([[0.9, 0.7, 0.0]])
    assert floor.plane.locate(camera()(point)) == pytest.approx(point[:, :2], abs=2e-4)


@pytest.mark.parametrize(("moved_px", "calibrated_still"), [(2.9, True), (3.1, False)])
def test_a_floor_tag_that_moves_ends_the_calibration(moved_px, calibrated_still):
    floor = Floor(TAGS, MM, LENS, 0.0)
    exact = seen_by(camera())
    floor.update(exact, SIZE)
    some = {52: exact[52] + np.array([0.0, -moved_px])}
    floor.update(some, SIZE)
    assert (floor.plane is not None) is calibrated_still
    floor.update({}, SIZE)
    assert (floor.plane is not None) is calibrated_still
    floor.update(exact, SIZE)
    assert floor.plane is not None
