"""Synthetic pictures of a dish: where bodies are drawn, and that films repeat."""

import numpy as np
import pytest
from testkit.microscope.dish_films import film
from tetractl_emulator.pictures.dish.picture import DishPainter, PictureLook

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


@pytest.mark.long
def test_the_same_seed_gives_the_same_film_and_its_pairs_cross():
    first, again = (film(seed=3, side=256, seconds=1.0) for _ in "ab")
    for a, b in zip(first.pictures(), again.pictures(), strict=True):
        assert (a == b).all()
    synthetic = film(seed=4, side=512, seconds=6.0, cells=6)
    for i in (0, 2, 4):
        gaps = np.linalg.norm(synthetic.body[:, i, :2] - synthetic.body[:, i + 1, :2], axis=1)
        assert gaps.min() < 40
