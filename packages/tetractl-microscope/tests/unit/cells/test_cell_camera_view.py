"""Tests of what the camera of cells derives from tracked cells: speeds, candidates and robots."""

import math

import numpy as np
import pytest
from testkit.microscope.needs_opencv import cv2
from tetractl_microscope.cells.camera import (
    LEARNING_PICTURES_MIN,
    MEAN_SPEED_MIN_S,
    N_LEARNING_PARTS,
    SD_FACTOR,
    CellCamera,
    CellsInView,
    LearningPictures,
)
from tetractl_microscope.cells.cell import CellBirth, SeenCell
from tetractl_microscope.cells.helix import A_ERROR, SPEED_ERROR
from tetractl_microscope.cells.identity_watch import KNOWN_PROBABILITY
from tetractl_microscope.cells.kernels.helix_steps import PATH_LENGTH, SPEED, STATE_SIZE, A
from tetractl_microscope.pictures.feed import Picture

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.spec.load import parse_spec

SPEC = """
name: dish
units: {{length: {unit}}}
arena: {{left: 0, bottom: 0, width: {width}, height: {width}}}
robots:
  - {{name: first, start: [{one}, {one}], target: [{two}, {two}], a: 4, speed: {speed}}}
  - {{name: second, start: [{two}, {two}], target: [{one}, {one}], a: 3, speed: {speed}}}
lab:
  camera:
    {{type: cells, source: {{type: file, path: none.avi}}, um_px: 2.0,
     rotation: {rotation}, learning: 0.5, mirrored: {mirrored}}}
  actuator:
    type: field
    port: nowhere
    strength_mt: 2.0
    coils: {{x: {{gain_mt_a: 2, offset_mt: 0}}, y: {{gain_mt_a: 2, offset_mt: 0}}, rotation: 0}}
    current_max_a: 2.0
    slew_max_a_s: 100
"""


def camera(rotation=0.0, unit="um", mirrored=False):
    per_um = {"um": 1.0, "mm": 1e-3}[unit]
    text = SPEC.format(
        unit=unit,
        rotation=rotation,
        mirrored=str(mirrored).lower(),
        width=2000 * per_um,
        one=400 * per_um,
        two=1200 * per_um,
        speed=300 * per_um,
    )
    experiment = parse_spec(text, "dish").experiment
    return CellCamera(experiment.lab.camera, experiment.setup, VirtualClock())


def cell(number, x=1000.0, y=800.0, heading=0.3, way_um=0.0, probability=1.0, **more):
    mean = np.zeros(STATE_SIZE)
    mean[[A, SPEED, PATH_LENGTH]] = 4.0, 310.0, way_um
    sd = np.zeros(STATE_SIZE)
    sd[[A, SPEED, PATH_LENGTH]] = 0.2, 8.0, 5.0
    return SeenCell(
        number, 10 + number, x, y, 0.0, heading, mean, sd, probability=probability, **more
    )


def view(*cells, seconds=5.0):
    return CellsInView().followed_by(cells, seconds, (0.0, 0.0))


def test_the_speed_is_the_filter_s_until_the_cell_was_seen_for_2_s():
    first = view(cell(1, way_um=700.0))
    for passed_s in (0.0, MEAN_SPEED_MIN_S):
        now = first.followed_by([cell(1, way_um=700 + 250 * passed_s)], 5 + passed_s, (0, 0))
        um_s, sd_um_s = now.speed(now.cells[0])
        assert um_s == 310.0
        assert sd_um_s == pytest.approx(math.hypot(SD_FACTOR * 8.0, SPEED_ERROR * 310))
    now = first.followed_by([cell(1, way_um=700 + 250 * 2.5)], 7.5, (0, 0))
    um_s, sd_um_s = now.speed(now.cells[0])
    assert um_s == pytest.approx(250.0)
    assert sd_um_s == pytest.approx(math.hypot(SD_FACTOR * 5.0 / 2.5, SPEED_ERROR * 250))


def test_a_cell_that_was_lost_is_new_when_it_is_seen_again():
    shown = view(cell(1), cell(2))
    gone = shown.followed_by([cell(2)], 6.0, (0.0, 0.0))
    back = gone.followed_by([cell(1, way_um=90.0), cell(2)], 9.0, (0.0, 0.0))
    assert back.first_sights[11].seconds == 9.0 and back.first_sights[11].path_length_um == 90.0
    assert back.first_sights[12].seconds == 5.0
    assert back.now_s == 9.0


def test_knocks_add_up():
    moved = view(cell(1)).followed_by([cell(1)], 6.0, (4.0, -2.0))
    assert moved.followed_by([cell(1)], 7.0, (1.0, 3.0)).moved_um == (5.0, 1.0)


@pytest.mark.parametrize("unit", ["um", "mm"])
def test_candidates_are_in_the_spec_s_unit_with_the_errors_of_the_image(unit):
    cells = camera(unit=unit)
    cells._view = view(cell(3))
    per_um = {"um": 1.0, "mm": 1e-3}[unit]
    (found,) = cells.candidates()
    assert (found.number, found.a) == (3, 4.0)
    assert found.speed == pytest.approx(310 * per_um)
    assert found.speed_sd == pytest.approx(per_um * math.hypot(SD_FACTOR * 8, SPEED_ERROR * 310))
    assert found.a_sd == pytest.approx(math.hypot(SD_FACTOR * 0.2, A_ERROR * 4))
    assert (found.pose.x, found.pose.y) == pytest.approx((1000 * per_um, 800 * per_um))
    assert found.pose.heading == pytest.approx(0.3) and found.free


@pytest.mark.parametrize(
    ("more", "listed"),
    [
        ({}, True),
        ({"probability": KNOWN_PROBABILITY}, True),
        ({"probability": KNOWN_PROBABILITY - 0.001}, False),
        ({"has_blob": False}, False),
    ],
)
def test_only_cells_that_are_seen_and_certain_are_candidates(more, listed):
    cells = camera()
    cells._view = view(cell(3, **more))
    assert len(cells.candidates()) == listed


@pytest.mark.parametrize("unit", ["um", "mm"])
@pytest.mark.parametrize(
    ("x", "y", "free"),
    [
        (61.0, 1000.0, True),
        (59.0, 1000.0, False),
        (1000.0, 59.0, False),
        (1941.0, 1000.0, False),
        (1000.0, 1939.0, True),
        (1000.0, 1941.0, False),
    ],
)
def test_a_cell_within_60_um_of_the_arena_s_edge_is_not_free(unit, x, y, free):
    cells = camera(unit=unit)
    cells._view = view(cell(3, x, y))
    assert cells.candidates()[0].free == free
    assert bool(cells._near_wall(np.array([x]), np.array([y]))[0]) != free


def test_a_knock_moves_no_cell_and_a_rotated_camera_turns_headings():
    cells = camera()
    cells._view = view(cell(3)).followed_by([cell(3, 1030.0, 780.0)], 6.0, (30.0, -20.0))
    pose = cells.candidates()[0].pose
    assert (pose.x, pose.y) == pytest.approx((1000.0, 800.0))
    turned = camera(rotation=0.5)
    turned._view = view(cell(3, 1000.0, 0.0))
    pose = turned.candidates()[0].pose
    assert pose.heading == pytest.approx(0.8)
    assert (pose.x, pose.y) == pytest.approx((1000 * math.cos(0.5), 1000 * math.sin(0.5)))


def test_the_robots_are_the_nearest_cells_in_the_order_of_the_spec():
    cells = camera()
    assert cells._take_robots(view(cell(1, 390.0, 390.0))).numbers == ()
    near = view(cell(5, 1100.0, 1100.0), cell(6, 1900.0, 1900.0), cell(7, 500.0, 300.0))
    assert list(cells._take_robots(near).numbers) == [7, 5]
    later = view(cell(6, 400.0, 400.0), cell(5, 1900.0, 1900.0), cell(7, 1200.0, 1200.0))
    assert list(cells._take_robots(later).numbers) == [7, 5]
    cells.replace(0, 6)
    assert list(cells.robots) == [6, 5]


def test_a_robot_whose_cell_has_divided_is_named_until_it_is_replaced():
    cells = camera()
    shown = view(cell(5, 400.0, 400.0), cell(7, 1200.0, 1200.0))
    cells._take_robots(shown)
    assert list(cells.divided) == []
    cells._tracker._newcomers.born = [CellBirth(9, 9, 7), CellBirth(8, 8, None)]
    cells._take_robots(shown)
    assert list(cells.divided) == [1]
    cells._tracker._newcomers.born = []
    cells._take_robots(shown)
    assert list(cells.divided) == [1]
    cells.replace(1, 9)
    assert list(cells.divided) == [] and list(cells.robots) == [5, 9]


def taken(learning_s, hz, count):
    """The index of the image with which learning ends, and how many images are learned from."""
    learning = LearningPictures(learning_s)
    for k in range(count):
        pictures = learning.add(np.full((2, 2), k, np.uint8), 7 * SECOND + round(k * SECOND / hz))
        if pictures:
            return k, [int(picture[0, 0]) for picture in pictures]
    return None, []


def test_learning_takes_its_time_and_spreads_the_images_over_it():
    end, learned = taken(1.0, 60, 200)
    assert end == 60
    assert N_LEARNING_PARTS <= len(learned) <= N_LEARNING_PARTS + 1
    assert learned[0] == 0 and learned[-1] == 60
    assert np.diff(learned).min() >= 3 and np.diff(learned).max() <= 5


@pytest.mark.parametrize("hz", [2.0, 5.0])
def test_learning_waits_for_7_images_if_they_come_slowly(hz):
    end, learned = taken(1.0, hz, 100)
    assert end == LEARNING_PICTURES_MIN - 1
    assert learned == list(range(LEARNING_PICTURES_MIN))


# ---- pictures of cells that swim straight ----

HZ = 30.0
TALL = 300
WIDE = 400
FIRST = np.array([(60.0, 80.0), (40.0, 150.0), (80.0, 220.0)])
"""Columns and rows of three cells at first [px]."""
STEP_PX = 5.0


def shown(k):
    """Three cells that swim to the right, one after another 10 px up."""
    return FIRST + STEP_PX * k * np.array([1.0, 0.0])


def picture(k, random):
    grey = np.full((TALL, WIDE), 150.0)
    for x, y in shown(k) if k >= 0 else ():
        middle = round(8 * x), round(8 * y)
        cv2.ellipse(grey, middle, (8 * 13, 8 * 6), 0, 0, 360, 90.0, -1, cv2.LINE_AA, 3)
    return np.clip(grey + random.normal(0, 2, grey.shape), 0, 255).astype(np.uint8)


def watched(count=24, mirrored=False):
    """The frames of a camera that learned from an empty dish, and then sees the cells."""
    cells = camera(mirrored=mirrored)
    random = np.random.default_rng(3)
    for k in range(-18, count):
        grey = picture(k, random)
        if mirrored:
            grey = np.ascontiguousarray(grey[:, ::-1])
        cells._search(k + 19, Picture(grey, round((k + 30) * SECOND / HZ)))
    return cells, cells.frames()


@pytest.mark.parametrize("mirrored", [False, True])
def test_two_cells_are_the_robots_and_the_third_is_an_unknown_object(mirrored):
    """Starts are 400, 400 and 1200, 1200 um; the cells are at rows of 440, 300 and 160 um."""
    cells, frames = watched(mirrored=mirrored)
    whole = [frame for frame in frames if None not in frame.poses]
    assert len(whole) >= 14
    for frame in whole:
        truth = shown(frame.number - 19)
        at = np.column_stack([2 * (truth[:, 0] + 0.5), 2 * (TALL - 0.5 - truth[:, 1])])
        for pose, place in zip(frame.poses, at[[1, 0]], strict=True):
            assert math.dist((pose.x, pose.y), place) < 6
            assert abs(pose.heading) < 0.2
        (unknown,) = frame.unknown_objects
        assert math.dist((unknown.x, unknown.y), at[2]) < 6
    assert len(cells.robots) == 2


def test_frames_are_of_the_moment_of_exposure_and_each_picture_is_logged():
    cells, frames = watched(12)
    latency_ns = round(cells.section.latency * SECOND)
    for frame in frames:
        assert frame.received_ns - frame.sampled_ns == latency_ns
    assert len(cells.additions()) == len(frames)
    assert cells.additions() == []


def test_frames_in_which_other_cells_were_the_robots_are_dropped():
    cells, _ = watched(20)
    robots = list(cells.robots)
    random = np.random.default_rng(4)
    cells._search(90, Picture(picture(20, random), round(50 * SECOND / HZ)))
    cells.replace(0, 99)
    assert cells.frames() == []
    cells._search(91, Picture(picture(21, random), round(51 * SECOND / HZ)))
    (frame,) = cells.frames()
    assert frame.poses[0] is None and frame.poses[1] is not None
    assert list(cells.robots) == [99, robots[1]]


def test_the_health_names_the_scale_and_counts_the_cells():
    cells, _ = watched(20)
    health = cells._health(cells._searches.last())
    assert health.facts["scale"] == "2 um/px"
    assert health.facts["organism"] == "tetrahymena"
    assert health.facts["cells"] == "3"
