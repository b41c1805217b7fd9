"""Tests of finding blobs in images that the test draws itself."""

import math
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from tetractl_microscope.cells.detect_cells import BlobFinder

pytestmark = pytest.mark.slow

SIDE = 320
LIGHT = 160.0
BODY = 11.3, 5.7  # half the length and half the width of a cell [px]


def step(beyond):
    """1 inside, 0 outside, smooth between."""
    return 1 / (1 + np.exp(np.clip(beyond, -30, 30)))


def around(middle):
    """Where a body may be, along one side of a picture."""
    first = int(middle - 3 * BODY[0])
    last = int(middle + 3 * BODY[0])
    return slice(max(0, first), max(0, last))


class Dish:
    """A dish with specks and a bubble, and cells at x, y [px], axis [rad]."""

    def __init__(self, contrast=-0.17, noise=8.0, rim=0.0):
        self.random = np.random.default_rng(5)
        self.contrast = contrast
        self.noise = noise
        self.rim = rim
        self.down, self.across = np.mgrid[0:SIDE, 0:SIDE].astype(float)
        self.still = {}  # specks and bubble by their shift
        self.specks = self.random.uniform((10, 10, 1.5), (SIDE - 10, SIDE - 10, 5), (12, 3))

    def body(self, x, y, axis, part):
        """How far pixels in a `part` of the picture are from a body's middle, 1 at its outline."""
        across = self.across[part] - x
        down = self.down[part] - y
        along = across * math.cos(axis) + down * math.sin(axis)
        aside = down * math.cos(axis) - across * math.sin(axis)
        return np.hypot(along / BODY[0], aside / BODY[1])

    def things(self, right, down):
        """Specks and a bubble, shifted."""
        drawn = np.zeros((SIDE, SIDE))
        for x, y, radius in self.specks:
            away = np.hypot(self.across - x - right, self.down - y - down)
            drawn -= 0.3 * step(2 * (away - radius))
        away = np.hypot(self.across - 90 - right, self.down - 230 - down)
        return drawn + 0.5 * np.exp(-((away - 40) ** 2) / 4)

    def picture(self, cells, shift=(0.0, 0.0), light=1.0):
        """A grey picture; the content is shifted by columns and rows."""
        if shift not in self.still:
            self.still[shift] = self.things(*shift)
        drawn = self.still[shift].copy()
        for x, y, axis in cells:
            column = x + shift[0]
            row = y + shift[1]
            part = around(row), around(column)
            far = self.body(column, row, axis, part)
            drawn[part] += self.contrast * step(8 * (far - 1))
            drawn[part] += self.rim * np.exp(-((far - 1.25) ** 2) / 0.02)
        grey = light * (LIGHT * (1 + drawn) + self.random.normal(0, self.noise, drawn.shape))
        return np.clip(grey + 0.5, 0, 255).astype(np.uint8)


def cells_at(k):
    """Cells that swim to the right, far from each other."""
    return [(20.3 + (37 * i + 9 * k) % 280, 22.6 + 38 * i, 0.3 * math.sin(i)) for i in range(8)]


def finder(dish, **options):
    blob_finder = BlobFinder(90, 2800, **options)
    pictures = [dish.picture(cells_at(k)) for k in range(15)]
    blob_finder.learn(pictures)
    return blob_finder


def matched(blobs, cells, shift=(0.0, 0.0)):
    """The blob nearest to each cell within 8 px, or None."""
    pairs = []
    for x, y, _ in cells:
        place = (x + shift[0], y + shift[1])
        within = [blob for blob in blobs if math.dist((blob.x, blob.y), place) < 8]
        nearest = min(within, key=lambda blob: math.dist((blob.x, blob.y), place), default=None)
        pairs.append(nearest)
    return pairs


@pytest.mark.long
@pytest.mark.parametrize("contrast", [-0.17, 0.17, -0.035])
def test_cells_of_phase_contrast_are_found_before_and_after_a_knock(contrast):
    dish = Dish(contrast)
    blob_finder = finder(dish)
    shifts = []
    missed = 0
    for k in range(15, 45):
        shift = (6.0, -5.0) if k >= 30 else (0.0, 0.0)
        blobs = blob_finder.find_blobs(dish.picture(cells_at(k), shift))
        blob_finder.update_background([])
        shifts.append(blob_finder.light.shift_px)
        missed += matched(blobs, cells_at(k), shift).count(None)
    assert missed <= 0.02 * 30 * 8
    assert blob_finder.bright is (contrast > 0)
    assert shifts[15] == pytest.approx((6.0, -5.0), abs=0.5)
    assert [shift for k, shift in enumerate(shifts) if k != 15] == [(0.0, 0.0)] * 29


class Errors(NamedTuple):
    """How far off blobs are from the places [px] and axes [rad] of their cells."""

    places: list
    axes: list


def errors_in(dish):
    """The errors in 15 pictures, in which each cell is one blob."""
    blob_finder = finder(dish)
    errors = Errors([], [])
    for k in range(15, 30):
        cells = cells_at(k)
        blobs = blob_finder.find_blobs(dish.picture(cells))
        for (x, y, axis), blob in zip(cells, matched(blobs, cells), strict=True):
            assert sum(math.dist((b.x, b.y), (x, y)) < 20 for b in blobs) == 1
            errors.places.append(math.dist((blob.x, blob.y), (x, y)))
            errors.axes.append((blob.axis - axis + math.pi / 2) % math.pi - math.pi / 2)
    return errors


@pytest.mark.parametrize(("contrast", "rim"), [(0.2, -0.3), (-0.2, 0.3), (0.05, -0.35)])
def test_a_body_and_its_rim_are_one_blob(contrast, rim):
    errors = errors_in(Dish(contrast, noise=4.0, rim=rim))
    assert np.sqrt(np.mean(np.square(errors.places))) < 0.4
    assert np.sqrt(np.mean(np.square(errors.axes))) < 0.06


def test_positions_are_finer_than_pixels():
    errors = errors_in(Dish(-0.4, noise=3.0))
    assert np.median(errors.places) < 0.07
    assert np.median(np.abs(errors.axes)) < 0.015


def test_a_cell_that_rested_while_the_background_was_learned_leaves_no_ghost():
    dish = Dish(-0.4, noise=3.0)
    blob_finder = BlobFinder(90, 2800)
    rested = (160.0, 160.0, 0.4)
    gone = (260.0, 160.0, 0.4)
    blob_finder.learn([dish.picture([rested])] * 9)
    blob_finder.find_blobs(dish.picture([gone]))
    blobs = blob_finder.find_blobs(dish.picture([gone]))
    assert [math.dist((b.x, b.y), gone[:2]) < 1 for b in blobs] == [True]
    assert (
        len(blob_finder.find_blobs(dish.picture([rested]))) == 1
    )  # it is not in the background any more


@pytest.mark.long
def test_a_dish_that_was_exchanged_is_learned_again():
    dish = Dish(-0.4, noise=3.0)
    other_dish = Dish(-0.4, noise=3.0)
    blob_finder = finder(dish)
    shade = np.where(other_dish.across > 150, 0.5, 1.0)

    def turned(k):
        return (other_dish.picture(cells_at(k)).T * shade).astype(np.uint8)

    lost = []
    for k in range(15, 75):
        blob_finder.find_blobs(turned(k))
        blob_finder.update_background([])
        lost.append(blob_finder.light.lost)
    assert lost[0] and not lost[-1]
    blobs = blob_finder.find_blobs(turned(75))
    places = [(y, x, 0.0) for x, y, _ in cells_at(75)]
    assert matched(blobs, places).count(None) <= 1


@pytest.mark.parametrize("size", [(2, 2), (3, 900), (40, 40), (900, 12)])
def test_pictures_of_any_size_are_searched(size):
    random = np.random.default_rng(2)
    blob_finder = BlobFinder(2, 50)
    pictures = random.integers(90, 110, (3, *size)).astype(np.uint8)
    blob_finder.learn(list(pictures))
    picture = cv2.GaussianBlur(random.integers(0, 255, size).astype(np.uint8), (0, 0), 2)
    assert all(math.isfinite(blob.x + blob.axis) for blob in blob_finder.find_blobs(picture))
    blob_finder.update_background([(0, 0, 5, 5)])
