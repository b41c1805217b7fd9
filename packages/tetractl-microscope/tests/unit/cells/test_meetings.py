"""Tests of who still follows which cell while tracks share a blob."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack, compute_log_densities
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.kernels.helix_steps import X, Y
from tetractl_microscope.cells.meetings import (
    ASSIGNED_TRACKS_MAX,
    POSITION_SD,
    SPLIT_REACH,
    UNKNOWN_PROBABILITY,
    Meetings,
)
from tetractl_microscope.cells.readings import SHARED_SD

BODY_UM = 50.0
LOG_UNKNOWN = math.log(UNKNOWN_PROBABILITY / (math.pi * (SPLIT_REACH * BODY_UM) ** 2))


class Dish:
    def __init__(self):
        self.bank = HelixFilter(field_known=False)
        self.meetings = Meetings(self.bank, BODY_UM)

    def track(self, x, y):
        row = self.bank.add(x, y, 0.0, 300.0)
        track = CellTrack(row, row, BodySize(50.0, 25.0), last_um=np.array([x, y]))
        track.identity = 100 + row
        return track

    def meet(self, *places, with_unknown=False):
        tracks = [self.track(*place) for place in places]
        self.meetings.join(tracks, with_unknown)
        return tracks, tracks[0].meeting


def shared_blob():
    return SimpleNamespace(is_shared=True)


def test_tracks_that_meet_are_in_one_meeting_with_a_copy_of_each_cell():
    dish = Dish()
    tracks, meeting = dish.meet((0, 0), (10, 0))
    assert meeting.tracks == tracks and tracks[1].meeting is meeting
    assert [member.identity for member in meeting.members] == [track.identity for track in tracks]
    assert not set(meeting.rows) & {track.row for track in tracks}
    assert dish.bank.is_used.sum() == 4
    dish.meetings.join(tracks, False)  # in the next image
    assert len(meeting.members) == 2 and dish.bank.is_used.sum() == 4
    assert list(dish.meetings.running) == [meeting]


def test_meetings_of_tracks_that_meet_are_merged():
    dish = Dish()
    first, one = dish.meet((0, 0), (10, 0))
    second, other = dish.meet((90, 0), (100, 0), with_unknown=True)
    _, third = dish.meet((500, 0), (510, 0))
    lone = dish.track(50, 0)
    assert one is not other
    dish.meetings.join([first[0], lone, second[1]], False)
    assert list(dish.meetings.running) == [one, third]
    assert one.with_unknown and not third.with_unknown
    assert {track.row for track in one.tracks} == {t.row for t in (*first, *second, lone)}
    assert all(track.meeting is one for track in (*first, *second, lone))
    assert dish.bank.is_used.sum() == 2 * 7


@pytest.mark.parametrize(("before", "after"), [(True, False), (False, True), (False, False)])
def test_something_unknown_stays_in_a_meeting(before, after):
    dish = Dish()
    tracks, meeting = dish.meet((0, 0), (10, 0), with_unknown=before)
    dish.meetings.join(tracks, after)
    assert meeting.with_unknown is (before or after)


def test_a_track_that_leaves_frees_its_copy_and_the_last_one_ends_the_meeting():
    dish = Dish()
    (first, second), meeting = dish.meet((0, 0), (10, 0))
    dish.meetings.leave(meeting, second)
    assert meeting.tracks == [first] and second.meeting is None and first.meeting is meeting
    assert dish.bank.is_used.sum() == 3
    assert list(dish.meetings.running) == [meeting]
    dish.meetings.leave(meeting, first)
    assert list(dish.meetings.running) == [] and dish.bank.is_used.sum() == 2


def test_a_meeting_that_ends_frees_all_copies():
    dish = Dish()
    tracks, meeting = dish.meet((0, 0), (10, 0), (20, 0))
    dish.meetings.end(meeting)
    assert dish.bank.is_used.sum() == 3 and list(dish.meetings.running) == []
    assert [track.meeting for track in tracks] == [None] * 3
    assert len(meeting.members) == 3


def by_all_assignments(dish, meeting, deviations):
    """The shares, as sums over all assignments of cells to tracks."""
    places, _ = dish.bank.predict_bodies(np.array([track.row for track in meeting.tracks]))
    table = compute_log_densities(
        dish.bank, meeting.rows, places, BODY_UM * np.array(deviations), LOG_UNKNOWN
    )
    count = len(table)
    weights = {
        order: math.exp(sum(table[t, n] for t, n in enumerate(order)) - np.trace(table))
        for order in itertools.permutations(range(count))
    }
    shares = [
        sum(weight for order, weight in weights.items() if order[t] == t) for t in range(count)
    ]
    return np.array(shares) / sum(weights.values()), table


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("shared", [True, False])
def test_a_share_is_the_probability_of_all_assignments_with_the_own_cell(count, shared):
    dish = Dish()
    tracks, meeting = dish.meet(*((15.0 * k, 4.0 * k * k) for k in range(count)))
    rng = np.random.default_rng(2)
    for track in tracks:
        dish.bank.means[track.row, [X, Y]] += rng.normal(0, 6, 2)
        track.newest_blob = shared_blob() if shared else None
    deviation = SHARED_SD.position if shared else POSITION_SD
    shares, _ = by_all_assignments(dish, meeting, [deviation] * count)
    assert dish.meetings.own_probabilities(meeting) == pytest.approx(shares)
    assert count == 1 or 0.05 < shares.min() < 0.99


def test_something_unknown_may_be_at_a_track_instead_of_a_cell():
    dish = Dish()
    (_, second), meeting = dish.meet((0, 0), (30, 0), with_unknown=True)
    dish.bank.means[second.row, Y] += 60.0
    shares, table = by_all_assignments(dish, meeting, [POSITION_SD] * 2)
    own = np.diagonal(table)
    expected = shares / (1 + np.exp(LOG_UNKNOWN - own))
    assert dish.meetings.own_probabilities(meeting) == pytest.approx(expected)
    known = dish.meetings.known_probabilities(meeting, table)
    assert known == pytest.approx(1 / (1 + np.exp(LOG_UNKNOWN - table)))
    assert known[0, 0] > known[1, 1]
    meeting.with_unknown = False
    assert dish.meetings.known_probabilities(meeting, table).tolist() == [[1.0, 1.0], [1.0, 1.0]]


def test_of_many_tracks_only_exchanges_of_two_cells_are_counted():
    dish = Dish()
    count = ASSIGNED_TRACKS_MAX + 1
    _, meeting = dish.meet(*((10.0 * k, 0.0) for k in range(count)))
    shares, table = by_all_assignments(dish, meeting, [POSITION_SD] * count)
    found = dish.meetings.own_probabilities(meeting)
    for t in range(count):
        ratios = [
            math.exp(table[t, n] + table[n, t] - table[t, t] - table[n, n]) for n in range(count)
        ]
        assert found[t] == pytest.approx(1 / sum(ratios))
    assert np.argsort(found).tolist()[-2:] != [1, 2]
    assert np.abs(found - shares).max() < 0.3
