"""Tests of finding bodies that are drawn exactly: shapes, limits, light and learning."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tetractl_microscope.cells.detect_cells import (
    LEARNING_RATE,
    LOST_IN_A_ROW_MAX,
    PEAK_THRESHOLD_STDS,
    PIXEL_THRESHOLD_STDS,
    RELEARNING_SAMPLES,
    STRIPE_COUNT,
    Background,
    BlobFinder,
    Box,
    SearchArrays,
    SearchLimits,
    _create_averaging_square,
    _measure_blob,
    _median_image,
    _sample_pixels,
)

HEIGHT = 160
WIDTH = 200
LEVEL = 100.0
LONG = 24.0
WIDE = 12.0
DOWN, ACROSS = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)


def inside(x, y, axis=0.0, long=LONG, wide=WIDE):
    """The fraction of each pixel that an ellipse covers."""
    along = (ACROSS - x) * math.cos(axis) + (DOWN - y) * math.sin(axis)
    aside = (DOWN - y) * math.cos(axis) - (ACROSS - x) * math.sin(axis)
    far = np.hypot(along / (long / 2), aside / (wide / 2))
    return np.clip(0.5 + (1 - far) * wide / 2, 0, 1)


class Dish:
    """Pictures of a dish with a faint texture and specks."""

    def __init__(self, noise=1.0, seed=4, specks=0):
        self.random = np.random.default_rng(seed)
        texture = self.random.normal(0, 1, (HEIGHT + 40, WIDTH + 40))
        self.texture = 40 * cv2.GaussianBlur(texture, (0, 0), 4)
        for x, y in self.random.integers(0, (WIDTH + 40, HEIGHT + 40), (specks, 2)).tolist():
            cv2.circle(self.texture, (x, y), 2, -60.0, -1)
        self.noise = noise

    def picture(self, *bodies, contrast=-50.0, light=1.0, shift=(0, 0), noise=None):
        right, down = shift
        rows = slice(20 - down, 20 - down + HEIGHT)
        grey = LEVEL + self.texture[rows, 20 - right : 20 - right + WIDTH]
        for body in bodies:
            grey = grey + contrast * inside(*body)
        grey = light * grey + self.random.normal(0, noise or self.noise, grey.shape)
        return np.clip(grey + 0.5, 0, 255).astype(np.uint8)

    def finder(self, least_px2=80, most_px2=900):
        finder = BlobFinder(least_px2, most_px2)
        finder.learn([self.picture() for _ in range(9)])
        return finder


def off_axis(one, other):
    return abs((one - other + math.pi / 2) % math.pi - math.pi / 2)


@pytest.mark.parametrize("contrast", [-50.0, 60.0])
@pytest.mark.parametrize("axis", [-1.3, -0.6, 0.0, 0.5, 1.0, 1.57])
def test_a_body_is_found_with_its_place_direction_and_size(axis, contrast):
    dish = Dish()
    finder = dish.finder()
    (blob,) = finder.find_blobs(dish.picture((80.3, 61.6, axis), contrast=contrast))
    assert (blob.x, blob.y) == pytest.approx((80.3, 61.6), abs=0.3)
    assert off_axis(blob.axis, axis) < 0.05
    assert blob.length == pytest.approx(LONG, rel=0.12)
    assert blob.width == pytest.approx(WIDE, rel=0.2)
    assert blob.length > 1.6 * blob.width
    assert 0.6 * abs(contrast) < blob.strength < 1.05 * abs(contrast)
    assert not blob.at_edge
    pixels = blob.pixels
    assert pixels.mean(axis=0) == pytest.approx((80.3, 61.6), abs=0.7)
    assert len(pixels) == pytest.approx(math.pi / 4 * LONG * WIDE, rel=0.3)
    shown = np.zeros((HEIGHT, WIDTH), bool)
    shown[blob.slices] = blob.mask > 0
    assert np.argwhere(shown)[:, ::-1].tolist() == pixels.astype(int).tolist()


@given(st.floats(18, 36), st.floats(9, 14), st.floats(-1.5, 1.5))
@settings(max_examples=15)
def test_a_longer_body_is_a_longer_blob_and_a_wider_one_a_wider_blob(long, wide, axis):
    dish = Dish()
    finder = dish.finder()
    (blob,) = finder.find_blobs(dish.picture((100.0, 80.0, axis, long, wide)))
    assert blob.length == pytest.approx(long, abs=3.0)
    assert blob.width == pytest.approx(wide, abs=3.0)


@pytest.mark.parametrize(
    ("x", "y", "cut"),
    [
        (4.0, 80.0, True),
        (WIDTH - 4.0, 80.0, True),
        (100.0, 4.0, True),
        (100.0, HEIGHT - 4.0, True),
        (30.0, 30.0, False),
        (WIDTH - 30.0, HEIGHT - 30.0, False),
    ],
)
def test_a_body_that_the_edge_of_the_image_cuts_is_at_the_edge(x, y, cut):
    dish = Dish()
    (blob,) = dish.finder().find_blobs(dish.picture((x, y)))
    assert blob.at_edge is cut
    assert math.dist((blob.x, blob.y), (x, y)) < 6


@pytest.mark.parametrize(
    ("least_px2", "most_px2", "count"),
    [(80, 900, 1), (160, 500, 1), (80, 120, 0), (4000, 9000, 0), (20, 100, 0)],
)
def test_bodies_that_are_too_small_or_too_large_are_no_blobs(least_px2, most_px2, count):
    """The body covers 226 pixels."""
    dish = Dish()
    assert (
        len(dish.finder(least_px2, most_px2).find_blobs(dish.picture((100.0, 80.0, 0.3)))) == count
    )


def test_an_empty_dish_has_no_blobs_and_no_contrast():
    dish = Dish()
    finder = dish.finder()
    for _ in range(5):
        assert finder.find_blobs(dish.picture()) == []
        assert finder.light.contrast is None
        assert finder.light.changed_fraction < 0.005
        assert not finder.light.lost
        assert finder.light.shift_px == (0.0, 0.0)


def test_bodies_are_listed_with_the_largest_first_and_two_side_by_side_are_two():
    dish = Dish()
    finder = dish.finder()
    small = (40.0, 40.0, 0.3, 18.0, 11.0)
    beside = [(120.0, 100.0, 1.57), (142.0, 100.0, 1.57)]
    blobs = finder.find_blobs(dish.picture(small, *beside))
    assert len(blobs) == 3
    for x, _, _ in beside:
        assert any(math.dist((b.x, b.y), (x, 100.0)) < 2 for b in blobs[:2])
    assert math.dist((blobs[2].x, blobs[2].y), (40, 40)) < 1


def test_the_contrast_is_the_median_of_the_bodies():
    dish = Dish()
    finder = dish.finder()
    finder.find_blobs(dish.picture((40.0, 40.0)))
    single = finder.light.contrast
    assert single == pytest.approx(45, abs=8)
    (blob,) = finder.find_blobs(dish.picture((40.0, 40.0), contrast=-25.0))
    assert finder.light.contrast == blob.strength == pytest.approx(single / 2, rel=0.1)
    assert finder.light.contrast_min < blob.strength


@pytest.mark.parametrize(("contrast", "bright"), [(50.0, True), (-50.0, False)])
def test_learning_shows_whether_cells_are_bright(contrast, bright):
    dish = Dish()
    finder = BlobFinder(80, 900)
    finder.learn([dish.picture((30.0 + 14 * k, 80.0), contrast=contrast) for k in range(9)])
    assert finder.bright is bright
    assert finder.find_blobs(dish.picture()) == []  # none is in the background


@pytest.mark.parametrize("light", [0.6, 0.9, 1.3])
def test_a_lamp_that_is_turned_changes_the_gain_and_no_blob(light):
    dish = Dish()
    finder = dish.finder()
    body = (80.0, 60.0, 0.4)
    (usual,) = finder.find_blobs(dish.picture(body))
    assert finder.light.gain == pytest.approx(1.0, abs=0.01)
    (blob,) = finder.find_blobs(dish.picture(body, light=light))
    assert finder.light.gain == pytest.approx(light, rel=0.02)
    assert (blob.x, blob.y) == pytest.approx((80.0, 60.0), abs=0.3)
    assert blob.strength == pytest.approx(light * usual.strength, rel=0.1)


def test_pictures_of_unequal_light_are_learned_as_one_dish():
    dish = Dish()
    finder = BlobFinder(80, 900)
    lights = (1.0, 0.7, 1.2, 0.9, 1.0, 1.1, 0.8, 1.3, 1.0)
    finder.learn([dish.picture(light=light) for light in lights])
    background = finder.background.astype(float)
    assert np.abs(background - dish.picture(noise=0.01)).mean() < 1.5
    assert len(finder.find_blobs(dish.picture((80.0, 60.0), light=0.8))) == 1


@pytest.mark.parametrize("noise", [2.0, 8.0, 20.0])
def test_the_noise_is_that_of_the_blurred_image(noise):
    dish = Dish(noise=noise)
    finder = dish.finder()
    finder.find_blobs(dish.picture())
    weights = np.array([1, 2, 3, 2, 1]) / 9  # two box filters of 3 pixels
    blurred = noise * float(np.sum(weights**2))
    assert finder.light.noise == pytest.approx(blurred, abs=1.48)  # of whole grey levels


def test_a_picture_that_is_much_noisier_than_the_first_is_lost_and_the_next_is_not():
    dish = Dish(noise=4.0)
    finder = dish.finder()
    body = (80.0, 60.0)
    assert len(finder.find_blobs(dish.picture(body))) == 1
    assert finder.find_blobs(dish.picture(body, noise=35.0)) == []
    assert finder.light.lost
    assert len(finder.find_blobs(dish.picture(body, noise=5.0))) == 1
    assert not finder.light.lost


@pytest.mark.parametrize("grey", [255, 0])
def test_a_white_or_black_picture_is_lost(grey):
    dish = Dish()
    finder = dish.finder()
    finder.find_blobs(dish.picture())
    assert finder.find_blobs(np.full((HEIGHT, WIDTH), grey, np.uint8)) == []
    assert finder.light.lost


def test_a_picture_of_which_a_large_part_has_changed_is_lost():
    dish = Dish()
    finder = dish.finder()
    finder.find_blobs(dish.picture())
    for share, lost in ((0.15, False), (0.4, True)):
        picture = dish.picture()
        picture[:, : int(share * WIDTH)] //= 2
        finder.find_blobs(picture)
        assert finder.light.changed_fraction == pytest.approx(share, abs=0.04)
        assert finder.light.lost is lost


def shown(finder, picture, count):
    """Show a picture again and again; whether each was lost."""
    lost = []
    for _ in range(count):
        finder.find_blobs(picture())
        finder.update_background([])
        lost.append(finder.light.lost)
    return lost


def test_another_dish_is_learned_after_some_lost_pictures():
    dish = Dish()
    finder = dish.finder()
    other = Dish(seed=9)
    shade = np.where(ACROSS > 90, 0.5, 1.0)

    def exchanged():
        return (other.picture() * shade).astype(np.uint8)

    lost = shown(finder, exchanged, 60)
    first = lost.index(False)
    assert (
        LOST_IN_A_ROW_MAX + 2 * RELEARNING_SAMPLES
        < first
        < LOST_IN_A_ROW_MAX + 4 * RELEARNING_SAMPLES
    )
    assert not any(lost[first:])
    assert np.abs(finder.background.astype(float) - exchanged()).mean() < 3
    assert len(finder.find_blobs((other.picture((40.0, 60.0)) * shade).astype(np.uint8))) == 1


def test_a_few_lost_pictures_in_a_row_change_no_background():
    dish = Dish()
    finder = dish.finder()
    dark = Dish(seed=3)
    finder.find_blobs(dish.picture())
    before = finder.background.astype(float).copy()
    for _ in range(6):
        assert all(shown(finder, lambda: dark.picture(noise=60.0), LOST_IN_A_ROW_MAX))
        assert not any(shown(finder, dish.picture, 3))
    assert np.abs(finder.background - before).mean() < 6.0
    assert len(finder.find_blobs(dish.picture((80.0, 60.0)))) == 1


def test_a_knock_moves_the_background_once():
    dish = Dish(specks=40)
    finder = dish.finder()
    finder.find_blobs(dish.picture())
    shifts = []
    for _ in range(4):
        blobs = finder.find_blobs(dish.picture((100.0, 80.0), shift=(6, -4)))
        shifts.append(finder.light.shift_px)
        middle = [b for b in blobs if 30 < b.x < WIDTH - 30 and 30 < b.y < HEIGHT - 30]
        assert [math.dist((b.x, b.y), (100, 80)) < 1 for b in middle] == [True]
        assert finder.light.changed_fraction < 0.1
    assert shifts[0] == pytest.approx((6.0, -4.0), abs=0.3)
    assert shifts[1:] == [(0.0, 0.0)] * 3


@pytest.mark.parametrize("light", [0.6, 1.0, 1.4])
def test_the_place_of_a_cell_that_left_is_repaired_and_no_other(light):
    """It rested while the background was learned; another one is where it was not."""
    dish = Dish(noise=0.5)
    finder = BlobFinder(80, 900)
    finder.learn([dish.picture((60.0, 60.0, 0.4))] * 9)
    swimming = (140.0, 100.0, 1.0)
    for _ in range(2):
        blobs = finder.find_blobs(dish.picture(swimming, light=light))
    assert [math.dist((b.x, b.y), (140, 100)) < 1 for b in blobs] == [True]
    empty = LEVEL + dish.texture[20 : 20 + HEIGHT, 20 : 20 + WIDTH]
    assert np.abs(finder.background - empty)[45:75, 45:75].max() < 4.0
    assert np.abs(finder.background - empty)[85:115, 125:155].mean() < 1.5
    (back,) = finder.find_blobs(dish.picture((60.0, 60.0, 0.4), light=light))
    assert math.dist((back.x, back.y), (60, 60)) < 1


def test_a_cell_that_comes_back_to_where_it_was_corrected_is_found():
    """A place that looks as when the background was learned again is empty."""
    dish = Dish(noise=0.5)
    finder = dish.finder()
    for _ in range(3):
        (blob,) = finder.find_blobs(dish.picture((60.0, 60.0)))
        assert math.dist((blob.x, blob.y), (60, 60)) < 1
        assert finder.find_blobs(dish.picture()) == []
    finder._background.fine[50:70, 50:70] -= 30.0  # as by a cell that rested
    finder._background.grey[50:70, 50:70] -= 30
    assert finder.find_blobs(dish.picture()) == []
    assert np.abs(finder.background.astype(float) - dish.picture()).max() < 8


# ---- updates of the background ----


def test_the_stripes_are_the_whole_picture_and_come_in_turn():
    for height in (16, 37, 160):
        newest = SearchArrays(np.zeros((height, 4), np.uint8))
        rows = [newest.next_stripe() for _ in range(2 * STRIPE_COUNT)]
        covered = [row for part in rows[:STRIPE_COUNT] for row in range(part.start, part.stop)]
        assert covered == list(range(height))
        assert rows[STRIPE_COUNT:] == rows[:STRIPE_COUNT]


def test_the_background_follows_slowly_where_no_cell_is_kept():
    dish = Dish(noise=0.01)
    finder = dish.finder()
    finder.find_blobs(dish.picture())
    before = finder._background.fine.copy()
    later = np.clip(dish.picture() + np.where(ACROSS < 40, 2, 0), 0, 255).astype(np.uint8)
    keep = (10, 30, 25, 70)  # left, top, right and bottom
    for _ in range(STRIPE_COUNT):
        finder.find_blobs(later)
        finder.update_background([keep])
    change = finder._background.fine - before
    left, top, right, bottom = keep
    assert np.abs(change[top:bottom, left:right]).max() < 1e-6
    assert change[top:bottom, 2:left].mean() == pytest.approx(2 * LEARNING_RATE, abs=0.06)
    assert change[top:bottom, right:38].mean() == pytest.approx(2 * LEARNING_RATE, abs=0.06)
    assert change[2 : top - 1, 2:38].mean() == pytest.approx(2 * LEARNING_RATE, abs=0.06)
    assert change[bottom + 1 :, 2:38].mean() == pytest.approx(2 * LEARNING_RATE, abs=0.06)
    assert abs(change[:, 50:].mean()) < 0.1


@pytest.mark.parametrize("keep", [(-30, -30, -5, -5), (-20, -20, 3, 3), (190, 150, 400, 300)])
def test_rectangles_beyond_the_image_keep_what_is_within(keep):
    dish = Dish(noise=0.01)
    finder = dish.finder()
    later = np.clip(dish.picture().astype(int) + 1, 0, 255).astype(np.uint8)
    kept = np.zeros((HEIGHT, WIDTH), bool)
    kept[max(0, keep[1]) : max(0, keep[3]), max(0, keep[0]) : max(0, keep[2])] = True
    finder.find_blobs(later)
    before = finder._background.fine.copy()
    for _ in range(STRIPE_COUNT):
        finder.update_background([keep])
    changed = finder._background.fine != before
    assert not changed[kept].any()
    assert changed[~kept].mean() > 0.5


def test_a_resting_body_does_not_become_background():
    dish = Dish()
    finder = dish.finder()
    for _ in range(6 * STRIPE_COUNT):
        blobs = finder.find_blobs(dish.picture((80.0, 60.0)))
        finder.update_background([])
    assert len(blobs) == 1
    assert blobs[0].strength > 35


def test_a_background_is_corrected_only_where_it_is_wrong():
    fine = np.full((6, 8), 50.4, np.float32)
    background = Background(fine)
    part = slice(1, 4), slice(2, 6)
    wrong = np.zeros((3, 4), bool)
    wrong[1, 2] = True
    background.correct(part, wrong, np.full((3, 4), 300.0))
    expected = np.full((6, 8), 50.4)
    expected[2, 4] = 300.0
    assert background.fine == pytest.approx(expected)
    assert background.grey[2, 4] == 255 and background.grey[0, 0] == 50
    assert (background.learned == np.float32(50.4)).all()


def test_a_background_moves_with_all_that_was_learned():
    fine = np.random.default_rng(1).uniform(40, 60, (30, 40)).astype(np.float32)
    background = Background(fine.copy())
    background.move((3.0, -2.0))
    for now in (background.fine, background.learned):
        assert now[5:20, 10:30] == pytest.approx(fine[7:22, 7:27], abs=1e-3)
    assert np.abs(background.grey - background.fine)[5:20, 10:30].max() <= 0.51


# ---- parts ----


@given(st.floats(0, 20), st.floats(0.1, 5))
def test_the_limits_are_those_above_the_level(level, spread):
    limits = SearchLimits(
        level + PIXEL_THRESHOLD_STDS * spread, level + PEAK_THRESHOLD_STDS * spread, 1.0, 2.0
    )
    assert limits.level == pytest.approx(level, abs=1e-9)


@pytest.mark.parametrize("least_px2", [1, 2, 30, 80, 500])
def test_averages_are_over_a_square_of_an_odd_side_near_that_of_the_least_body(least_px2):
    side, other = _create_averaging_square(least_px2).shape
    assert side == other and side % 2 == 1
    assert abs(side - 1.2 * math.sqrt(least_px2)) <= 1.3


def test_a_median_is_of_the_pictures_at_the_same_light_in_any_size():
    random = np.random.default_rng(3)
    for size in ((1, 5), (70, 9), (200, 3)):
        pictures = random.integers(0, 200, (5, *size)).astype(np.uint8)
        gains = np.array([1.0, 0.5, 2.0, 1.5, 1.0])
        expected = np.median(gains[:, None, None] * pictures, axis=0)
        assert _median_image(list(pictures), gains) == pytest.approx(expected)


@pytest.mark.parametrize(("height", "step"), [(64, 8), (512, 8), (640, 10), (2048, 32)])
def test_statistics_are_of_about_64_rows_and_every_eighth_at_most(height, step):
    picture = np.arange(height)[:, None] * np.ones((1, 100))
    assert _sample_pixels(picture)[:, 0].tolist() == list(range(0, height, step))
    assert _sample_pixels(picture).shape[1] == math.ceil(100 / step)


@pytest.mark.parametrize("weighed", [True, False])
@pytest.mark.parametrize(("wide", "tall"), [(10, 4), (4, 10), (7, 7), (1, 9)])
def test_the_moments_of_a_rectangle_are_those_of_its_area(wide, tall, weighed):
    """Of a side a they are a^2 / 12, and of an ellipse's axis b they are b^2 / 16."""
    body = np.zeros((20, 30), np.uint8)
    body[3 : 3 + tall, 5 : 5 + wide] = 1
    difference = 40 * body
    box = Box(left=100, top=50, width=30, height=20)
    blob = _measure_blob(body, body * (1.0 if weighed else 0.0), difference, box, True)
    assert (blob.x, blob.y) == pytest.approx((105 + (wide - 1) / 2, 53 + (tall - 1) / 2))
    longer, shorter = max(wide, tall), min(wide, tall)
    assert blob.length == pytest.approx(4 * longer / math.sqrt(12))
    assert blob.width == pytest.approx(4 * shorter / math.sqrt(12))
    if wide != tall:
        assert off_axis(blob.axis, 0.0 if wide > tall else math.pi / 2) < 1e-6
    assert blob.strength == pytest.approx(40.0)
    assert blob.at_edge and blob.corner == (100, 50)
    assert len(blob.pixels) == wide * tall
    assert blob.pixels.min(axis=0).tolist() == [105.0, 53.0]
