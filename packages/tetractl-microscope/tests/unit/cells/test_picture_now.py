"""Tests of positions in an image, as columns and rows and in um."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.cells.picture_now import GAP_MIN_S, GAP_PERIODS, NewestImage

NOW = NewestImage(seconds=3.0, since_previous_s=0.2, um_px=2.5, height=80, width=120)
columns = st.floats(0, 119)
rows = st.floats(0, 79)


def blob(column, row, axis=0.0):
    pixels = np.array([[column, row], [column + 1, row + 2]])
    return SimpleNamespace(x=column, y=row, axis=axis, length=10.0, width=4.0, pixels=pixels)


@given(columns, rows, st.floats(-1.5, 1.5))
def test_a_place_and_its_pixel_are_the_same_both_ways(column, row, axis):
    (place,) = NOW.places_of([blob(column, row, axis)])
    assert tuple(place) == pytest.approx(
        ((column + 0.5) * 2.5, (80 - 0.5 - row) * 2.5, -axis, 25.0, 10.0)
    )
    assert NOW.pixels_of(place[None])[0] == pytest.approx((column, row))
    points = NOW.points_of(blob(column, row))
    assert points[0] == pytest.approx(place[:2])
    assert points[1] - points[0] == pytest.approx((2.5, -5.0))  # y points up


def test_no_blobs_have_no_places():
    assert NOW.places_of([]).shape == (0, 5)


@given(columns, rows)
def test_the_distance_to_the_edge_is_that_to_the_nearest_of_four(column, row):
    x, y = (column + 0.5) * 2.5, (80 - 0.5 - row) * 2.5
    left, right = column + 0.5, 120 - 0.5 - column
    above, below = row + 0.5, 80 - 0.5 - row
    assert NOW.edge_distance_um(x, y) == pytest.approx(2.5 * min(left, right, above, below))


@pytest.mark.parametrize(("passed_s", "brief_s"), [(0.01, GAP_MIN_S), (0.2, GAP_PERIODS * 0.2)])
def test_one_missing_picture_says_nothing(passed_s, brief_s):
    assert NewestImage(1.0, passed_s, 1.0, 10, 10).short_gap_s == brief_s
