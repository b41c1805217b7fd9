"""Tests of identifying cells after they have met, or after one has left another's blob."""

import itertools
import math

import numpy as np
import pytest
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack, IdentityQuestion, Member
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.kernels.helix_steps import HEADING, A, C, X, Y
from tetractl_microscope.cells.names import (
    ASSERTED_PROBABILITY,
    SPLIT_PROBABILITY,
    UNKNOWN_REMEMBERED_S,
    CellIdentities,
)

pytestmark = pytest.mark.slow


class Dish:
    """Tracks in a filter, and the names of their cells."""

    def __init__(self):
        self.bank = HelixFilter(field_known=True)
        self.names = CellIdentities(self.bank, 52.3)
        self.tracks = itertools.count(1)

    def track(self, x, y, size=(50.0, 25.0), heading=0.0):
        row = self.bank.add(x, y, heading, 400.0)
        number = next(self.tracks)
        track = CellTrack(number, row, BodySize(*size), last_um=np.array([x, y]))
        track.identity = self.names.new_identity()
        return track


def test_cells_that_the_places_tell_apart_keep_their_names_without_a_question():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(500.0, 560.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    places = {1: np.array([500.0, 500.0, 0.0]), 2: np.array([500.0, 560.0, 0.0])}
    dish.names.end_meetings(places, [], 1.1)
    assert [track.question for track in tracks] == [None, None]
    assert dish.names.probabilities([tracks[0]])[0] == 1.0
    assert dish.bank.is_used.sum() == 2


def test_a_name_that_may_be_wrong_goes_on_and_is_less_certain():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    assert dish.names.probabilities([tracks[0]])[0] == pytest.approx(0.5, abs=0.1)
    places = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    dish.names.end_meetings(places, [], 1.1)
    assert all(track.question is not None for track in tracks)
    dish.names.answer_questions(1.1 + 11.0)
    (answer,) = dish.names.take_answers()
    assert answer.met_identities == (1, 2) and answer.probability < ASSERTED_PROBABILITY
    assert {track.identity for track in tracks} == {1, 2}
    assert dish.names.probabilities([tracks[0]])[0] < ASSERTED_PROBABILITY
    assert dish.bank.is_used.sum() == 2


@pytest.mark.parametrize("met", [False, True])
def test_a_name_is_uncertain_where_something_unknown_may_have_taken_its_place(met):
    dish = Dish()
    track = dish.track(500.0, 500.0)
    dish.names.note_meeting([track], 1.0, met)
    dish.bank.means[track.row, :2] = 500.0, 560.0  # a body aside from where the cell swims
    dish.names.end_meetings({1: np.array([500.0, 560.0, 0.0])}, [], 2.0)
    assert (track.certainty < ASSERTED_PROBABILITY) is met


def test_each_meeting_lowers_the_certainty_of_who_is_who():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    places = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    gathered = []
    for seconds in (20.0, 40.0):
        for track in tracks:
            dish.bank.means[track.row, [X, Y, C]] = 501.0, 500.0, 0.0
        dish.names.note_meeting(tracks, seconds, False)
        dish.names.end_meetings(places, [], seconds + 0.1)
        dish.names.answer_questions(seconds + 12.0)
        gathered += [answer.probability for answer in dish.names.take_answers()]
    assert max(gathered) < ASSERTED_PROBABILITY
    assert tracks[0].certainty == tracks[1].certainty == pytest.approx(math.prod(gathered))


def test_cells_of_other_sizes_are_distinguished_by_them():
    size = BodySize(50.0, 25.0)
    tracks = [CellTrack(number, 0, size, last_um=np.zeros(2)) for number in (1, 2)]
    sizes = (60.0, 26.0), (48.0, 29.0)
    members = [Member(tracks[0], 0, 7, 1.0, sizes[0]), Member(tracks[1], 0, 8, 1.0, sizes[1])]
    rows = np.zeros((2, 2), int)
    prior = np.zeros(2)
    question = IdentityQuestion(members, rows, prior, np.ones((2, 2)), since_s=0.0)
    assert question.probabilities() == pytest.approx([0.5, 0.5])
    for _ in range(20):
        for track, size in zip(tracks, sizes[::-1], strict=True):
            question.add_measurement(track, np.zeros(2), size, 1.0)
    assert question.best_assignment()[0] == (1, 0)
    assert 0.95 < question.probabilities().max() < 0.9999
    assert not question.is_decided(0.1)


def places_of(*tracks):
    return {track.number: np.array([*track.last_um, 0.0]) for track in tracks}


@pytest.mark.parametrize("awaited", [False, True])
@pytest.mark.parametrize("tracks", [1, 2])
def test_a_meeting_with_something_that_may_come_out_is_remembered_for_half_a_second(
    tracks, awaited
):
    dish = Dish()
    met = [dish.track(500.0, 500.0 + 60 * k) for k in range(tracks)]
    other = dish.track(900.0, 900.0)
    dish.names.note_meeting(met, 1.0, False)
    waiting = met[-1:] if awaited else [other]
    waits = tracks == 1 or awaited
    dish.names.end_meetings(places_of(*met), waiting, 1.0 + UNKNOWN_REMEMBERED_S - 0.01)
    assert [track.meeting is not None for track in met] == [waits] * tracks
    dish.names.end_meetings(places_of(*met), waiting, 1.0 + UNKNOWN_REMEMBERED_S + 0.01)
    assert [track.meeting for track in met] == [None] * tracks


def test_tracks_without_a_blob_or_still_together_stay_in_their_meeting():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(500.0, 560.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    dish.names.end_meetings(places_of(*tracks), [], 1.0)
    assert all(track.meeting is not None for track in tracks)
    dish.names.end_meetings(places_of(tracks[0]), [], 1.1)
    assert tracks[0].meeting is None and tracks[1].meeting is not None


def test_a_track_that_surely_follows_its_cell_stays_while_something_unknown_may_be_there():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(500.0, 560.0)]
    dish.names.note_meeting(tracks, 1.0, True)
    dish.names.end_meetings(places_of(tracks[0]), [], 1.1)
    assert all(track.meeting is not None for track in tracks)
    dish.names.end_meetings(places_of(*tracks), [], 1.2)
    assert all(track.meeting is None and track.question is None for track in tracks)


def test_more_than_four_tracks_that_part_are_doubted_instead_of_asked():
    dish = Dish()
    tracks = [dish.track(500.0 + 3 * k, 500.0) for k in range(5)]
    dish.names.note_meeting(tracks, 1.0, False)
    dish.names.end_meetings(places_of(*tracks), [], 1.1)
    assert all(track.question is None and track.meeting is None for track in tracks)
    answers = dish.names.take_answers()
    assert [answer.met_identities for answer in answers] == [(track.identity,) for track in tracks]
    assert all(track.certainty < 0.9 for track in tracks)
    assert dish.bank.is_used.sum() == 5


@pytest.mark.parametrize("entered", [False, True])
def test_a_cell_that_comes_out_of_another_has_divided_unless_it_may_have_entered(entered):
    dish = Dish()
    near, new = dish.track(500.0, 500.0), dish.track(520.0, 500.0)
    divided = dish.names.note_split(new, near, 3.0, entered)
    assert divided == (None if entered else near.identity)
    assert near.certainty == (1.0 if entered else SPLIT_PROBABILITY)
    answers = dish.names.take_answers()
    assert len(answers) == (not entered)
    for answer in answers:
        ((name,), met) = answer.tracks, answer.met_identities
        assert (name.track, name.identity, name.certainty) == (1, near.identity, SPLIT_PROBABILITY)
        assert name.since_s == 3.0 and met == (near.identity,)
        assert answer.probability == SPLIT_PROBABILITY


def test_a_cell_that_comes_out_of_a_blob_of_two_has_not_divided():
    dish = Dish()
    near, other, new = (dish.track(500.0 + 20 * k, 500.0) for k in range(3))
    dish.names.note_meeting([near, other], 1.0, False)
    assert dish.names.note_split(new, near, 3.0, False) is None
    assert near.certainty == 1.0 and near.meeting is not None
    assert dish.names.take_answers() == []


def test_of_two_that_come_out_of_one_blob_the_nearer_to_the_prediction_is_the_cell():
    """Something unknown had joined the cell; both tracks are now apart."""
    for off_um, surely in ((0.0, True), (60.0, False)):
        dish = Dish()
        near = dish.track(500.0, 500.0)
        dish.names.note_meeting([near], 1.0, True)
        new = dish.track(500.0, 560.0 - off_um)
        dish.bank.means[near.row, :2] = 500.0, 500.0 + off_um
        assert dish.names.note_split(new, near, 3.0, False) is None
        assert near.meeting is None and near.together_s == 3.0
        assert (near.certainty > 0.9) == surely
        assert surely or near.certainty < 0.1
        assert dish.bank.is_used.sum() == 2


def test_a_track_that_is_named_by_a_question_divides_without_a_doubt():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    apart = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    dish.names.end_meetings(apart, [], 1.1)
    new = dish.track(520.0, 530.0)
    before = dish.names.probabilities(tracks)
    assert dish.names.note_split(new, tracks[0], 3.0, False) is None
    assert dish.names.probabilities(tracks) == before


def test_the_remaining_track_of_a_blob_may_be_either_cell():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    dish.names.forget_track(tracks[1])
    assert tracks[0].meeting is None
    assert tracks[0].certainty == pytest.approx(0.5, abs=0.1)
    assert dish.bank.is_used.sum() == 1


@pytest.mark.parametrize("apart_um", [0.0, 200.0])
def test_a_track_of_three_that_is_given_up_leaves_the_meeting_of_the_others(apart_um):
    dish = Dish()
    tracks = [dish.track(500.0 + apart_um * k, 500.0) for k in range(3)]
    dish.names.note_meeting(tracks, 1.0, False)
    dish.names.forget_track(tracks[2])
    assert [track.meeting is not None for track in tracks[:2]] == [True, True]
    assert [track.certainty for track in tracks[:2]] == [1.0, 1.0]
    assert dish.bank.is_used.sum() == 4
    dish.names.forget_track(tracks[1])
    assert (tracks[0].meeting is None) == (apart_um == 0.0)
    assert (tracks[0].certainty == 1.0) == (apart_um > 0.0)


def test_a_track_with_an_open_question_that_is_given_up_answers_it():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    apart = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    dish.names.end_meetings(apart, [], 1.1)
    assert dish.bank.is_used.sum() == 4
    probability = dish.names.probabilities(tracks)[0]
    dish.names.forget_track(tracks[1])
    (answer,) = dish.names.take_answers()
    assert answer.probability == pytest.approx(probability, abs=0.05)
    assert [name.track for name in answer.tracks] == [1, 2]
    assert tracks[0].question is None
    assert tracks[0].certainty == pytest.approx(probability)
    assert dish.bank.is_used.sum() == 1 and dish.bank.is_used[tracks[0].row]


def test_tracks_that_meet_again_answer_their_question_first():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    apart = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    dish.names.end_meetings(apart, [], 1.1)
    dish.names.note_meeting(tracks, 1.2, False)
    assert len(dish.names.take_answers()) == 1
    assert all(track.question is None and track.meeting is not None for track in tracks)
    assert dish.bank.is_used.sum() == 4


def test_numbers_are_given_once():
    names = Dish().names
    assert [names.new_identity() for _ in range(3)] == [1, 2, 3]


def test_a_question_follows_each_track_as_each_of_its_cells():
    """A row that expected its cell elsewhere, or the other way round, is moved to the track."""
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0, heading=3.0)]
    for track, a in zip(tracks, (2.0, 5.0), strict=True):
        dish.bank.means[track.row, A] = a
    dish.names.note_meeting(tracks, 1.0, False)
    apart = {1: np.array([501.0, 580.0, 0.1]), 2: np.array([501.0, 420.0, -0.2])}
    for track in tracks:
        dish.bank.means[track.row, [X, Y, C]] = *apart[track.number][:2], 0.0
    dish.names.end_meetings(apart, [], 1.1)
    question = tracks[0].question
    assert question is tracks[1].question is not None
    for t, track in enumerate(tracks):
        rows = question.rows[t]
        assert dish.bank.means[rows, A] == pytest.approx([2.0, 5.0], abs=0.05)
        assert np.abs(dish.bank.means[rows, Y] - apart[track.number][1]).max() < 15.0
        heading = (0.1, -0.2 + math.pi)[t]
        off = np.remainder(dish.bank.means[rows, HEADING] - heading + math.pi, math.tau) - math.pi
        assert np.abs(off).max() < 0.6
    assert len(set(question.rows.ravel().tolist())) == 4
    assert dish.bank.is_used.sum() == 4


def test_two_that_come_out_on_both_sides_of_the_prediction_are_equally_likely():
    dish = Dish()
    near = dish.track(500.0, 500.0)
    dish.names.note_meeting([near], 1.0, True)
    new = dish.track(500.0, 490.0)
    dish.bank.means[near.row, :2] = 500.0, 510.0
    dish.names.note_split(new, near, 3.0, False)
    assert near.certainty == pytest.approx(0.5, abs=0.01)


def test_a_name_that_was_uncertain_stays_so_in_a_meeting_and_in_a_question():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    for track in tracks:
        track.certainty = 0.6
    dish.names.note_meeting(tracks, 1.0, False)
    assert dish.names.probabilities(tracks)[0] == pytest.approx(0.3, abs=0.06)
    apart = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    dish.names.end_meetings(apart, [], 1.1)
    in_question = dish.names.probabilities(tracks)
    assert 0.25 < in_question[0] <= 0.6
    dish.names.answer_questions(20.0)
    assert [track.certainty for track in tracks] == pytest.approx(in_question)
    assert dish.names.probabilities(tracks) == pytest.approx(in_question)


def test_a_question_that_is_not_decided_stays_open_and_names_by_the_better_answer():
    dish = Dish()
    tracks = [dish.track(500.0, 500.0), dish.track(502.0, 500.0)]
    dish.names.note_meeting(tracks, 1.0, False)
    apart = {1: np.array([501.0, 530.0, 0.0]), 2: np.array([501.0, 470.0, 0.0])}
    dish.names.end_meetings(apart, [], 1.1)
    question = tracks[0].question
    question.log_likelihoods[:] = [[0.0, 2.0], [2.0, 0.0]]
    dish.names.answer_questions(2.0)
    assert [track.identity for track in tracks] == [2, 1]
    assert [track.row for track in tracks] == [question.rows[0, 1], question.rows[1, 0]]
    assert tracks[0].question is question and dish.names.take_answers() == []
    question.log_likelihoods[:] = [[0.0, 20.0], [20.0, 0.0]]
    dish.names.answer_questions(2.1)
    (answer,) = dish.names.take_answers()
    assert answer.probability > 0.99
    assert [(name.track, name.identity) for name in answer.tracks] == [(1, 2), (2, 1)]
    assert answer.met_identities == (1, 2)
    assert dish.bank.is_used.sum() == 2
    assert all(dish.bank.is_used[track.row] for track in tracks)
