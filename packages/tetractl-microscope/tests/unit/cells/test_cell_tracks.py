"""Tests of tracks and of inferring which cell is on which track."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.cell_tracks import (
    LIKELIHOOD_EXPONENT,
    LOG_PENALTY_MAX,
    OPEN_MAX_S,
    OPEN_MIN_S,
    SELF_TURN_PROBABILITY,
    SETTLED_S,
    SIZE_IMAGES,
    SPREAD_FACTOR,
    CellTrack,
    IdentityQuestion,
    Member,
    TrackBlob,
    compute_log_assignment_probabilities,
    compute_log_densities,
    list_assignments,
    normalise_log_probabilities,
)

SIZE = BodySize(50.0, 25.0)


def track(number):
    return CellTrack(number, row=number, size=SIZE, last_um=np.zeros(2))


def question(count=2, prior=None, not_unknown=None, sizes=None):
    tracks = [track(k) for k in range(count)]
    members = [
        Member(t, 0, 10 + k, 1.0, (sizes or [SIZE] * count)[k]) for k, t in enumerate(tracks)
    ]
    prior = np.zeros(math.factorial(count)) if prior is None else np.array(prior)
    none = np.ones((count, count)) if not_unknown is None else np.array(not_unknown)
    return IdentityQuestion(members, np.arange(count**2).reshape(count, count), prior, none, 5.0)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_the_orders_are_all_assignments(count):
    found = {tuple(order) for order in list_assignments(count).tolist()}
    assert found == set(itertools.permutations(range(count)))


@given(st.integers(1, 4), st.integers(0, 2**31))
def test_the_log_of_an_assignment_is_the_sum_over_its_tracks(count, seed):
    table = np.random.default_rng(seed).normal(size=(count, count))
    logs = compute_log_assignment_probabilities(list_assignments(count), table)
    for order, log in zip(list_assignments(count), logs, strict=True):
        assert log == pytest.approx(sum(table[t, n] for t, n in enumerate(order)))


@given(st.lists(st.floats(-2000.0, 2000.0), min_size=1, max_size=9))
def test_probabilities_add_up_to_1_whatever_the_constant(logs):
    shares = normalise_log_probabilities(np.array(logs))
    assert shares.sum() == pytest.approx(1.0)
    assert (shares >= 0).all() and shares[np.argmax(logs)] == shares.max()
    assert normalise_log_probabilities(np.array(logs) + 700.0) == pytest.approx(shares, abs=1e-9)


def test_the_rows_of_a_track_are_its_own_or_those_of_its_question():
    asked = question()
    first, second = asked.tracks
    assert list(first.rows) == [0] and list(second.rows) == [1]
    first.question = second.question = asked
    assert list(first.rows) == [0, 1] and list(second.rows) == [2, 3]


def test_likelihoods_count_for_their_track_once_the_rows_have_settled():
    asked = question()
    first, second = asked.tracks
    asked.add_measurement(first, np.array([0.0, -2.0]), None, 5.0 + SETTLED_S - 0.01)
    assert not asked.log_likelihoods.any()
    asked.add_measurement(second, np.array([-7.0, -5.0]), None, 5.0 + SETTLED_S + 0.01)
    assert asked.log_likelihoods[0].tolist() == [0.0, 0.0]
    assert asked.log_likelihoods[1] == pytest.approx([-2 * LIKELIHOOD_EXPONENT, 0.0])
    odds = math.exp(2 * LIKELIHOOD_EXPONENT)
    assert asked.best_assignment()[0] == (0, 1)
    assert asked.best_assignment()[1] == pytest.approx([odds / (1 + odds)] * 2)


def test_one_image_says_only_so_much_against_a_cell():
    asked = question()
    asked.add_measurement(asked.tracks[0], np.array([0.0, -900.0]), None, 9.0)
    assert asked.log_likelihoods[0] == pytest.approx([0.0, -LOG_PENALTY_MAX * LIKELIHOOD_EXPONENT])
    asked.add_measurement(asked.tracks[0], np.array([-900.0, 0.0]), None, 9.0)
    assert asked.probabilities() == pytest.approx([0.5, 0.5])


def test_sizes_count_in_the_first_images_of_each_track_from_the_beginning():
    sizes = [BodySize(60.0, 26.0), BodySize(48.0, 29.0)]
    asked = question(sizes=sizes)
    first, second = asked.tracks
    for _ in range(SIZE_IMAGES):
        asked.add_measurement(first, np.zeros(2), sizes[1], 5.0)
    after = asked.log_likelihoods.copy()
    assert after[0, 1] == pytest.approx(0.0) and after[0, 0] < -0.3
    assert not after[1].any()
    asked.add_measurement(first, np.zeros(2), sizes[0], 5.0)  # one too many
    assert (asked.log_likelihoods == after).all()
    asked.add_measurement(second, np.zeros(2), sizes[0], 5.0)
    assert asked.log_likelihoods[1, 1] < asked.log_likelihoods[1, 0]
    assert asked.best_assignment()[0] == (1, 0)


def test_a_size_is_student_distributed_in_its_logarithm():
    sizes = [BodySize(50.0, 25.0), BodySize(60.0, 25.0)]
    asked = question(sizes=sizes)
    asked.add_measurement(asked.tracks[0], np.zeros(2), (54.0, 24.0), 5.0)
    logs = []
    for long, wide in sizes:
        off = np.log([54.0 / long, 24.0 / wide]) / 0.1
        logs.append(sum(stats.t.logpdf(off, 2) - stats.t.logpdf(0, 2)) / SIZE_IMAGES)
    assert asked.log_likelihoods[0] == pytest.approx(logs)


def test_the_prior_and_the_chance_of_something_unknown_lower_the_certainty():
    asked = question(prior=[math.log(3.0), 0.0], not_unknown=[[0.9, 0.1], [0.2, 0.6]])
    order, shares = asked.best_assignment()
    assert order == (0, 1)
    assert shares == pytest.approx([0.75 * 0.9, 0.75 * 0.6])
    crossed = question(prior=[0.0, math.log(3.0)], not_unknown=[[0.9, 0.1], [0.2, 0.6]])
    assert crossed.best_assignment() == ((1, 0), pytest.approx([0.75 * 0.1, 0.75 * 0.2]))


def test_a_track_of_three_may_be_certain_while_the_others_are_not():
    asked = question(3, prior=np.where(list_assignments(3)[:, 0] == 0, 0.0, -50.0))
    order, shares = asked.best_assignment()
    assert order[0] == 0
    assert shares == pytest.approx([1.0, 0.5, 0.5])


@pytest.mark.parametrize(
    ("certain", "open_s", "ends"),
    [
        (True, OPEN_MIN_S + 0.01, True),
        (True, OPEN_MIN_S - 0.01, False),
        (False, OPEN_MIN_S + 0.01, False),
        (False, OPEN_MAX_S - 0.01, False),
        (False, OPEN_MAX_S + 0.01, True),
        (True, OPEN_MAX_S + 0.01, True),
    ],
)
def test_a_question_ends_when_it_is_certain_or_has_been_open_for_long(certain, open_s, ends):
    asked = question(prior=[0.0, -7.0 if certain else -5.0])  # 0.9991 or 0.9933
    assert asked.is_decided(5.0 + open_s) == ends


class Bank:
    """A filter that expects cells at places with covariances."""

    def __init__(self, places, spreads):
        self.places = np.array(places, float)
        self.spreads = np.array(spreads, float)

    def predict_bodies(self, rows):
        bodies = np.column_stack([self.places[rows], np.zeros(len(rows))])
        return bodies, self.spreads[rows]


def test_the_density_of_a_cell_is_student_s_about_where_it_is_expected():
    spreads = [[[25.0, 10.0], [10.0, 16.0]], [[9.0, 0.0], [0.0, 64.0]]]
    bank = Bank([(100.0, 50.0), (130.0, 40.0)], spreads)
    places = np.array([(104.0, 47.0, 0.5), (120.0, 70.0, 1.0), (90.0, 50.0, 0.0)])
    sd_um = np.array([3.0, 1.0, 2.0])
    unknown = -9.0
    found = compute_log_densities(bank, [0, 1], places, sd_um, unknown)
    assert found.shape == (3, 2)
    for t, n in itertools.product(range(3), range(2)):
        spread = np.array(spreads[n]) + sd_um[t] ** 2 * np.eye(2)
        here = stats.multivariate_t(bank.places[n], SPREAD_FACTOR**2 * spread, df=2)
        density = here.pdf(places[t, :2]) + SELF_TURN_PROBABILITY * math.exp(unknown)
        assert found[t, n] == pytest.approx(math.log(density))


def test_a_far_place_is_as_likely_as_for_a_cell_that_turned_by_itself():
    bank = Bank([(0.0, 0.0)], [np.eye(2)])
    (found,) = compute_log_densities(bank, [0], np.array([(1e6, 0.0, 0.0)]), np.ones(1), -9.0)
    assert found == pytest.approx(-9.0 + math.log(SELF_TURN_PROBABILITY), abs=1e-3)


def test_a_track_moves_with_the_content_of_the_image():
    moving = CellTrack(
        1, 0, SIZE, last_um=np.array([5.0, 6.0]), path=[PathBlob(0.0, 1.0, 2.0, 0.0, 9.0, 4.0)]
    )
    moving.move_by(10.0, -1.0)
    assert moving.last_um.tolist() == [15.0, 5.0]
    assert moving.path[0][1:3] == (11.0, 1.0)
    assert moving.start_um is None and not moving.is_new
    moving.start_um = np.array([0.0, 0.0])
    moving.move_by(-10.0, 3.0)
    assert moving.start_um.tolist() == [-10.0, 3.0] and moving.is_new
    assert moving.last_um.tolist() == [5.0, 8.0]


@pytest.mark.parametrize("cut", [True, False])
def test_a_blob_that_is_cut_off_has_a_place_and_no_size(cut):
    blob = TrackBlob(0, SimpleNamespace(at_edge=cut), np.array([1.0, 2.0, 0.3, 40.0, 20.0]))
    place = blob.whole_place
    assert place[:3].tolist() == [1.0, 2.0, 0.3]
    assert np.isnan(place[3:]).all() == cut
    if not cut:
        assert place[3:].tolist() == [40.0, 20.0]


def test_a_track_shares_its_blob_only_if_it_has_one():
    lone = track(1)
    assert not lone.is_shared
    lone.newest_blob = TrackBlob(0, SimpleNamespace(at_edge=False), np.zeros(5))
    assert not lone.is_shared
    lone.newest_blob = TrackBlob(0, SimpleNamespace(at_edge=False), np.zeros(5), is_shared=True)
    assert lone.is_shared
