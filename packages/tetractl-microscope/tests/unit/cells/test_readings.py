"""What a blob says of a cell: where it is, how surely, and whether its size is the cell's."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack, TrackBlob
from tetractl_microscope.cells.match import LARGE_AREA_RATIO
from tetractl_microscope.cells.readings import (
    AXIS_SD,
    EXCESS_SD_FRACTION,
    HIDDEN_SD,
    NEW_SIZE_S,
    PATH_BLOBS,
    POSITION_SD_PX,
    POSITION_SD_UM,
    SHARED_SD,
    SIZE_WEIGHT,
    TWO_CELLS_LENGTH_RATIO,
    UNUSUAL_SD,
    BlobReading,
    create_own_reading,
    create_shared_readings,
    record_own_blob,
    update_size,
)

LONG_UM, WIDE_UM = 50.0, 25.0
X_UM, Y_UM, AXIS_RAD = 400.0, 300.0, 0.4


def cell(**fields):
    return CellTrack(1, 0, BodySize(LONG_UM, WIDE_UM), np.array([X_UM, Y_UM]), **fields)


def blob(long=LONG_UM, wide=WIDE_UM, at_edge=False, **fields):
    place = np.array([X_UM, Y_UM, AXIS_RAD, long, wide])
    return TrackBlob(0, SimpleNamespace(at_edge=at_edge), place, **fields)


def picture(points=None, um_px=2.0):
    return SimpleNamespace(um_px=um_px, points_of=lambda blob: points)


def pixels(xs, ys):
    """Points (P, 2) that fill these ranges [um]."""
    grid = np.meshgrid(np.arange(*xs, 2.0), np.arange(*ys, 2.0))
    return np.stack(grid, axis=-1).reshape(-1, 2)


def deviations_of(newest, **options):
    expected = np.array([X_UM, Y_UM, AXIS_RAD])
    reading = create_own_reading(cell(), newest, expected, options.pop("now", picture()), LONG_UM)
    assert reading.values == pytest.approx((X_UM, Y_UM, AXIS_RAD), abs=2)
    return reading.deviations


@pytest.mark.parametrize("um_px", [0.5, 2.0, 6.0])
def test_a_blob_of_the_cells_size_is_where_the_cell_is_to_a_part_of_a_pixel(um_px):
    x, y, axis = deviations_of(blob(), now=picture(um_px=um_px))
    assert x == y == pytest.approx(POSITION_SD_UM + POSITION_SD_PX * um_px)
    assert axis == pytest.approx(2 * AXIS_SD)  # half as wide as long


def test_the_rounder_a_blob_the_less_its_axis_says():
    axes = [deviations_of(blob(LONG_UM, wide))[2] for wide in (20.0, 30.0, 35.0)]
    assert axes == pytest.approx([AXIS_SD / 0.6, AXIS_SD / 0.4, AXIS_SD / 0.3])
    small = cell()
    small.size = BodySize(25.0, 25.0)
    expected = np.array([X_UM, Y_UM, AXIS_RAD])
    round_one = create_own_reading(small, blob(25.0, 25.0), expected, picture(), LONG_UM)
    assert math.isfinite(round_one.deviations[2])


@pytest.mark.parametrize(
    "newest",
    [blob(at_edge=True), blob(LONG_UM, 0.9 * WIDE_UM / LARGE_AREA_RATIO**2)],
    ids=["cut off", "too small"],
)
def test_a_blob_that_shows_a_part_of_a_cell_says_less(newest):
    x, y, axis = deviations_of(newest)
    assert x == y == pytest.approx(UNUSUAL_SD.position * LONG_UM)
    assert axis == UNUSUAL_SD.axis


def test_an_excess_of_length_may_lie_on_either_side_of_the_cell():
    long = LONG_UM + 60
    x, *_ = deviations_of(blob(long, at_edge=True, is_large=True))
    assert x == pytest.approx(EXCESS_SD_FRACTION * 60)


def test_in_a_blob_with_another_object_the_cell_is_on_its_own_side():
    """The blob's centre is between both, and the cell is expected to the left of it."""
    points = pixels((X_UM - 50, X_UM + 50), (Y_UM - 12, Y_UM + 12))
    newest = blob(2 * LONG_UM, WIDE_UM, is_large=True)
    expected = np.array([X_UM - 25, Y_UM, 0.0])
    reading = create_own_reading(cell(), newest, expected, picture(points), LONG_UM)
    x, y, _ = reading.values
    assert (x, y) == pytest.approx((X_UM - 25, Y_UM), abs=4)
    assert reading.deviations[:2] == pytest.approx((SHARED_SD.position * LONG_UM,) * 2)


@pytest.mark.parametrize(
    ("long", "spread"),
    [
        (0.95 * LARGE_AREA_RATIO * LONG_UM, HIDDEN_SD),
        (1.05 * LARGE_AREA_RATIO * LONG_UM, SHARED_SD),
    ],
)
def test_cells_that_share_a_blob_are_on_their_sides_with_their_expected_axes(long, spread):
    """Less surely if one hides the other: the blob is then no larger than one of them."""
    points = pixels((X_UM - long / 2, X_UM + long / 2), (Y_UM - 12, Y_UM + 12))
    expected = np.array([[X_UM + 20, Y_UM, 0.1], [X_UM - 20, Y_UM, -0.2]])
    cells = [cell(), cell()]
    found = create_shared_readings(cells, blob(long), expected, picture(points), LONG_UM)
    assert [reading.cell for reading in found] == cells
    (right, _, axis), (left, _, other) = (reading.values for reading in found)
    assert left < X_UM - 5 < X_UM + 5 < right
    assert (axis, other) == (0.1, -0.2)
    for reading in found:
        assert reading.deviations == pytest.approx(
            (spread.position * LONG_UM, spread.position * LONG_UM, spread.axis)
        )


@pytest.mark.parametrize(
    ("long", "wide", "is_large"),
    [
        (LONG_UM, WIDE_UM, False),
        (0.99 * TWO_CELLS_LENGTH_RATIO * LONG_UM, WIDE_UM, False),
        (1.01 * TWO_CELLS_LENGTH_RATIO * LONG_UM, WIDE_UM, True),
        (LONG_UM, 0.99 * LARGE_AREA_RATIO * WIDE_UM, False),
        (LONG_UM, 1.01 * LARGE_AREA_RATIO * WIDE_UM, True),
        (LONG_UM, 0.2 * WIDE_UM, False),
    ],
)
def test_a_blob_is_large_by_its_area_or_its_length(long, wide, is_large):
    newest = blob(long, wide)
    record_own_blob(cell(), newest, 1.0)
    assert newest.is_large == is_large


def test_a_path_has_the_newest_blobs():
    tracked = cell()
    for k in range(PATH_BLOBS + 4):
        record_own_blob(tracked, blob(), k / 10)
    assert [round(10 * seen.seconds) for seen in tracked.path] == list(range(4, PATH_BLOBS + 4))


@pytest.mark.parametrize(("share", "grows"), [(0.9, False), (1.1, True)])
def test_a_cell_has_another_size_once_its_blob_has_had_it_for_a_while(share, grows):
    tracked = cell()
    record_own_blob(tracked, blob(), 2.0)
    for part in (0.3, 0.5, 0.7, share):
        record_own_blob(tracked, blob(2 * LONG_UM, WIDE_UM), 2.0 + part * NEW_SIZE_S)
    assert tracked.size == ((2 * LONG_UM, WIDE_UM) if grows else (LONG_UM, WIDE_UM))


def test_a_size_follows_usual_blobs_slowly_and_others_not_at_all():
    tracked = cell()
    reading = BlobReading(tracked, blob(LONG_UM + 10, WIDE_UM - 2), (0, 0, 0), (1, 1, 1))
    update_size(reading)
    assert tracked.size == pytest.approx((LONG_UM + 10 * SIZE_WEIGHT, WIDE_UM - 2 * SIZE_WEIGHT))
    for newest in (blob(2 * LONG_UM, is_large=True), blob(10.0, 5.0), blob(at_edge=True)):
        tracked = cell()
        update_size(BlobReading(tracked, newest, (0, 0, 0), (1, 1, 1)))
        assert tracked.size == (LONG_UM, WIDE_UM)


@pytest.mark.parametrize("is_first_large", [True, False])
def test_a_large_cell_may_hide_a_small_one(is_first_large):
    cells = [cell(), cell()]
    cells[is_first_large].size = BodySize(LONG_UM / 2, WIDE_UM / 2)
    points = pixels((X_UM - 25, X_UM + 25), (Y_UM - 12, Y_UM + 12))
    expected = np.array([[X_UM + 10, Y_UM, 0.1], [X_UM - 10, Y_UM, -0.2]])
    for reading in create_shared_readings(cells, blob(), expected, picture(points), LONG_UM):
        assert reading.deviations[0] == pytest.approx(HIDDEN_SD.position * LONG_UM)
