"""Tests of the live tracker with cells that are drawn: when they begin, hide, knock and end."""

import math

import numpy as np
import pytest
from testkit.microscope.needs_opencv import cv2
from tetractl_microscope.cells.tracking import HIDDEN_S, LOST_S, NEW_CELL_LENGTHS, CellTracker
from tetractl_microscope.organisms import TETRAHYMENA
from tetractl_microscope.tracks.field_file import no_field

pytestmark = pytest.mark.slow

UM_PX = 2.0
TALL = 240
WIDE = 480
HZ = 30.0
HALF_LONG = 13  # half the length of a cell [px]
HALF_WIDE = 6
STEP_PX = 5.0  # of each image: 300 um/s
BORN = 5  # images after which an object may be a cell


class Film:
    """Draws and tracks pictures of cells at columns and rows that swim to the right."""

    def __init__(self, specks=40):
        self.random = np.random.default_rng(1)
        self.still = np.full((TALL + 40, WIDE + 40), 160.0)
        for x, y in self.random.integers(0, (WIDE + 40, TALL + 40), (specks, 2)).tolist():
            cv2.circle(self.still, (x, y), 1, 110.0, -1)
        self.tracker = CellTracker(UM_PX, field_known=False)
        self.tracker.finder.learn([self.picture() for _ in range(7)])
        self.count = 0

    def picture(self, *middles, shift=(0, 0)):
        right, down = shift
        picture = self.still[20 - down :, 20 - right :][:TALL, :WIDE].copy()
        for x, y in middles:
            middle = round(8 * (x + right)), round(8 * (y + down))
            size = 8 * HALF_LONG, 8 * HALF_WIDE
            cv2.ellipse(picture, middle, size, 0, 0, 360, 100.0, -1, cv2.LINE_AA, 3)
        return np.clip(picture + self.random.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)

    def show(self, *middles, shift=(0, 0)):
        self.count += 1
        return self.tracker.track_image(
            self.picture(*middles, shift=shift), self.count / HZ, no_field
        )

    def swim(self, x, y, images, step_px=STEP_PX):
        """Show a cell that swims on from x, y, and return what was tracked in each image."""
        return [self.show((x + step_px * k, y)) for k in range(images)]

    def hide(self, images):
        return [self.show() for _ in range(images)]


def pixels(cell):
    return cell.x / UM_PX - 0.5, TALL - 0.5 - cell.y / UM_PX


def test_a_swimming_object_is_a_cell_from_its_fifth_image_with_its_place_and_size():
    film = Film()
    shown = film.swim(60.0, 100.0, 30)
    assert [len(cells) for cells in shown] == [0] * (BORN - 1) + [1] * (31 - BORN)
    for k, cells in enumerate(shown[8:], 8):
        (cell,) = cells
        assert math.dist(pixels(cell), (60 + STEP_PX * k, 100)) < 1.5
        assert abs(cell.heading) < 0.3 and cell.has_blob and not cell.merged
        assert cell.probability == 1.0 and cell.identity == 1
        assert cell.long_um == pytest.approx(2 * HALF_LONG * UM_PX, rel=0.25)
        assert cell.wide_um == pytest.approx(2 * HALF_WIDE * UM_PX, rel=0.4)
        assert math.dist(cell.blob_um[:2], (cell.x, cell.y)) < 8
    assert film.tracker.born == []


def test_a_cell_is_born_once():
    film = Film()
    born = []
    for k in range(12):
        film.show((60.0 + STEP_PX * k, 100.0))
        born.append(len(film.tracker.born))
    assert born == [0] * (BORN - 1) + [1] + [0] * (12 - BORN)


def test_a_hidden_cell_is_reported_for_150_ms_and_found_again_within_half_a_second():
    film = Film()
    film.swim(60.0, 100.0, 30)
    hidden = film.hide(12)
    reported = [len(cells) for cells in hidden]
    assert reported == sorted(reported, reverse=True)
    assert sum(reported) == pytest.approx(HIDDEN_S * HZ, abs=1)
    assert not any(cell.has_blob for cells in hidden for cell in cells)
    (cell,) = film.show((60.0 + STEP_PX * 42, 100.0))
    assert cell.identity == 1 and cell.has_blob


def test_a_cell_that_is_hidden_for_longer_is_another_one_when_it_comes_back():
    film = Film()
    film.swim(60.0, 100.0, 25)
    film.hide(math.ceil(LOST_S * HZ) + 2)
    assert len(film.tracker._cells) == 0 and film.tracker.cell_filter.is_used.sum() == 0
    shown = film.swim(60.0 + STEP_PX * 44, 100.0, 12)
    assert [cell.identity for cell in shown[-1]] == [2]


def test_a_cell_that_has_just_begun_is_lost_soon():
    film = Film()
    film.swim(60.0, 100.0, BORN + 1)
    assert len(film.tracker._cells) == 1
    film.hide(4)
    assert len(film.tracker._cells) == 0


def test_a_cell_at_the_edge_is_lost_soon_and_one_in_the_middle_is_not():
    film = Film()
    film.swim(WIDE - 30 - STEP_PX * 24, 100.0, 30)
    film.hide(4)
    assert len(film.tracker._cells) == 0
    inner = Film()
    inner.swim(60.0, 100.0, 30)
    inner.hide(6)
    assert len(inner.tracker._cells) == 1


def test_an_object_that_stops_soon_after_it_was_seen_to_swim_is_no_cell():
    film = Film()
    way_px = 0.8 * NEW_CELL_LENGTHS * TETRAHYMENA.body_um[0] / UM_PX
    film.swim(60.0, 100.0, 8, step_px=way_px / 8)
    slowest_s = NEW_CELL_LENGTHS * TETRAHYMENA.body_um[0] / TETRAHYMENA.slowest_um_s
    last = [film.show((60.0 + way_px, 100.0)) for _ in range(round(slowest_s * HZ) + 6)]
    assert len(last[0]) == 1 and last[-1] == []


def test_a_cell_that_has_swum_may_rest():
    film = Film()
    film.swim(60.0, 100.0, 25)
    resting = [film.show((60.0 + STEP_PX * 24, 100.0)) for _ in range(45)]
    assert [cell.identity for cell in resting[-1]] == [1]
    (cell,) = resting[-1]
    assert math.dist(pixels(cell), (60 + STEP_PX * 24, 100)) < 3


def test_a_knock_moves_cells_and_loses_none():
    film = Film()
    film.swim(60.0, 100.0, 25)
    for k in range(25, 32):
        (cell,) = film.show((60.0 + STEP_PX * k, 100.0), shift=(9, -6))
        assert cell.identity == 1
        assert math.dist(pixels(cell), (60 + STEP_PX * k + 9, 100 - 6)) < 3


def test_cells_are_numbered_and_listed_in_the_order_of_their_tracks():
    film = Film()
    for k in range(40):
        middles = [(60.0 + STEP_PX * k, 60.0)]
        if k > 10:
            middles.insert(0, (60.0 + STEP_PX * (k - 10), 180.0))
        cells = film.show(*middles)
    assert [cell.identity for cell in cells] == [1, 2]
    assert [cell.track for cell in cells] == sorted(cell.track for cell in cells)
    assert math.dist(pixels(cells[0]), (60 + STEP_PX * 39, 60)) < 2
    assert math.dist(pixels(cells[1]), (60 + STEP_PX * 29, 180)) < 2


def test_the_background_is_kept_in_a_rectangle_around_each_cell():
    film = Film()
    film.swim(60.0, 100.0, 20)
    now = film.tracker._describe_picture(film.picture(), film.count / HZ)
    ((left, top, right, bottom),) = film.tracker._cell_rectangles(now)
    x, y = 60 + STEP_PX * 19, 100
    assert left < x - HALF_LONG and x + HALF_LONG < right
    assert top < y - HALF_LONG and y + HALF_LONG < bottom
    assert right - left == pytest.approx(bottom - top, abs=1)
    assert right - left < 6 * HALF_LONG
    assert (left + right) / 2 == pytest.approx(x, abs=2)
    assert (top + bottom) / 2 == pytest.approx(y, abs=2)
