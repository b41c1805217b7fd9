"""Tests of a tag's height and tilt from its corners, for a camera that is known exactly."""

import math

import numpy as np
import pytest
from testkit.microscope.tag_scene import FLOOR, LARGE, MM, ROBOTS, SMALL, look, rendered, tracker
from tetractl_emulator.pictures.apriltag.side import Optics, Renderer
from tetractl_microscope.apriltag.floor import SQUARE, Plane

pytestmark = pytest.mark.slow

FULL = (1920, 1080)  # tags of 80 mm have 34 pixels
OPTICS = Optics.facing(FLOOR, MM, *LARGE)
SIDE = 0.12


def plane():
    axes = OPTICS.axes
    return Plane(OPTICS.matrix, np.zeros(5), axes, -axes @ np.array(OPTICS.position))


def corners(height, tilt, about=0.7, middle=(1.2, 1.4)):
    """Pixels of a tag at a height [m], turned by `tilt` about a horizontal axis."""
    flat = np.column_stack([SIDE * SQUARE, np.zeros(4)])
    axis = np.array([math.cos(about), math.sin(about), 0.0])
    turned = (
        flat * math.cos(tilt)
        + np.cross(axis, flat) * math.sin(tilt)
        + np.outer(flat @ axis, axis) * (1 - math.cos(tilt))
    )
    return OPTICS.project(turned + np.array([*middle, height]))


@pytest.mark.parametrize("height", [0.0, 0.09, 0.5, 1.45])
@pytest.mark.parametrize("middle", [(0.5, 0.4), (1.2, 1.4), (2.1, 2.0)])
def test_a_flat_tag_is_flat_at_its_height(height, middle):
    height_then, tilt = plane().height_and_tilt(corners(height, 0.0, middle=middle), SIDE)
    assert height_then == pytest.approx(height, abs=1e-4)
    assert tilt == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("tilt", [0.7, 0.9, 1.2])
@pytest.mark.parametrize("about", [0.0, 1.0, 2.0, 3.0])
def test_a_tilted_tag_does_not_look_flat(tilt, about):
    _, height = plane().height_and_tilt(corners(0.1, tilt, about), SIDE)
    assert 0.5 < height <= tilt + 1e-3


@pytest.mark.parametrize("higher_mm", [0, 80, 250])
def test_pictures_show_the_height_of_a_tag(higher_mm):
    lifted = [r.model_copy(update={"height_mm": r.height_mm + higher_mm}) for r in ROBOTS]
    before = rendered(FULL)
    looked = look(tracker(), Renderer(lifted, FLOOR, MM, before.optics))
    for pose, robot in zip(looked.poses, lifted, strict=True):
        assert pose.height == pytest.approx(robot.height_mm, abs=12.0)
        assert pose.tilt < 0.1


def test_a_tag_of_few_pixels_shows_no_height():
    """Regression: of tags of 15 pixels it differed by up to 59 mm from place to place, so that a
    robot that drives would be taken for one that is lifted."""
    looked = look(tracker(), rendered(SMALL))
    assert [pose.height for pose in looked.poses] == [None, None, None]
    assert all(pose.tilt is not None for pose in looked.poses)
