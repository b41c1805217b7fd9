"""Tests of finding tags and their corners in rendered images."""

import numpy as np
import pytest
from testkit.microscope.tag_scene import LARGE, ROBOTS, SMALL, STANDING, rendered
from tetractl_emulator.pictures.apriltag.side import CARD
from tetractl_microscope.apriltag.detect import MODULES, Detector, tag_picture

pytestmark = pytest.mark.slow

# Codes of the family 36h11 and the places of their bits, most significant first, as defined by the
# AprilTag project; the other three quarters follow by turning the first.
CODES = {0: 0xD7E00984B, 1: 0xDDA664CA7, 586: 0xE8B772FE0}
QUARTER = [(1, 1), (2, 1), (3, 1), (4, 1), (5, 1), (2, 2), (3, 2), (4, 2), (3, 3)]


def published(code):
    tag = np.zeros((MODULES, MODULES), np.uint8)
    places = [(x, y) for x, y in QUARTER]
    for bit in range(36):
        x, y = places[bit % 9]
        tag[y, x] = 255 * (code >> (35 - bit) & 1)
        if bit % 9 == 8:
            places = [(7 - y, x) for x, y in places]
    return tag


@pytest.mark.parametrize("number", CODES)
def test_tags_are_drawn_as_the_apriltag_project_prints_them(number):
    assert (tag_picture(number) == published(CODES[number])).all()


@pytest.mark.parametrize("turns", range(4))
def test_the_first_corner_is_the_top_left_one_of_the_tag_read_upright(turns):
    square = np.kron(published(CODES[1]), np.ones((9, 9), np.uint8))
    upright = np.pad(square, 30, constant_values=255)
    picture = np.ascontiguousarray(np.rot90(upright, turns))
    (sighting,) = Detector().find(picture)
    corners = np.array([(29.5, 29.5), (101.5, 29.5), (101.5, 101.5), (29.5, 101.5)])
    assert sighting.tag == 1
    assert sighting.corners == pytest.approx(np.roll(corners, turns, axis=0), abs=0.3)


def truth(renderer, i):
    """Corners of robot i's black square [px]."""
    card = renderer.card(ROBOTS[i], STANDING, i)
    return card.mean(axis=0) + (card - card.mean(axis=0)) * MODULES / CARD


@pytest.mark.parametrize(("size", "bound"), [(SMALL, 0.2), (LARGE, 0.1)])
def test_corners_are_found_within_a_fraction_of_a_pixel(size, bound):
    detector = Detector()
    renderer = rendered(size)
    off = []
    for _ in range(10):
        sightings = detector.find(renderer.picture(lambda t: STANDING, 0))
        corners = {sighting.tag: sighting.corners for sighting in sightings}
        off += [corners[robot.tag] - truth(renderer, i) for i, robot in enumerate(ROBOTS)]
    assert np.sqrt(np.mean(np.square(off))) < bound
    assert np.abs(np.mean(off, axis=(0, 1))).max() < bound / 2  # no bias


@pytest.mark.parametrize("blur", [0.7, 1.2])
def test_blur_is_measured(blur):
    renderer = rendered(LARGE, blur_px=blur)
    sightings = Detector().find(renderer.picture(lambda t: STANDING, 0))
    blurs_px = [sighting.blur_px for sighting in sightings]
    assert np.median(blurs_px) == pytest.approx(blur, abs=0.25)
