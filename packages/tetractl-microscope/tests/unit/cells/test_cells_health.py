"""Tests of warnings about a microscope's images: light, focus and cells."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from tetractl_microscope.cells.cells_health import BLURRED, SeenDish, dish_lines, sharpness
from tetractl_microscope.cells.detect_cells import Light
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
    return sharpness(*picture_of_a_cell(angle, blur_px), UM_PX, CONTRAST)


def test_sharpness_does_not_depend_on_where_cells_swim():
    """Regression: only slopes along rows were measured, of which a body along rows has few."""
    values = [sharpness_of(angle, 1.0) for angle in np.linspace(0.0, math.pi, 9)]
    assert max(values) < 1.1 * min(values)


LIGHT = Light(gain=1.0, noise=2.0, contrast=60.0, changed=0.01, lost=False)


def searches(**changes):
    values = {
        "robots": None,  # which cells they are does not matter to what is said
        "poses": (Pose(0, 0, 0), Pose(1, 1, 0)),
        "unknown_objects": (),
        "light": LIGHT,
        "level": 120.0,
        "sharpness": 0.3,
        "sure": 1.0,
    } | changes
    return [PictureSearch(k, k * 33_333_333, 5_000_000, SeenDish(**values)) for k in range(20)]


@pytest.mark.parametrize(
    ("changes", "width_px", "says"),
    [
        ({}, 11.0, ""),
        ({"level": 3.0}, 11.0, "black"),
        ({"level": 252.0}, 11.0, "saturated"),
        ({"light": Light(1, 2, None, 0.4, True)}, 11.0, "was the stage or the lamp moved"),
        ({"poses": (None, None)}, 11.0, "first, second not tracked: 0 cells are in view, but 2"),
        (
            {"light": Light(1, 3.0, 9.0, 0.01, False, limit=7.0)},
            11.0,
            "objects below 7 are missed",
        ),
        ({"light": Light(1, 3.0, None, 0.0, False, limit=7.0)}, 11.0, "no object differs"),
        ({"sharpness": 0.05}, 11.0, "focus"),
        ({"sure": 0.6}, 11.0, "it is uncertain which cell is which"),
        ({}, 5.2, "a cell is only 5 px wide, but at least 8 px"),
    ],
)
def test_health_says_what_is_wrong_in_words(changes, width_px, says):
    problems, warnings = dish_lines(("first", "second"), searches(**changes), width_px)
    lines = [*problems, *warnings]
    assert (lines == []) if not says else any(says in line for line in lines)


@pytest.mark.parametrize(("blur_px", "is_blurred"), [(0.6, False), (2.0, False), (4.0, True)])
def test_rims_are_blurred_in_any_direction(blur_px, is_blurred):
    for angle in (0.0, 0.7, math.pi / 2):
        assert (sharpness_of(angle, blur_px) < BLURRED) == is_blurred


def test_no_sharpness_without_contrast_or_without_cells():
    picture, cells = picture_of_a_cell(0.0, 1.0)
    assert sharpness(picture, cells, UM_PX, None) is None
    assert sharpness(picture, [], UM_PX, CONTRAST) is None
