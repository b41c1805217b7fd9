"""Whole films, drawn here, of a cell that leaves the picture and of two that meet."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.dish_films import Reel
from support.needs_opencv import cv2
from tetractl_microscope.film.follow import follow
from tetractl_microscope.organisms import TETRAHYMENA

pytestmark = pytest.mark.slow

UM_PX = 2.0
TALL = 240
WIDE = 320
COUNT = 60
HALF_LONG = 13  # half the length of a cell [px]
HALF_WIDE = 6
STEP_PX = 6.5  # a picture: 390 um/s
HZ = 30.0


def tracked(middles):
    """Follow cells whose `middles` [px] (COUNT, cells, 2) swim straight on grey ground."""
    headings = np.arctan2(*np.moveaxis(middles[-1] - middles[0], -1, 0)[::-1])
    random = np.random.default_rng(1)
    pictures = []
    for places in middles:
        picture = np.full((TALL, WIDE), 160, np.uint8)
        for (x, y), heading in zip(places, headings, strict=True):
            size = HALF_LONG, HALF_WIDE
            middle = round(x), round(y)
            cv2.ellipse(picture, middle, size, np.degrees(heading), 0, 360, 100, -1)
        noisy = picture + random.normal(0, 2, picture.shape)
        pictures.append(np.clip(noisy, 0, 255).astype(np.uint8))
    script = SimpleNamespace(script=SimpleNamespace(rate=HZ))
    return follow(Reel(script, pictures), UM_PX, None, TETRAHYMENA)


def pixels(cell):
    """Column and row of a cell."""
    return np.array((cell.x / UM_PX - 0.5, TALL - 0.5 - cell.y / UM_PX))


def test_a_cell_that_leaves_the_picture_ends_there():
    """Regression: a position called found was up to 88 px outside the picture."""
    along = 60 + STEP_PX * np.arange(COUNT)
    middles = np.stack([along, np.full(COUNT, 120.0)], axis=-1)[:, None]
    (path,) = tracked(middles).paths
    leaves = int(np.argmax(along - HALF_LONG > WIDE))
    assert path.frames[0] <= 3
    assert abs(path.frames[-1] - leaves) <= 2
    for _, frame, cell in path.pictures():
        if cell.has_blob:
            column, _ = pixels(cell)
            assert 0 <= column <= WIDE
            assert np.hypot(*(pixels(cell) - middles[frame, 0])) < HALF_LONG


def test_two_cells_that_meet_are_both_followed_and_no_sure_number_changes_its_cell():
    way = STEP_PX * (np.arange(COUNT) - COUNT / 2) * 0.7
    first = np.stack([160 + way, 120 + 0.6 * way], axis=-1)
    second = np.stack([160 + way, 120 - 0.6 * way], axis=-1)
    middles = np.stack([first, second], axis=1)
    apart = np.linalg.norm(first - second, axis=1) > 3 * HALF_LONG
    cells_of = {}
    followed = 0
    for path in tracked(middles).paths:
        for _, frame, cell in path.pictures():
            away = np.linalg.norm(middles[frame] - pixels(cell), axis=1)
            if apart[frame] and away.min() < HALF_LONG:
                followed += 1
                if cell.sure:
                    cells_of.setdefault(path.identity, set()).add(int(away.argmin()))
    assert followed >= 0.9 * 2 * apart.sum()
    assert all(len(cells) == 1 for cells in cells_of.values())
