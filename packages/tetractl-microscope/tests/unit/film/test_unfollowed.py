"""How much of what moves is not followed, in films whose truth is known."""

import numpy as np
import pytest
from support.film_rows import seen_cell
from tetractl_microscope.cells.detect_cells import Blob
from tetractl_microscope.film.unfollowed import BLOBS_MIN, EVERY, Unfollowed
from tetractl_microscope.film.who import CellPath

UM_PX = 2.0
BODY_UM = 50.0
SIDE = 200
COUNT = 90
# of a body [px]
LONG = 25
WIDE = 12
LIMIT = 4.0  # difference that is noise [grey levels]
STEP_PX = 4  # way from one picture to the next


def middle(lane, number):
    """Column and row of a body: lanes 0 and 1 swim, lane 2 rests."""
    way = STEP_PX * (40 - abs(40 - number % 80))  # to and fro
    return (20 + way if lane < 2 else 100), 40 + 60 * lane


def picture(number):
    grey = np.full((SIDE, SIDE), 200, np.uint8)
    for lane in range(3):
        column, row = middle(lane, number)
        grey[row - WIDE // 2 : row + WIDE // 2, column - LONG // 2 : column + LONG // 2] = 120
    return grey


def path(lane):
    gathered = []
    for number in range(COUNT):
        column, row = middle(lane, number)
        gathered.append(seen_cell(lane, (column + 0.5) * UM_PX, (SIDE - 0.5 - row) * UM_PX, lane))
    frames = np.arange(COUNT)
    return CellPath(lane, frames / 30, frames, tuple(gathered))


def share_not_followed(paths):
    """The share that is counted of the bodies of all lanes."""
    counted = Unfollowed()
    for number in range(COUNT):
        places = [middle(lane, number) for lane in range(3)]
        body = np.ones((1, 1), np.uint8)
        blobs = [Blob(x, y, 0.0, LONG, WIDE, 80.0, body, (0, 0), False) for x, y in places]
        counted.add(number, number / 30, LIMIT, blobs)
    pictures = [(number, picture(number)) for number in range(COUNT)]
    return counted.share(pictures, paths, UM_PX, BODY_UM)


@pytest.mark.parametrize(("lanes", "share"), [((0, 1), 0.0), ((0,), 0.5), ((0, 2), 0.5)])
def test_the_share_of_what_moves_without_a_path_is_counted(lanes, share):
    paths = [path(lane) for lane in lanes]
    assert share_not_followed(paths) == pytest.approx(share, abs=0.02)


def test_no_share_is_stated_of_few_blobs_or_without_a_path():
    counted = Unfollowed()
    assert counted.share([], [path(0)], UM_PX, BODY_UM) is None
    blob = Blob(100.0, 40.0, 0.0, LONG, WIDE, 80.0, np.ones((1, 1), np.uint8), (0, 0), False)
    for number in range(EVERY * BLOBS_MIN // 2):
        counted.add(number, number / 30, LIMIT, [blob])
    assert counted.share([], [], UM_PX, BODY_UM) is None
    assert counted.share([(0, picture(0))], [path(0)], UM_PX, BODY_UM) is None
