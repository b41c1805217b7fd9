"""Tests of warnings about a microscope's images: light, focus and cells."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from tetractl_microscope.cells.cells_health import (
    DARK_LEVEL,
    FAINT_RATIO,
    SATURATED_LEVEL,
    SHARPNESS_MIN,
    WIDTH_MIN_PX,
    SeenDish,
    count_cells,
    describe_faint_cells,
    find_problems,
    measure_sharpness,
)
from tetractl_microscope.cells.detect_cells import Light
from tetractl_microscope.cells.identity_watch import KNOWN_PROBABILITY
from tetractl_microscope.pictures.searches import PictureSearch

from tetractl.core.poses import Pose

CONTRAST = 60.0
UM_PX = 2.3


def picture_of_a_cell(angle, blur_px):
    """A body of 52 x 26 um in the middle of a picture, out of focus, and how it is seen."""
    grey = np.full((80, 80), 160.0, np.float32)
    sides = (52.0 / UM_PX, 26.0 / UM_PX)
    rows, columns = np.indices(grey.shape)
    along = (columns - 39.5) * math.cos(angle) - (rows - 39.5) * math.sin(angle)
    across = (columns - 39.5) * math.sin(angle) + (rows - 39.5) * math.cos(angle)
    grey[(2 * along / sides[0]) ** 2 + (2 * across / sides[1]) ** 2 < 1] -= CONTRAST
    grey = cv2.GaussianBlur(grey, (0, 0), blur_px)
    middle_um = 40 * UM_PX
    cell = SimpleNamespace(x=middle_um, y=middle_um, long_um=52.0)
    return np.round(grey).astype(np.uint8), [cell]


def sharpness_of(angle, blur_px):
    return measure_sharpness(*picture_of_a_cell(angle, blur_px), UM_PX, CONTRAST)


def test_sharpness_does_not_depend_on_where_cells_swim():
    """Regression: only slopes along rows were measured, of which a body along rows has few."""
    values = [sharpness_of(angle, 1.0) for angle in np.linspace(0.0, math.pi, 9)]
    assert max(values) < 1.1 * min(values)


LIGHT = Light(gain=1.0, noise=2.0, contrast=60.0, changed_fraction=0.01, lost=False)


def searches(**changes):
    values = {
        "robots": None,  # which cells they are does not matter to what is said
        "poses": (Pose(0, 0, 0), Pose(1, 1, 0)),
        "unknown_objects": (),
        "light": LIGHT,
        "level": 120.0,
        "sharpness": 0.3,
        "certainty_min": 1.0,
    } | changes
    return [PictureSearch(k, k * 33_333_333, 5_000_000, SeenDish(**values)) for k in range(20)]


@pytest.mark.parametrize(
    ("changes", "width_px", "says"),
    [
        ({}, 11.0, ""),
        ({"level": 3.0}, 11.0, "black"),
        ({"level": 252.0}, 11.0, "saturated"),
        ({"light": Light(1, 2, None, 0.4, True)}, 11.0, "was the stage or the lamp moved"),
        (
            {"poses": (None, None)},
            11.0,
            "the camera does not track first, second: 0 cells are in view, but 2",
        ),
        (
            {"light": Light(1, 3.0, 9.0, 0.01, False, contrast_min=7.0)},
            11.0,
            "objects below 7 are missed",
        ),
        ({"light": Light(1, 3.0, None, 0.0, False, contrast_min=7.0)}, 11.0, "no object differs"),
        ({"sharpness": 0.05}, 11.0, "focus"),
        ({"certainty_min": 0.6}, 11.0, "it is uncertain which cell is which"),
        ({}, 5.2, "a cell is only 5 px wide, but at least 8 px"),
    ],
)
def test_health_says_what_is_wrong_in_words(changes, width_px, says):
    problems, warnings = find_problems(("first", "second"), searches(**changes), width_px)
    lines = [*problems, *warnings]
    assert (lines == []) if not says else any(says in line for line in lines)


@pytest.mark.parametrize(("blur_px", "is_blurred"), [(0.6, False), (2.0, False), (4.0, True)])
def test_rims_are_blurred_in_any_direction(blur_px, is_blurred):
    for angle in (0.0, 0.7, math.pi / 2):
        assert (sharpness_of(angle, blur_px) < SHARPNESS_MIN) == is_blurred


def test_no_sharpness_without_contrast_or_without_cells():
    picture, cells = picture_of_a_cell(0.0, 1.0)
    assert measure_sharpness(picture, cells, UM_PX, None) is None
    assert measure_sharpness(picture, [], UM_PX, CONTRAST) is None


def counts(width_px=11.0, **changes):
    problems, warnings = find_problems(("first", "second"), searches(**changes), width_px)
    return len(problems), len(warnings)


def light(**changes):
    values = {"gain": 1.0, "noise": 2.0, "contrast": 60.0, "changed_fraction": 0.01, "lost": False}
    return Light(**(values | changes))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"level": DARK_LEVEL - 0.1}, (1, 0)),
        ({"level": DARK_LEVEL}, (0, 0)),
        ({"level": SATURATED_LEVEL}, (0, 0)),
        ({"level": SATURATED_LEVEL + 0.1}, (1, 0)),
        ({"certainty_min": KNOWN_PROBABILITY}, (0, 0)),
        ({"certainty_min": KNOWN_PROBABILITY - 0.01}, (0, 1)),
        ({"certainty_min": 0.0, "poses": (Pose(0, 0, 0), None)}, (1, 0)),  # one line is enough
        ({"sharpness": SHARPNESS_MIN}, (0, 0)),
        ({"sharpness": SHARPNESS_MIN - 0.001}, (0, 1)),
        ({"sharpness": None}, (0, 0)),
        ({"width_px": WIDTH_MIN_PX}, (0, 0)),
        ({"width_px": WIDTH_MIN_PX - 0.1}, (0, 1)),
        ({"light": light(contrast_min=60.0 / FAINT_RATIO - 0.01)}, (0, 0)),
        ({"light": light(contrast_min=60.0 / FAINT_RATIO + 0.01)}, (0, 1)),
        ({"light": light(contrast=None, lost=True, changed_fraction=0.4)}, (1, 0)),
        ({"light": light(contrast=None)}, (0, 1)),
    ],
)
def test_each_limit_has_one_line_and_nothing_is_said_at_the_limit(changes, expected):
    assert counts(**changes) == expected


def test_a_moved_stage_is_named_with_the_part_of_the_image_that_differs():
    (line,), _ = find_problems(
        ("a", "b"), searches(light=light(lost=True, changed_fraction=0.4)), 11.0
    )
    assert line.startswith("40 % of the image differs")


def test_no_images_say_nothing():
    assert find_problems(("a", "b"), [], 1.0) == ([], [])


def test_single_bad_images_say_nothing_of_light_and_focus():
    good, dark = searches(), searches(level=1.0, sharpness=0.01, light=light(contrast=1.0))
    assert find_problems(("a", "b"), [*dark[:9], *good[:11]], 11.0) == ([], [])


def test_cells_in_view_are_the_robots_that_are_seen_and_the_others():
    other = Pose(5, 5, 0)
    assert count_cells(searches(unknown_objects=(other, other))) == 4
    assert count_cells(searches(poses=(None, Pose(1, 1, 0)), unknown_objects=(other,))) == 2
    assert count_cells(searches(poses=(None, None))) == 0


def test_a_faint_contrast_is_said_with_both_numbers():
    assert "median of 9 grey levels" in describe_faint_cells(9.0, 8.0)
    assert "below 8 are missed" in describe_faint_cells(9.0, 8.0)
    assert "by 8 grey levels" in describe_faint_cells(None, 8.0)
    assert describe_faint_cells(80.0, 8.0) is None


@pytest.mark.parametrize("place", ["left", "top", "right", "bottom"])
def test_the_sharpness_of_a_cell_at_the_edge_is_that_of_what_is_seen(place):
    grey, (cell,) = picture_of_a_cell(0.5, 1.0)
    usual = measure_sharpness(grey, [cell], UM_PX, CONTRAST)
    cut = 30
    part = {
        "left": grey[:, cut:],
        "top": grey[cut:],
        "right": grey[:, :-cut],
        "bottom": grey[:-cut],
    }[place]
    x = cell.x - (cut * UM_PX if place == "left" else 0)
    y = cell.y - (cut * UM_PX if place == "bottom" else 0)
    moved = SimpleNamespace(x=x, y=y, long_um=52.0)
    found = measure_sharpness(np.ascontiguousarray(part), [moved], UM_PX, CONTRAST)
    assert found == pytest.approx(usual, rel=0.25)


def test_the_sharpness_is_relative_to_the_contrast_and_that_of_the_middle_cell():
    grey, (cell,) = picture_of_a_cell(0.5, 1.0)
    usual = measure_sharpness(grey, [cell], UM_PX, CONTRAST)
    assert measure_sharpness(grey, [cell], UM_PX, CONTRAST / 2) == pytest.approx(2 * usual)
    empty = SimpleNamespace(x=10 * UM_PX, y=10 * UM_PX, long_um=20.0)
    assert measure_sharpness(grey, [cell, empty, cell], UM_PX, CONTRAST) == pytest.approx(usual)
    beyond = SimpleNamespace(x=500 * UM_PX, y=40 * UM_PX, long_um=52.0)
    assert measure_sharpness(grey, [beyond], UM_PX, CONTRAST) is None
