"""A lost cell is recognised where it may be by its size, and never with certainty."""

import numpy as np
import pytest

from tetractl.lab.cameras.cells.cell import FollowedCell
from tetractl.lab.cameras.cells.helix import HelixFilter
from tetractl.lab.cameras.cells.identity import PATIENCE_S
from tetractl.lab.cameras.cells.lost_cells import MOST, REMEMBERED_S, LostCells
from tetractl.lab.cameras.cells.merges import Merges

RARE = 0.3 / 2355**2  # density [1/um^2] with which other cells appear


@pytest.fixture
def lost():
    bank = HelixFilter()
    cell = FollowedCell(7, 7, bank.add(500.0, 500.0, 0.0, 400.0), 50.0, 25.0)
    cell.last = np.array([500.0, 500.0])
    cells = LostCells(bank)
    cells.add(cell, 10.0)
    bank.predict([(1.0, 0.0, 0.0)])
    return cells


@pytest.mark.parametrize("place", [(505.0, 490.0), (900.0, 500.0)])
def test_it_is_found_where_it_rested_and_where_the_signal_led_it(lost, place):
    cell, probability = lost.found(np.array(place), (51.0, 25.0), 11.0, RARE)
    assert cell.identity == 7 and 0.5 < probability <= MOST
    assert lost.found(np.array(place), (51.0, 25.0), 11.0, RARE) is None  # it is taken once


@pytest.mark.parametrize(
    "place, size, elsewhere",
    [
        ((505.0, 490.0), (35.0, 38.0), RARE),  # another size
        ((505.0, 1600.0), (51.0, 25.0), RARE),  # too far away
        ((505.0, 490.0), (51.0, 25.0), 0.1),  # where many others appear
    ],
)
def test_another_cell_is_not_taken_for_it(lost, place, size, elsewhere):
    assert lost.found(np.array(place), size, 11.0, elsewhere) is None


def test_the_longer_it_is_lost_the_farther_away_it_may_be(lost):
    place = np.array([500.0, 1200.0])
    assert lost.found(place, (50.0, 25.0), 11.0, RARE) is None
    assert lost.found(place, (50.0, 25.0), 12.0, RARE)


def test_it_is_forgotten(lost):
    lost.forget(10.1 + REMEMBERED_S)
    assert lost.found(np.array([505.0, 490.0]), (51.0, 25.0), 13.2, RARE) is None
    assert not lost.bank.used.any()


def test_each_meeting_lowers_the_certainty_of_who_is_who():
    bank, seen = HelixFilter(), np.array([(500.0, 500.0, 0.0), (503.0, 500.0, 0.0)])
    cells = [FollowedCell(i, i, bank.add(*seen[i], 400.0), 50.0, 25.0) for i in (0, 1)]
    merges = Merges(bank)
    for seconds in (20.0, 40.0):
        merges.watch(cells[0], True, False, seconds)
        merges.ask(*cells, seen, seconds, cells)
        merges.answer(cells, seconds + PATIENCE_S + 1)
    one, two = (answer.probability for answer in merges.closed)
    assert max(one, two) < 0.9
    assert cells[0].certainty == cells[1].certainty == pytest.approx(one * two)
