"""Tests of identifying cells after they have met, or after one has left another's blob."""

import itertools
import math

import numpy as np
import pytest
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack, Member, WhichIsWhich
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.kernels.helix_steps import C, X, Y
from tetractl_microscope.cells.names import ASSERTED, Names

pytestmark = pytest.mark.slow


class Dish:
    """Tracks in a filter, and the names of their cells."""

    def __init__(self):
        self.bank = HelixFilter(field_known=True)
        self.names = Names(self.bank, 52.3)
        self.tracks = itertools.count(1)

    def track(self, x, y, size=(50.0, 25.0), heading=0.0):
        row = self.bank.add(x, y, heading, 400.0)
        number = next(self.tracks)
        track = CellTrack(number, row, BodySize(*size), last=np.array([x, y]))
        track.identity = self.names.take_number()
        return track


def test_cells_that_the_places_tell_apart_keep_their_names_without_a_question():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(500.0, 560.0)]
    dish.names.meet(tracks, 1.0, False)
    places = {1: np.array([500.0, 500.0, 0.0]), 2: np.array([500.0, 560.0, 0.0])}
    dish.names.part(places, [], 1.1)
    assert [track.question for track in tracks] == [None, None]
    assert dish.names.probabilities([tracks[0]])[0] == 1.0
    assert dish.bank.used.sum() == 2


def test_a_name_that_may_be_wrong_goes_on_and_is_less_certain():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    dish.names.meet(tracks, 1.0, False)
    assert dish.names.probabilities([tracks[0]])[0] == pytest.approx(0.5, abs=0.1)
    places = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    dish.names.part(places, [], 1.1)
    assert all(track.question is not None for track in tracks)
    dish.names.answer(1.1 + 11.0)
    (answer,) = dish.names.take_answers()
    assert answer.met == (1, 2) and answer.probability < ASSERTED
    assert {track.identity for track in tracks} == {1, 2}
    assert dish.names.probabilities([tracks[0]])[0] < ASSERTED
    assert dish.bank.used.sum() == 2


@pytest.mark.parametrize("met", [False, True])
def test_a_name_is_uncertain_where_something_unknown_may_have_taken_its_place(met):
    dish = Dish()
    track = dish.track(500.0, 500.0)
    dish.names.meet([track], 1.0, met)
    dish.bank.mean[track.row, :2] = 500.0, 560.0  # a body aside from where the cell swims
    dish.names.part({1: np.array([500.0, 560.0, 0.0])}, [], 2.0)
    assert (track.certainty < ASSERTED) is met


def test_each_meeting_lowers_the_certainty_of_who_is_who():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    places = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    gathered = []
    for seconds in (20.0, 40.0):
        for track in tracks:
            dish.bank.mean[track.row, [X, Y, C]] = 501.0, 500.0, 0.0
        dish.names.meet(tracks, seconds, False)
        dish.names.part(places, [], seconds + 0.1)
        dish.names.answer(seconds + 12.0)
        gathered += [answer.probability for answer in dish.names.take_answers()]
    assert max(gathered) < ASSERTED
    assert tracks[0].certainty == tracks[1].certainty == pytest.approx(math.prod(gathered))


def test_cells_of_other_sizes_are_distinguished_by_them():
    size = BodySize(50.0, 25.0)
    tracks = [CellTrack(number, 0, size, last=np.zeros(2)) for number in (1, 2)]
    sizes = (60.0, 26.0), (48.0, 29.0)
    members = [Member(tracks[0], 0, 7, 1.0, sizes[0]), Member(tracks[1], 0, 8, 1.0, sizes[1])]
    rows = np.zeros((2, 2), int)
    prior = np.zeros(2)
    question = WhichIsWhich(members, rows, prior, np.ones((2, 2)), since_s=0.0)
    assert question.probabilities() == pytest.approx([0.5, 0.5])
    for _ in range(20):
        for track, size in zip(tracks, sizes[::-1], strict=True):
            question.add(track, np.zeros(2), size, 1.0)
    assert question.best()[0] == (1, 0)
    assert 0.95 < question.probabilities().max() < 0.9999
    assert not question.ends(0.1)
