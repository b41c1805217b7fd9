"""Tests of the geometry of a cell and its blob."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.cells.cell import BodySize, PathBlob, SeenCell, compute_distances_to_edge

lengths = st.floats(1.0, 100.0)
angles = st.floats(-math.pi, math.pi)
NAN = math.nan


def on_ellipse(parameter, axis, long, wide):
    """A point of an ellipse's edge, from its centre."""
    point = long / 2 * math.cos(parameter) + 1j * wide / 2 * math.sin(parameter)
    point *= np.exp(1j * axis)
    return np.array([point.real, point.imag])


@given(angles, angles, lengths, lengths, st.floats(0.01, 5.0))
def test_a_distance_is_relative_to_the_ellipse_s_edge(parameter, axis, long, wide, share):
    off = share * on_ellipse(parameter, axis, long, wide)
    assert compute_distances_to_edge(off, axis, long, wide) == pytest.approx(share)
    assert compute_distances_to_edge(-off, axis, long, wide) == pytest.approx(share)
    assert compute_distances_to_edge(off, axis + math.pi, long, wide) == pytest.approx(share)


def test_many_points_and_ellipses_are_compared_at_once():
    off = np.array([[(5.0, 0.0), (0.0, 5.0)]])
    far = compute_distances_to_edge(
        off, np.array([[0.0], [math.pi / 2]]), np.full((2, 1), 20.0), np.array([[4.0]])
    )
    assert far == pytest.approx(np.array([[0.5, 2.5], [2.5, 0.5]]))


def seen(x, y, blob):
    return SeenCell(1, 1, x, y, 0.0, 0.0, blob_um=None if blob is None else np.array(blob))


BLOB = (100.0, 50.0, math.pi / 2, 40.0, 10.0)


@pytest.mark.parametrize(
    ("place", "on_blob"),
    [
        ((100.0, 50.0), (100.0, 50.0)),
        ((104.0, 50.0), (104.0, 50.0)),  # inside
        ((120.0, 50.0), (105.0, 50.0)),  # beside it
        ((80.0, 50.0), (95.0, 50.0)),
        ((100.0, 69.0), (100.0, 69.0)),
        ((100.0, 110.0), (100.0, 70.0)),
    ],
)
def test_a_cell_beyond_its_blob_is_moved_to_the_edge_towards_the_middle(place, on_blob):
    cell = seen(*place, BLOB).on_blob()
    assert (cell.x, cell.y) == pytest.approx(on_blob)


def test_a_cell_in_a_blob_that_is_cut_off_is_at_its_middle_and_one_without_a_blob_stays():
    cut = seen(140.0, 20.0, (100.0, 50.0, 0.0, NAN, NAN)).on_blob()
    assert (cut.x, cut.y) == pytest.approx((100.0, 50.0), abs=1e-5)
    lone = seen(140.0, 20.0, None)
    assert lone.on_blob() is lone


def test_a_moved_blob_differs_only_in_its_place():
    assert PathBlob(1.0, 2.0, 3.0, 4.0, 5.0, 6.0).moved(10.0, -20.0) == (
        1.0, 12.0, -17.0, 4.0, 5.0, 6.0,
    )  # fmt: skip


def test_the_area_of_a_body_is_length_times_width():
    assert BodySize(12.0, 5.0).area_um2 == 60.0


def test_a_cell_without_a_filter_has_no_state():
    cell = seen(1.0, 2.0, None)
    assert np.isnan(cell.mean).all() and np.isnan(cell.sd).all()
    assert math.isnan(cell.long_um) and cell.probability == 1.0 and cell.has_blob
