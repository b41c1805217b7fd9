"""Tests of synthetic images of tags: where OpenCV finds points, and how bright they are."""

import math
from dataclasses import replace

import numpy as np
import pytest
from testkit.microscope.needs_opencv import cv2
from tetractl_emulator.pictures.apriltag.side import (
    BLACK,
    FLOOR,
    MODULE_PX,
    WHITE,
    Optics,
    Renderer,
    texture,
)
from tetractl_microscope.apriltag.section import FloorTag, RobotTag

from tetractl.core.clock import SECOND
from tetractl.core.poses import Poses

MM = 1e-3
CARD_MM = 100.0  # a tag of 80 mm with its margin: 8 modules and 2
CORNERS = ((100, 100), (900, 100), (900, 700), (100, 700))
FLOOR_TAGS = [FloorTag(tag=100 + number, at=at, size_mm=80.0) for number, at in enumerate(CORNERS)]
SLANTED = Optics(640, 480, 600.0, (0.2, -0.3, 1.1), (0.4, 0.35, 0.0))
ABOVE = Optics(600, 500, 1000.0, (0.5, 0.4, 2.0), (0.5, 0.4, 0.0), noise=0.0, blur_px=0.0)
"""A camera straight above the floor, at half a pixel per mm."""


def renderer(robots=(), floor=(), seed=0, **optics):
    return Renderer(robots, floor, MM, replace(ABOVE, **optics), seed)


def at(*places):
    poses = np.array(places, dtype=float).reshape(-1, 3)
    return lambda _: Poses.from_array(poses)


def pixel(x_mm, y_mm):
    """The column and row of a place on the floor, for the camera straight above."""
    return round(299.5 + (x_mm - 500) / 2), round(249.5 - (y_mm - 400) / 2)


def test_points_are_projected_as_opencv_does():
    points = np.random.default_rng(2).uniform((0, 0, 0), (1, 0.8, 0.2), (30, 3))
    turn, _ = cv2.Rodrigues(SLANTED.axes)
    shift = -SLANTED.axes @ np.array(SLANTED.position)
    expected, _ = cv2.projectPoints(points, turn, shift, SLANTED.matrix, np.zeros(5))
    assert SLANTED.project(points) == pytest.approx(expected[:, 0], abs=1e-6)
    assert SLANTED.axes @ SLANTED.axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(SLANTED.axes) == pytest.approx(1.0)
    assert SLANTED.project(np.array([SLANTED.target]))[0] == pytest.approx((319.5, 239.5))


@pytest.mark.parametrize("tilt", [0.0, 0.35, 0.7])
def test_a_camera_that_faces_the_floor_sees_all_tags_and_hardly_more(tilt):
    optics = Optics.facing(FLOOR_TAGS, MM, 640, 480, tilt)
    corners = np.array([(x * MM, y * MM, 0.0) for x, y in CORNERS])
    pixels = optics.project(corners)
    assert (pixels > 0).all()
    assert (pixels < (640, 480)).all()
    assert (np.ptp(pixels, axis=0) > (0.5 * 640, 0.4 * 480)).any()
    reach = 0.06  # 0.75 times the size of a card, around the outermost tags
    low, high = corners.min(axis=0)[:2] - reach, corners.max(axis=0)[:2] + reach
    outer = np.array([(x, y, 0.0) for x in (low[0], high[0]) for y in (low[1], high[1])])
    seen = optics.project(outer)
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    assert middle == pytest.approx((319.5, 239.5), abs=0.5)
    x, y, height = optics.position  # over the middle of the tags, which it sees at the tilt
    assert x == pytest.approx(0.5)
    assert math.atan2(0.4 - y, height) == pytest.approx(tilt)
    forward = np.subtract(optics.target, optics.position)
    assert math.acos(-forward[2] / np.linalg.norm(forward)) == pytest.approx(tilt, abs=0.12)


def test_the_card_of_a_robot_stands_at_its_place_turned_by_its_heading():
    robot = RobotTag(name="green", tag=3, size_mm=80.0, height_mm=50.0, heading_offset=0.3)
    pose = (620.0, 310.0, 1.1)
    corners = renderer([robot]).card(robot, at(pose)(0), 0)
    half = CARD_MM / 2 * MM
    expected = []
    for along, aside in ((-half, half), (half, half), (half, -half), (-half, -half)):
        turn = 1.1 - 0.3
        x = 0.62 + along * math.cos(turn) - aside * math.sin(turn)
        y = 0.31 + along * math.sin(turn) + aside * math.cos(turn)
        scale = 1000.0 / (2.0 - 0.05)
        expected.append((299.5 + (x - 0.5) * scale, 249.5 - (y - 0.4) * scale))
    assert corners == pytest.approx(np.array(expected), abs=1e-6)


def test_the_empty_floor_is_lighter_on_one_side():
    picture = renderer().picture(at(), 0).astype(float)
    assert picture[:, 0] == pytest.approx(np.full(500, FLOOR * 0.92), abs=1)
    assert picture[:, -1] == pytest.approx(np.full(500, FLOOR * 1.06), abs=1)
    brighter = renderer(gain=1.2).picture(at(), 0).astype(float)
    assert brighter.mean() == pytest.approx(1.2 * picture.mean(), abs=1)


def test_a_tag_has_a_white_margin_and_black_modules_at_its_place():
    robot = RobotTag(name="green", tag=3, size_mm=80.0, height_mm=0.0)
    scene = renderer([robot], FLOOR_TAGS)
    picture = scene.picture(at((400.0, 400.0, 0.0)), 0)
    for x, y in ((400, 400), *CORNERS):
        column, row = pixel(x - 45, y)  # in the margin, left of the black frame
        assert picture[row, column] == pytest.approx(WHITE, abs=3)
        column, row = pixel(x - 35, y)
        assert picture[row, column] == pytest.approx(BLACK, abs=3)
        column, row = pixel(x - 56, y)
        assert picture[row, column] == pytest.approx(FLOOR, abs=15)


def test_a_hidden_tag_is_not_drawn_and_a_stray_one_is():
    robot = RobotTag(name="green", tag=3, size_mm=80.0, height_mm=0.0)
    scene = renderer([robot], FLOOR_TAGS)
    shown = scene.picture(at((400.0, 400.0, 0.0)), 0)
    scene.hidden = {3, 100}
    without = scene.picture(at((400.0, 400.0, 0.0)), 0)
    places = {}
    for name, (x, y) in {"robot": (400, 400), "first": CORNERS[0], "second": CORNERS[1]}.items():
        column, row = pixel(x - 35, y)
        places[name] = (shown[row, column] < 60, without[row, column] < 60)
    assert places == {"robot": (True, False), "first": (True, False), "second": (True, True)}
    scene.strays = [FloorTag(tag=7, at=(600, 500), size_mm=80.0)]
    column, row = pixel(565, 500)
    assert without[row, column] > 100
    assert scene.picture(at((400.0, 400.0, 0.0)), 0)[row, column] < 60


def test_a_robot_that_moves_is_smeared_along_its_way_over_the_exposure():
    robot = RobotTag(name="green", tag=3, size_mm=80.0, height_mm=0.0)
    scene = renderer([robot], exposure_s=0.1)

    def drives(time_ns):
        return Poses.from_array(np.array([[400.0 + 400.0 * (time_ns / SECOND - 1.0), 400.0, 0.0]]))

    moved = scene.picture(drives, SECOND).astype(float)  # 40 mm in the exposure
    still = scene.picture(at((400.0, 400.0, 0.0)), SECOND).astype(float)
    column, row = pixel(400 - 60, 400)  # outside the card, but within the smear
    assert still[row, column] == pytest.approx(FLOOR * 0.97, abs=5)
    assert moved[row, column] > still[row, column] + 5
    left = np.abs(moved - renderer().picture(at(), 0))[row].nonzero()[0]
    middle, _ = pixel(400, 400)
    assert left.min() == pytest.approx(middle - 25 - 10, abs=3)
    assert left.max() == pytest.approx(middle + 25 + 10, abs=3)


def test_noise_has_its_deviation_and_is_new_in_each_picture():
    scene = renderer(noise=4.0, seed=5)
    first, second = (scene.picture(at(), 0).astype(float) for _ in range(2))
    clean = renderer().picture(at(), 0).astype(float)
    assert (first - clean).std() == pytest.approx(4.0, rel=0.05)
    assert (first != second).mean() > 0.5
    again = renderer(noise=4.0, seed=5).picture(at(), 0)
    assert (again == first).all()


def test_a_texture_has_a_module_of_margin_and_whole_modules():
    card = texture(3)
    assert card.shape[0] == card.shape[1] == 10 * MODULE_PX
    assert (card[..., 1] == 1).all()
    assert set(np.unique(card[..., 0])) == {BLACK, WHITE}
    assert (card[:MODULE_PX, :, 0] == WHITE).all()
    assert (card[MODULE_PX, MODULE_PX:-MODULE_PX, 0] == BLACK).all()
