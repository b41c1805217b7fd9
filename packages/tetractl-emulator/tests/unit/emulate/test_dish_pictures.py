"""Tests of synthetic images of a dish: where bodies are drawn, and that films repeat."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.microscope.dish_films import film
from tetractl_emulator.pictures.dish.picture import DishPainter, PictureLook, RenderedSpeck

from tetractl.model.swimmers import Swimmers, bodies


def drawn(look, seed=1, **values):
    cells = Swimmers.drawn(np.random.default_rng(seed), 1)
    cells.x[:] = 180.0
    cells.y[:] = 130.0
    for name, value in values.items():
        getattr(cells, name)[:] = value
    body = bodies(cells)
    picture = DishPainter(look, seed).picture(cells, [body], np.array([True]), 0.0)
    return picture.astype(float), body


@pytest.mark.parametrize("bright", [False, True])
@pytest.mark.parametrize("heading", [0.0, 1.0, 2.5])
def test_the_middle_and_the_axis_of_a_body_are_where_they_are_said_to_be(bright, heading):
    light = 50.0 if bright else 160.0
    look = PictureLook(width=160, height=120, vignetting=0.0, noise=0.0, bright=bright, light=light)
    picture, body = drawn(look, heading=heading)
    ink = np.abs(picture - light)
    rows, columns = np.indices(ink.shape)
    x = (columns + 0.5) * look.um_px
    y = (look.height - 0.5 - rows) * look.um_px
    mass = ink.sum()
    middle = (x * ink).sum() / mass, (y * ink).sum() / mass
    assert middle == pytest.approx((body.x[0], body.y[0]), abs=0.4)
    dx = x - middle[0]
    dy = y - middle[1]
    cross = 2 * (ink * dx * dy).sum(), (ink * (dx**2 - dy**2)).sum()
    off = np.arctan2(*cross) / 2 - body.axis[0]
    assert abs((off + np.pi / 2) % np.pi - np.pi / 2) < 0.03


STILL = PictureLook(width=160, height=120, vignetting=0.0, noise=0.0)
NOBODY = np.array([False])


def empty(look, seconds=0.0, seed=1):
    """A picture without cells, at a time [s]."""
    cells = Swimmers.drawn(np.random.default_rng(1), 1)
    picture = DishPainter(look, seed).picture(cells, [bodies(cells)], NOBODY, seconds)
    return picture.astype(float)


def test_a_picture_without_cells_is_the_light_alone():
    assert (empty(STILL) == STILL.light).all()
    shifted, _ = drawn(replace(STILL, corner_um=(5000.0, 0.0)))  # the cell is outside
    assert (shifted == STILL.light).all()


def test_a_body_in_focus_is_as_dark_as_the_contrast_says_and_a_blurred_one_spreads():
    picture, body = drawn(STILL, depth=0.0, helix_um=0.0)
    assert picture.min() == pytest.approx(STILL.light - STILL.contrast, abs=4)
    bright, _ = drawn(replace(STILL, bright=True, light=50.0), depth=0.0, helix_um=0.0)
    assert bright.max() == pytest.approx(50.0 + STILL.contrast, abs=4)
    blurred, _ = drawn(replace(STILL, focus_um=150.0), depth=0.0, helix_um=0.0)
    above, _ = drawn(replace(STILL, focus_um=-150.0), depth=0.0, helix_um=0.0)
    changed = [(np.abs(image - STILL.light) > 2).sum() for image in (picture, blurred, above)]
    assert changed[1] > 1.5 * changed[0]
    assert changed[1] == changed[2]
    assert body.tilt[0] == 0.0


def test_a_blur_is_as_wide_on_the_dish_in_pictures_of_any_scale():
    def blurred_um2(um_px):
        side = round(400 / um_px)
        look = replace(STILL, width=side, height=side, um_px=um_px, focus_um=300.0)
        picture, _ = drawn(look, depth=0.0, helix_um=0.0)
        return (look.light - picture).sum() * um_px**2, (look.light - picture).max()

    ink, darkest = blurred_um2(2.0)
    finer_ink, finer_darkest = blurred_um2(1.0)
    assert finer_ink == pytest.approx(ink, rel=0.03)
    assert finer_darkest == pytest.approx(darkest, abs=2)


@pytest.mark.parametrize("turn", [0.0, 0.5, -0.7])
def test_a_speck_has_its_place_its_width_and_its_direction(turn):
    speck = RenderedSpeck(180.0, 130.0, 40.0, 2.0, turn, 0.5)
    look = replace(STILL, specks=(speck,))
    ink = STILL.light - empty(look)
    assert ink.max() == pytest.approx(0.5 * STILL.contrast, abs=1.5)
    rows, columns = np.nonzero(ink > ink.max() / 2)
    x = (columns + 0.5) * look.um_px
    y = (look.height - 0.5 - rows) * look.um_px
    assert (x.mean(), y.mean()) == pytest.approx((180.0, 130.0), abs=0.5)
    along = (x - 180.0) * np.cos(turn) + (y - 130.0) * np.sin(turn)
    aside = (y - 130.0) * np.cos(turn) - (x - 180.0) * np.sin(turn)
    assert np.abs(along).max() == pytest.approx(40.0, abs=2 * look.um_px)
    assert np.abs(aside).max() == pytest.approx(20.0, abs=2 * look.um_px)


def test_a_drifting_speck_moves_and_one_at_rest_stays():
    at_rest = RenderedSpeck(100.0, 130.0, 30.0, 1.0, 0.0, 1.0)
    drifting = RenderedSpeck(250.0, 130.0, 30.0, 1.0, 0.0, 1.0, drift=(5.0, -3.0))
    look = replace(STILL, specks=(at_rest, drifting))
    for seconds in (0.0, 4.0):
        ink = STILL.light - empty(look, seconds)
        rows, columns = np.indices(ink.shape)
        x = (columns + 0.5) * look.um_px
        y = (look.height - 0.5 - rows) * look.um_px
        left = ink * (x < 175)
        right = ink * (x >= 175)
        assert (x * left).sum() / left.sum() == pytest.approx(100.0, abs=0.5)
        middle = (x * right).sum() / right.sum(), (y * right).sum() / right.sum()
        assert middle == pytest.approx((250 + 5 * seconds, 130 - 3 * seconds), abs=0.5)


@pytest.mark.parametrize("is_bright", [False, True])
def test_the_rim_of_a_bubble_is_bright(is_bright):
    bubble = RenderedSpeck(180.0, 130.0, 120.0, 1.0, 0.0, 0.1, rim=True)
    picture = empty(replace(STILL, bright=is_bright, light=80.0, specks=(bubble,)))
    row = picture[int(STILL.height - 0.5 - 130.0 / STILL.um_px)]
    rim = [row[int((180.0 + side * 60.0) / STILL.um_px)] for side in (-1, 1)]
    assert min(rim) > 80.0 + 0.4 * STILL.contrast
    assert abs(row[int(180.0 / STILL.um_px)] - 80.0) < 0.2 * STILL.contrast


def test_corners_are_darker_and_the_light_drifts_and_flickers():
    look = replace(STILL, vignetting=0.25)
    picture = empty(look)
    corners = picture[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert corners == pytest.approx(look.light * 0.75, abs=1)
    assert picture[60, 80] == pytest.approx(look.light, abs=1)
    assert picture[60, 0] == pytest.approx(look.light * 0.875, abs=1)
    drifts = replace(STILL, light_drift=0.01)
    assert empty(drifts, 10.0).mean() == pytest.approx(1.1 * STILL.light, abs=1)
    flickers = replace(STILL, flicker=0.05)
    levels = [empty(flickers, seconds).mean() for seconds in np.arange(10) / 1000]
    assert max(levels) == pytest.approx(1.05 * STILL.light, abs=2)
    assert min(levels) == pytest.approx(0.95 * STILL.light, abs=2)
    assert empty(flickers, 0.013).mean() == pytest.approx(empty(flickers, 0.003).mean(), abs=1)


def test_noise_is_as_large_as_stated_and_new_in_each_picture():
    noisy = replace(STILL, noise=4.0)
    assert empty(noisy).std() == pytest.approx(4.0, rel=0.05)
    cells = Swimmers.drawn(np.random.default_rng(1), 1)
    painter = DishPainter(noisy, 1)
    pictures = [painter.picture(cells, [bodies(cells)], NOBODY, 0.0) for _ in range(2)]
    assert (pictures[0] != pictures[1]).any()
    assert (empty(noisy, seed=1) == empty(noisy, seed=1)).all()
    assert (empty(noisy, seed=1) != empty(noisy, seed=2)).any()


def test_a_look_that_is_changed_shows_in_the_next_picture():
    cells = Swimmers.drawn(np.random.default_rng(1), 1)
    painter = DishPainter(STILL)
    speck = RenderedSpeck(180.0, 130.0, 40.0, 1.0, 0.0, 1.0)
    for look in (STILL, replace(STILL, specks=(speck,), vignetting=0.2), STILL):
        painter.change(look)
        picture = painter.picture(cells, [bodies(cells)], NOBODY, 0.0)
        assert (picture == empty(look)).all()


def test_random_looks_are_within_their_ranges_and_fill_the_picture():
    for seed in range(20):
        look = PictureLook.sample(np.random.default_rng(seed), 200)
        assert 2.0 <= look.um_px <= 5.0
        assert (look.light < 100) == look.bright
        *specks, bubble = look.specks
        assert 5 <= len(specks) <= 50
        assert bubble.rim
        assert not any(speck.rim for speck in specks)
        assert all(0 <= value <= 200 * look.um_px for s in look.specks for value in (s.x, s.y))
        assert any(speck.x > 100 * look.um_px for speck in look.specks)
    assert PictureLook.sample(np.random.default_rng(1), 200, 3.5).um_px == 3.5


@pytest.mark.long
def test_the_same_seed_gives_the_same_film_and_its_pairs_cross():
    first, again = (film(seed=3, side=256, seconds=1.0) for _ in "ab")
    for a, b in zip(first.pictures(), again.pictures(), strict=True):
        assert (a == b).all()
    synthetic = film(seed=4, side=512, seconds=6.0, cells=6)
    for i in (0, 2, 4):
        gaps = np.linalg.norm(synthetic.body[:, i, :2] - synthetic.body[:, i + 1, :2], axis=1)
        assert gaps.min() < 40
