"""Tests of specks that become cells, or are forgotten."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack, TrackBlob
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.kernels.helix_steps import HEADING, SPEED, X, Y
from tetractl_microscope.cells.meetings import SPLIT_REACH
from tetractl_microscope.cells.names import CellIdentities
from tetractl_microscope.cells.newcomers import EDGE_ENTRY_LENGTHS, HIDDEN_S, FreeBlob, Newcomers
from tetractl_microscope.cells.picture_now import NewestImage
from tetractl_microscope.cells.readings import PATH_BLOBS
from tetractl_microscope.cells.specks import BLOBS_TO_JUDGE
from tetractl_microscope.organisms import TETRAHYMENA

LONG_UM, WIDE_UM = TETRAHYMENA.body_um
STEP_S = 1 / 25
SPEED_UM_S = 300.0


class Dish:
    """A picture of 2000 um x 1600 um every 40 ms, and the specks in it."""

    def __init__(self):
        self.bank = HelixFilter(field_known=False)
        self.names = CellIdentities(self.bank, LONG_UM)
        self.newcomers = Newcomers(self.bank, self.names, TETRAHYMENA)
        self.cells = []
        self.seconds = 10.0

    def cell(self, x, y):
        row = self.bank.add(x, y, 0.0, 300.0)
        cell = CellTrack(100 + row, row, BodySize(LONG_UM, WIDE_UM), last_um=np.array([x, y]))
        cell.identity = self.names.new_identity()
        self.cells.append(cell)
        return cell

    def show(self, *blobs):
        """Show an image with blobs (x, y, speck)."""
        self.seconds += STEP_S
        now = NewestImage(self.seconds, STEP_S, 2.0, height=800, width=1000)
        shown = {id(speck) for _, _, speck in blobs}
        for speck in self.newcomers.specks:
            speck.missed_s = 0.0 if id(speck) in shown else speck.missed_s + STEP_S
        free = [FreeBlob(blob_at(x, y), speck) for x, y, speck in blobs]
        new = self.newcomers.update(free, self.cells, now)
        self.cells += new
        return new

    def appear(self, x, y):
        self.show((x, y, None))
        return self.newcomers.specks[-1]

    def swim(self, speck, x, y, images, heading=0.0, speed=SPEED_UM_S):
        """Let a speck swim on from x, y, and return the cells that it becomes."""
        born = []
        for k in range(1, images + 1):
            way = speed * STEP_S * k
            born += self.show((x + way * math.cos(heading), y + way * math.sin(heading), speck))
        return born


def blob_at(x, y, cut=False):
    blob = SimpleNamespace(at_edge=cut)
    return TrackBlob(0, blob, np.array([x, y, 0.2, LONG_UM, WIDE_UM]))


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_a_speck_that_swims_becomes_a_cell_at_its_place_with_its_speed(heading):
    dish = Dish()
    speck = dish.appear(900.0, 800.0)
    assert dish.swim(speck, 900.0, 800.0, BLOBS_TO_JUDGE - 2, heading) == []
    assert dish.newcomers.born == []
    way = SPEED_UM_S * STEP_S * (BLOBS_TO_JUDGE - 2)
    x, y = 900 + way * math.cos(heading), 800 + way * math.sin(heading)
    (cell,) = dish.swim(speck, x, y, 1, heading)
    state = dish.bank.means[cell.row]
    way += SPEED_UM_S * STEP_S
    there = (900 + way * math.cos(heading), 800 + way * math.sin(heading))
    assert state[[X, Y]] == pytest.approx(there)
    assert state[HEADING] == pytest.approx(heading)
    assert state[SPEED] == pytest.approx(SPEED_UM_S)
    assert cell.last_um == pytest.approx(there) and cell.start_um == pytest.approx(there)
    assert cell.size == pytest.approx((LONG_UM, WIDE_UM))
    assert cell.began_s == cell.size_seen_s == pytest.approx(dish.seconds)
    assert cell.number == speck.number and cell.identity == 1
    (born,) = dish.newcomers.born
    assert (born.identity, born.track, born.mother) == (1, cell.number, None)
    assert dish.newcomers.specks == []
    dish.show()
    assert dish.newcomers.born == []


def test_a_speck_that_rests_becomes_no_cell():
    dish = Dish()
    speck = dish.appear(900.0, 800.0)
    assert dish.swim(speck, 900.0, 800.0, 30, speed=0.0) == []
    assert len(speck.path) == PATH_BLOBS
    assert speck.path[-1].seconds == pytest.approx(dish.seconds)
    assert dish.bank.is_used.sum() == 0


def test_each_object_that_was_not_seen_before_is_a_speck_of_its_own():
    dish = Dish()
    dish.show((300.0, 300.0, None), (700.0, 300.0, None))
    first, second = dish.newcomers.specks
    assert (first.number, second.number) == (1, 2)
    dish.show((300.0, 300.0, first), (900.0, 300.0, None))
    assert [speck.number for speck in dish.newcomers.specks] == [1, 2, 3]
    now = NewestImage(dish.seconds, STEP_S, 2.0, 800, 1000)
    assert dish.newcomers.positions_in_view(now) == [(300.0, 300.0), (700.0, 300.0), (900.0, 300.0)]


@pytest.mark.parametrize(("share", "is_near"), [(0.95, True), (1.05, False)])
def test_a_speck_is_near_the_nearest_cell_within_a_length_and_a_half(share, is_near):
    dish = Dish()
    dish.cell(1500.0, 400.0)
    cell = dish.cell(500.0, 500.0)
    speck = dish.appear(500.0, 500.0 + share * SPLIT_REACH * LONG_UM)
    assert speck.first_near is (cell if is_near else None)
    assert dish.newcomers.cells_awaiting_specks() == ([cell] if is_near else [])


def test_a_cell_is_awaited_until_the_speck_should_have_swum():
    dish = Dish()
    cell = dish.cell(500.0, 500.0)
    speck = dish.appear(510.0, 500.0)
    dish.swim(speck, 510.0, 500.0, BLOBS_TO_JUDGE - 1, speed=0.0)
    assert len(speck.path) == BLOBS_TO_JUDGE and dish.newcomers.cells_awaiting_specks() == [cell]
    dish.swim(speck, 510.0, 500.0, 1, speed=0.0)
    assert dish.newcomers.cells_awaiting_specks() == []


@pytest.mark.parametrize(
    ("from_edge", "divided"), [(0.9 * EDGE_ENTRY_LENGTHS, False), (1.1 * EDGE_ENTRY_LENGTHS, True)]
)
def test_a_cell_from_another_s_blob_has_divided_unless_it_may_have_entered(from_edge, divided):
    dish = Dish()
    x = from_edge * LONG_UM
    mother = dish.cell(x, 800.0)
    speck = dish.appear(x, 800.0)
    (cell,) = dish.swim(speck, x, 800.0, BLOBS_TO_JUDGE - 1)
    (born,) = dish.newcomers.born
    assert born.mother == (mother.identity if divided else None)
    assert (mother.certainty < 1.0) is divided
    assert cell.identity != mother.identity


def test_a_cell_whose_mother_is_gone_has_not_divided():
    dish = Dish()
    mother = dish.cell(800.0, 800.0)
    speck = dish.appear(800.0, 800.0)
    dish.swim(speck, 800.0, 800.0, BLOBS_TO_JUDGE - 2)
    dish.cells.remove(mother)
    way = SPEED_UM_S * STEP_S * (BLOBS_TO_JUDGE - 2)
    dish.swim(speck, 800.0 + way, 800.0, 1)
    assert dish.newcomers.born[0].mother is None and mother.certainty == 1.0


def hidden(dish, seconds):
    for _ in range(round(seconds / STEP_S)):
        dish.show()


def test_a_speck_of_few_images_is_dropped_soon_and_a_known_one_after_3_s():
    dish = Dish()
    known = dish.appear(300.0, 300.0)
    dish.swim(known, 300.0, 300.0, PATH_BLOBS, speed=0.0)
    new = dish.appear(700.0, 300.0)
    dish.show((300.0, 300.0, known), (700.0, 300.0, new))
    hidden(dish, 2 * STEP_S)
    assert dish.newcomers.specks == [known, new]
    hidden(dish, HIDDEN_S - 4 * STEP_S)
    assert dish.newcomers.specks == [known]
    now = NewestImage(dish.seconds, STEP_S, 2.0, 800, 1000)
    assert dish.newcomers.positions_in_view(now) == []
    hidden(dish, 5 * STEP_S)
    assert dish.newcomers.specks == []


def test_a_speck_that_was_hidden_begins_a_new_path():
    dish = Dish()
    speck = dish.appear(300.0, 300.0)
    dish.swim(speck, 300.0, 300.0, PATH_BLOBS, speed=0.0)
    hidden(dish, 1.0)
    assert dish.newcomers.specks == [speck]
    dish.show((300.0, 300.0, speck))
    assert len(speck.path) == 1
    dish.show()
    dish.show((300.0, 300.0, speck))
    assert len(speck.path) == 2  # one missing image says nothing


def test_specks_move_with_the_content_of_the_image():
    dish = Dish()
    speck = dish.appear(300.0, 200.0)
    dish.newcomers.move_by(5.0, -7.0)
    assert speck.path[-1][1:3] == (305.0, 193.0)


@pytest.mark.parametrize("cut", [True, False])
def test_a_blob_that_is_cut_off_has_no_size_in_a_path(cut):
    entry = FreeBlob(blob_at(3.0, 4.0, cut), None).path_entry(1.5)
    assert entry[:4] == (1.5, 3.0, 4.0, 0.2)
    assert math.isnan(entry.length) == math.isnan(entry.width) == cut
