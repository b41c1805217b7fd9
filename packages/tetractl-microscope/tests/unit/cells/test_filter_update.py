"""Tests of updating the filter with the measurements of one image."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack, IdentityQuestion, Member, TrackBlob
from tetractl_microscope.cells.filter_update import ASTRAY_LENGTHS, update_filter
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.kernels.helix_steps import (
    DISTANT_COUNT,
    HEADING,
    SPEED,
    STATE_SIZE,
    A,
    X,
    Y,
)
from tetractl_microscope.cells.readings import SHARED_SD, BlobReading

BODY_UM = 50.0
SURE = (1.0, 1.0, 0.05)
VAGUE = (SHARED_SD.position * BODY_UM, SHARED_SD.position * BODY_UM, 10.0)


class Dish:
    def __init__(self):
        self.bank = HelixFilter(field_known=False)

    def track(self, x, y, heading=0.0):
        row = self.bank.add(x, y, heading, 300.0)
        return CellTrack(row + 1, row, BodySize(50.0, 25.0), last_um=np.array([x, y]))

    def state(self, track):
        return self.bank.means[track.row].copy(), self.bank.covariances[track.row].copy()

    def update(self, *readings):
        update_filter(self.bank, readings, 3.0, BODY_UM)


def reading(track, x, y, axis=0.0, deviations=SURE, shared=False, cut=False):
    blob = TrackBlob(
        0, SimpleNamespace(at_edge=cut), np.array([x, y, axis, 52.0, 24.0]), is_shared=shared
    )
    return BlobReading(track, blob, (x, y, axis), deviations)


def test_each_cell_is_corrected_by_its_own_blob():
    dish = Dish()
    tracks = [dish.track(0.0, 0.0), dish.track(200.0, 0.0), dish.track(400.0, 0.0)]
    unseen = dish.state(tracks[1])
    dish.update(reading(tracks[2], 403.0, 0.0), reading(tracks[0], 0.0, -3.0))
    assert dish.bank.means[tracks[0].row, Y] < -1.5
    assert dish.bank.means[tracks[2].row, X] > 401.5
    assert all(
        (now == before).all() for now, before in zip(dish.state(tracks[1]), unseen, strict=True)
    )


def test_an_image_without_cells_changes_nothing():
    dish = Dish()
    track = dish.track(0.0, 0.0)
    before = dish.state(track)
    dish.update()
    assert (dish.state(track)[0] == before[0]).all()


@pytest.mark.parametrize(
    ("off", "deviations", "shared", "moved"),
    [
        (1.1, SURE, False, True),
        (0.5, SURE, False, False),  # the filter itself comes near enough
        (1.1, VAGUE, False, False),  # the blob does not tell where the cell is
        (1.1, SURE, True, False),
    ],
)
def test_a_cell_far_from_its_own_blob_is_moved_to_it(off, deviations, shared, moved):
    """The correction by an outlier is small, so the filter remains behind."""
    dish = Dish()
    track = dish.track(0.0, 0.0)
    dish.bank.covariances[track.row, :2, :2] = 0.01 * np.eye(2)
    row = track.row
    dish.update(reading(track, 0.0, 2 * off * ASTRAY_LENGTHS * BODY_UM, 0.3, deviations, shared))
    far = abs(dish.bank.means[track.row, Y] - 2 * off * ASTRAY_LENGTHS * BODY_UM)
    assert (far < 1e-9) == moved
    assert (track.row != row) is moved
    assert dish.bank.is_used.sum() == 1 and dish.bank.is_used[track.row]


@pytest.mark.parametrize("axis", [0.3, 1.4, -1.2, 1.57])
@pytest.mark.parametrize("backwards", [False, True])
def test_the_end_that_moved_ahead_is_in_front(axis, backwards):
    dish = Dish()
    track = dish.track(0.0, 0.0)
    dish.bank.means[track.row, A] = 2.5
    way = -80.0 if backwards else 80.0
    x, y = way * math.cos(axis), way * math.sin(axis)
    dish.update(reading(track, x, y, axis))
    heading = dish.bank.means[track.row, HEADING]
    assert heading == pytest.approx(axis + math.pi if backwards else axis)
    assert dish.bank.means[track.row, SPEED] > 0
    assert dish.bank.means[track.row, A] == pytest.approx(2.5, abs=0.1)


def odd(dish, track):
    """A blob that is far in the filter's standard deviations, but near in um."""
    x, y, heading = dish.bank.means[track.row, [X, Y, HEADING]]
    dish.bank.covariances[track.row] = 0.01 * np.eye(STATE_SIZE)
    return reading(track, x, y + 9.0, heading, (0.5, 0.5, 0.05))


def variance(dish, track):
    return dish.bank.covariances[track.row, X, X]


def test_a_cell_that_is_not_where_it_was_expected_three_times_becomes_uncertain():
    dish = Dish()
    track = dish.track(0.0, 0.0)
    for k in range(1, DISTANT_COUNT):
        dish.update(odd(dish, track))
        assert track.outliers_in_row == k
        assert variance(dish, track) < 1.0
    dish.update(odd(dish, track))
    assert track.outliers_in_row == 0
    assert variance(dish, track) > 10.0


def test_outliers_must_follow_one_another():
    dish = Dish()
    track = dish.track(0.0, 0.0)
    for _ in range(4):
        dish.update(odd(dish, track))
        x, y, heading = dish.bank.means[track.row, [X, Y, HEADING]]
        dish.update(reading(track, x, y, heading))
        assert track.outliers_in_row == 0
    assert variance(dish, track) < 1.0


@pytest.mark.parametrize(
    ("shared", "cut", "sized"), [(False, False, True), (True, False, False), (False, True, False)]
)
def test_a_question_gets_the_likelihood_of_each_of_its_cells(shared, cut, sized):
    """Only a whole blob of its own has the cell's size."""
    dish = Dish()
    first, second = dish.track(0.0, 0.0), dish.track(0.0, 40.0)
    rows = np.array(
        [[first.row, second.row], [dish.bank.copy_row(first.row), dish.bank.copy_row(second.row)]]
    )
    sizes = [BodySize(52.0, 24.0), BodySize(70.0, 35.0)]
    members = [Member(t, 0, k, 1.0, sizes[k]) for k, t in enumerate((first, second))]
    question = IdentityQuestion(members, rows, np.zeros(2), np.ones((2, 2)), since_s=0.0)
    first.question = second.question = question
    lone = dish.track(900.0, 0.0)
    dish.update(reading(lone, 903.0, 0.0), reading(second, 0.0, 20.0, shared=shared, cut=cut))
    assert not question.log_likelihoods[0].any()
    own, other = question.log_likelihoods[1]
    assert (own - other > 0.2) == sized
    assert own <= 0 and other <= 0
    assert dish.bank.means[rows[1, 0], Y] == pytest.approx(
        40 - dish.bank.means[rows[1, 1], Y], abs=1
    )
    assert dish.bank.means[rows[0], Y].tolist() == [0.0, 40.0]
    assert second.outliers_in_row == 0
