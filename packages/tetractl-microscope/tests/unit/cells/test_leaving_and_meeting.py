"""Tests of the live tracker with a cell that leaves the image, and with two cells that meet."""

import numpy as np
import pytest
from testkit.microscope.needs_opencv import cv2
from tetractl_microscope.cells.identity_watch import KNOWN_PROBABILITY
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.tracks.field_file import no_field

pytestmark = pytest.mark.slow

UM_PX = 2.0
TALL = 240
WIDE = 320
COUNT = 60
HALF_LONG = 13  # half the length of a cell [px]
HALF_WIDE = 6
STEP_PX = 6.5  # a picture: 390 um/s
HZ = 30.0
KNOWN = 8  # pictures in which a cell is recognised


def seen(middles):
    """What the tracker sees of cells whose `middles` [px] (COUNT, cells, 2) swim straight."""
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
    tracker = CellTracker(UM_PX, field_known=False)
    tracker.finder.learn(pictures[::4])
    return [tracker.track_image(picture, k / HZ, no_field) for k, picture in enumerate(pictures)]


def pixels(cell):
    """Column and row of a cell."""
    return np.array((cell.x / UM_PX - 0.5, TALL - 0.5 - cell.y / UM_PX))


def test_a_cell_that_leaves_the_picture_ends_there():
    """Regression: a position called found was up to 88 px outside the picture."""
    along = 60 + STEP_PX * np.arange(COUNT)
    middles = np.stack([along, np.full(COUNT, 120.0)], axis=-1)[:, None]
    shown = seen(middles)
    leaves = int(np.argmax(along - HALF_LONG > WIDE))
    assert [len(cells) for cells in shown[KNOWN : leaves - 2]] == [1] * (leaves - 2 - KNOWN)
    assert not any(shown[leaves + 8 :])
    for k, cells in enumerate(shown):
        for cell in cells:
            if cell.has_blob:
                column, _ = pixels(cell)
                assert 0 <= column <= WIDE
                assert np.hypot(*(pixels(cell) - middles[k, 0])) < HALF_LONG


def test_two_cells_that_meet_are_both_followed_and_no_sure_number_changes_its_cell():
    way = STEP_PX * (np.arange(COUNT) - COUNT / 2) * 0.7
    first = np.stack([160 + way, 120 + 0.6 * way], axis=-1)
    second = np.stack([160 + way, 120 - 0.6 * way], axis=-1)
    middles = np.stack([first, second], axis=1)
    apart = np.linalg.norm(first - second, axis=1) > 3 * HALF_LONG
    apart[:KNOWN] = False
    cells_of = {}
    followed = 0
    for k, cells in enumerate(seen(middles)):
        for cell in cells:
            away = np.linalg.norm(middles[k] - pixels(cell), axis=1)
            if apart[k] and away.min() < HALF_LONG:
                followed += 1
                if cell.probability >= KNOWN_PROBABILITY:
                    cells_of.setdefault(cell.identity, set()).add(int(away.argmin()))
    assert followed >= 0.9 * 2 * apart.sum()
    assert all(len(cells) == 1 for cells in cells_of.values())
