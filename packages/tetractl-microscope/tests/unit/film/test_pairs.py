"""Cells that were in another cell's blob before they were first seen."""

import math

import numpy as np
import pytest
from support.film_rows import recorded
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.film.pairs import fill_pairs
from tetractl_microscope.film.who import Parting, Whereabouts

pytestmark = pytest.mark.slow

BODY_UM = 50.0
LONG = 52.0
WIDE = 26.0
APART_AT = 30  # the picture in which the second cell has a blob of its own
TIMES = [k / 30 for k in range(45)]


def cell_on(track: int, x: float, y: float, long: float = LONG, wide: float = WIDE) -> SeenCell:
    """A cell that moves along x on a track, with a blob of a length and width [um]."""
    return SeenCell(
        identity=track,
        x=x,
        y=y,
        axis=0.0,
        heading=0.0,
        mean=np.zeros(12),
        sd=np.zeros(12),
        probability=1.0,
        has_blob=True,
        merged=False,
        long_um=LONG,
        wide_um=WIDE,
        track=track,
        measured=None,
        blob_um=np.array((x, y, 0.0, long, wide)),
    )


def film(apart_um: list[float]) -> list[dict[int, SeenCell]]:
    """Return pictures of two cells, one above the other by `apart_um`, in one blob until they are
    36 um apart, and of a third one far away.
    """
    pictures: list[dict[int, SeenCell]] = []
    for k, apart in enumerate(apart_um):
        x = 300.0 + 10 * k
        picture = {3: cell_on(3, x, 900.0)}
        if k < APART_AT:  # the second moment of two bodies: their own, and that of the distance
            wide = math.sqrt(WIDE**2 + 4 * apart**2)
            picture[1] = cell_on(1, x, 100.0 + apart / 2, LONG, wide)
        else:
            picture[1] = cell_on(1, x, 100.0)
            picture[2] = cell_on(2, x, 100.0 + apart)
        pictures.append(picture)
    return pictures


def filled(pictures: list[dict[int, SeenCell]]) -> tuple[set[int], Whereabouts]:
    """Return the tracks of cells that were added to pictures, and the record."""
    where = recorded(pictures, TIMES)
    where.partings = [Parting(APART_AT, 2, 1)]
    return fill_pairs(where, BODY_UM), where


def test_both_cells_of_a_large_blob_are_in_the_pictures_before_they_part() -> None:
    added, where = filled(film([24.0] * APART_AT + [36.0] * 15))
    assert added == {2}
    before = [where.shown_in(k) for k in range(APART_AT)]
    for row_of in before:
        assert (row_of[2].cell.y, row_of[1].cell.y) == pytest.approx((124.0, 100.0))
        assert row_of[2].cell.x == row_of[1].cell.x
        assert row_of[1].likely == row_of[2].likely == 0.5
    names = {(row_of[1].name, row_of[2].name) for row_of in before}
    assert len(names) == 1
    assert len({*names.pop(), 1, 2, 3}) == 5
    assert [row.name for row in where.tracks[1][APART_AT:]] == [1] * 15


def test_a_blob_that_was_large_once_has_shown_both_since_then() -> None:
    added, where = filled(film([20.0] * 5 + [0.0] * 25 + [36.0] * 15))
    assert added
    assert [row.picture for row in where.tracks[2]] == list(range(45))


def test_cells_that_one_covers_the_other_have_other_names_before() -> None:
    added, where = filled(film([24.0] * 14 + [0.0] * 3 + [24.0] * 13 + [36.0] * 15))
    assert added
    for rows in (where.tracks[1], where.tracks[2]):
        assert rows[13].name == rows[0].name != rows[17].name


@pytest.mark.parametrize(
    ("apart_um", "why"),
    [
        ([0.0] * APART_AT + [36.0] * 15, "its blob was never too large for one: it has divided"),
        ([0.0] * 25 + [24.0] * 5 + [36.0] * 15, "they were together for too short a time"),
        ([0.0] * 10 + [24.0] * 2 + [0.0] * 18 + [36.0] * 15, "two large blobs may be an error"),
    ],
)
def test_a_cell_is_not_added_where_blobs_do_not_say_so(apart_um: list[float], why: str) -> None:
    added, where = filled(film(apart_um))
    assert not added, why
    assert where.tracks[2][0].picture == APART_AT


def test_a_large_blob_says_nothing_where_sizes_vary_as_much() -> None:
    pictures = film([24.0] * APART_AT + [36.0] * 15)
    random = np.random.default_rng(1)
    longer = np.exp(random.normal(0.0, 0.4, (len(pictures), 4)))
    for k, picture in enumerate(pictures):
        for i in range(4):
            picture[3 + i] = cell_on(3 + i, 300.0, 500.0 + 100 * i, LONG * longer[k, i])
    added, _ = filled(pictures)
    assert not added
