"""Tests of measuring the shift between two images."""

import numpy as np
import pytest
from tetractl_microscope.cells.knocks import find_shift, shift_picture

pytestmark = pytest.mark.slow


SPECK_PX = 13  # beyond this distance from its middle, a speck darkens nothing


@pytest.mark.parametrize("by", [(12, 7), (40, -200), (-280, 90)])
def test_a_far_knock_is_seen_under_uneven_light(by) -> None:
    """Regression: light moved with the debris hid a knock by a fifth of the picture."""
    random = np.random.default_rng(5)
    side = 1024
    rows, columns = np.mgrid[:side, :side].astype(np.float32)
    light = 160 * (1 - 0.2 * np.hypot(rows - side / 2, columns - side / 2) / side * 1.41)
    specks = random.uniform(-200, side + 200, (30, 2))

    def picture(right, down):
        dark = np.zeros((side, side), np.float32)
        for x, y in specks:
            column = max(0, int(x + right) - SPECK_PX)
            row = max(0, int(y + down) - SPECK_PX)
            near = np.s_[row : row + 2 * SPECK_PX + 1, column : column + 2 * SPECK_PX + 1]
            far = np.hypot(columns[near] - x - right, rows[near] - y - down) / 6
            dark[near] += 50 * np.clip(2 - far, 0, 1)
        return np.clip(light - dark + random.normal(0, 3, light.shape), 0, 255).astype(np.uint8)

    shift = find_shift(picture(0, 0), picture(*by))
    assert shift == pytest.approx(by, abs=2)
    assert find_shift(picture(0, 0), picture(0, 0)) == (0.0, 0.0)


def scene(side=256, seed=3, right=0, down=0, height=None):
    """Debris before a plain background, all of it moved by whole columns and rows."""
    height = height or side
    random = np.random.default_rng(seed)
    dark = np.zeros((height + 200, side + 200), np.float32)
    for x, y in random.uniform(20, (side + 180, height + 180), (60, 2)).astype(int).tolist():
        dark[y - 4 : y + 5, x - 4 : x + 5] = random.uniform(20, 60)
    shown = dark[100 - down : 100 - down + height, 100 - right : 100 - right + side]
    noise = np.random.default_rng(seed + abs(right) + abs(down)).normal(0, 1, shown.shape)
    return np.clip(150 - shown + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("by", [(5, 0), (-5, 0), (0, 9), (0, -9), (14, -22), (-30, 11)])
def test_a_knock_in_any_direction_is_seen_and_undone(by):
    before, now = scene(), scene(right=by[0], down=by[1])
    shift = find_shift(before, now)
    assert shift == pytest.approx(by, abs=0.3)
    undone = shift_picture(now, (-shift[0], -shift[1]))
    inside = np.s_[40:-40, 40:-40]
    left = np.abs(undone[inside].astype(float) - before[inside]).mean()
    assert left < 1.5  # the noise of two pictures


@pytest.mark.parametrize(("side", "height"), [(256, 128), (1200, 900)])
def test_a_knock_is_seen_in_pictures_of_any_size_and_form(side, height):
    """Large pictures are made smaller first; the shift is in their own pixels."""
    before = scene(side, height=height)
    now = scene(side, height=height, right=12, down=-7)
    assert find_shift(before, now) == pytest.approx((12, -7), abs=0.8)


def test_what_is_no_knock_has_no_shift():
    before = scene()
    assert find_shift(before, before) == (0.0, 0.0)
    assert find_shift(before, scene(right=100)) == (0.0, 0.0)  # farther than a shift is looked for
    brighter = np.clip(before.astype(float) + 20, 0, 255).astype(np.uint8)
    assert find_shift(before, brighter) == (0.0, 0.0)
    swum = before.copy()
    swum[100:110, 60:90] = 90
    assert find_shift(before, swum) == (0.0, 0.0)  # one body moved, the debris did not


def test_a_picture_that_is_too_narrow_has_no_shift():
    narrow = scene()[:20]
    assert find_shift(narrow, np.roll(narrow, 6, axis=1)) == (0.0, 0.0)
    long = np.tile(scene()[:40], (1, 8))
    assert find_shift(long, np.roll(long, 6, axis=1)) == (0.0, 0.0)  # narrow once it is small


def test_content_is_moved_by_columns_and_rows_and_edges_are_continued():
    picture = np.zeros((20, 30), np.uint8)
    picture[5, 7] = 200
    picture[:, 0] = 50
    assert shift_picture(picture, (0.0, 0.0)) is picture
    after = shift_picture(picture, (3.0, -2.0))
    assert after[3, 10] == 200
    assert (after[:, :4] == 50).all()
    half = shift_picture(picture, (0.5, 0.0))
    assert half[5, 7] == half[5, 8] == 100
