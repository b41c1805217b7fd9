"""Tests of the compiled filter steps against whole matrices, and of what they must not do."""

import math

import numpy as np
import pytest
from testkit.microscope import helix_steps as oracle
from tetractl_microscope.cells.helix import HelixFilter, new_cell
from tetractl_microscope.cells.kernels.helix_steps import (
    DELAY,
    HEADING,
    LEAD,
    PATH_LENGTH,
    RATE,
    SPEED,
    SPEED_MIN,
    STATE_SIZE,
    STEP_MAX_S,
    TURN,
    A,
    C,
    S,
    X,
    Y,
)
from tetractl_microscope.organisms import TETRAHYMENA

*_, MODEL = new_cell(TETRAHYMENA, field_known=True)
FIELD = 0.6, 0.8
OTHER = -0.8, 0.6
ROW = np.array([0])


def spread(seed=5):
    root = np.random.default_rng(seed).normal(0, 0.3, (STATE_SIZE, STATE_SIZE))
    return root @ root.T


def bank_with(speed=300.0, walled=False, seed=5):
    """A filter of one cell in the midst of its helix, with correlated uncertainties."""
    bank = HelixFilter(near_wall=lambda x, y: np.full(len(x), walled))
    row = bank.add(3.0, -2.0, 0.4, speed)
    bank.means[row, [C, S, TURN, DELAY, LEAD]] = 4.0, -3.0, 0.1, 0.01, 0.2
    bank.covariances[row] += spread(seed)
    return bank


def state(bank, row=0):
    return bank.means[row].copy(), bank.covariances[row].copy()


def same(one, other, rel=1e-9):
    assert one[0] == pytest.approx(other[0], rel=rel, abs=1e-9)
    assert one[1] == pytest.approx(other[1], rel=max(rel, 1e-9), abs=1e-7)


@pytest.mark.parametrize(
    ("steps", "seconds"), [(1, STEP_MAX_S), (2, 1.5 * STEP_MAX_S), (4, 4 * STEP_MAX_S)]
)
def test_a_long_interval_is_equal_steps_of_40_ms_at_most(steps, seconds):
    whole, parts = bank_with(), bank_with()
    whole.predict([(seconds, *FIELD)])
    for _ in range(steps):
        parts.predict([(seconds / steps, *FIELD)])
    same(state(whole), state(parts))
    coarse = bank_with()
    coarse.predict([(0.01, *FIELD)])
    assert state(coarse)[0][PATH_LENGTH] == pytest.approx(0.01 * 300.0)


def test_successive_intervals_may_come_in_one_call_or_in_several():
    """The field of the interval before is remembered, as a cell responds late to a change."""
    pieces = [(0.02, *FIELD), (0.013, *OTHER), (0.03, 0.0, 0.0)]
    once, in_turn = bank_with(), bank_with()
    once.predict(pieces)
    for piece in pieces:
        in_turn.predict([piece])
        in_turn.predict([])
    same(state(once), state(in_turn))


@pytest.mark.parametrize(("before", "after"), [(FIELD, OTHER), (OTHER, FIELD), ((0, 0), FIELD)])
def test_a_change_of_the_field_acts_after_the_delay_of_the_cell(before, after):
    bank = bank_with()
    bank.predict([(0.02, *before)])
    m, p = state(bank)
    bank.predict([(0.02, *after)])
    change = before, after, MODEL[SPEED_MIN]
    f = oracle.slopes(lambda at: oracle.switched(at, *change), m)
    expected, covariance, _ = oracle.move(
        oracle.switched(m, *change), f @ p @ f.T, MODEL, False, 0.02, after
    )
    same(state(bank), (expected, covariance), rel=1e-5)
    lingered = DELAY
    assert m[lingered] != 0 and not np.allclose(oracle.switched(m, *change), m)


@pytest.mark.parametrize("part", [(0, 1), (1, 0)])
def test_a_change_of_one_component_is_a_change(part):
    """Only x or only y of the field changes."""
    after = FIELD[0] + 0.5 * part[0], FIELD[1] - 0.5 * part[1]
    bank = bank_with()
    bank.predict([(0.02, *FIELD)])
    m, p = state(bank)
    bank.predict([(0.02, *after)])
    f = oracle.slopes(lambda at: oracle.switched(at, FIELD, after, MODEL[SPEED_MIN]), m)
    switched = oracle.switched(m, FIELD, after, MODEL[SPEED_MIN])
    expected, _, _ = oracle.move(switched, f @ p @ f.T, MODEL, False, 0.02, after)
    assert state(bank)[0] == pytest.approx(expected, rel=1e-6)


def test_other_rows_stay_as_they_are():
    bank = bank_with()
    second = bank.add(100.0, 50.0, 1.0, 200.0)
    bank.free_row(0)
    gone = state(bank)
    bank.predict([(0.03, *FIELD)])
    same(gone, state(bank))
    assert bank.means[second, PATH_LENGTH] == pytest.approx(6.0)
    before = state(bank, second)
    bank.add(0.0, 0.0, 0.0, 300.0)
    bank.update(ROW, np.array([[1.0, 1.0, 0.0]]), np.ones((1, 3)))
    same(before, state(bank, second))


@pytest.mark.parametrize("speed", [300.0, 20.0, 61.0])
def test_a_body_is_expected_beside_the_axis_with_its_covariance(speed):
    bank = bank_with(speed)
    m, p = state(bank)
    bodies, spreads = bank.predict_bodies(ROW)
    assert bodies[0] == pytest.approx(oracle.body(m, MODEL[SPEED_MIN]))
    h = oracle.slopes(lambda at: oracle.body(at, MODEL[SPEED_MIN]), m)[:2]
    assert spreads[0] == pytest.approx(h @ p @ h.T, rel=1e-5)


def test_rows_are_predicted_and_updated_in_any_order():
    bank = bank_with()
    second = bank.add(100.0, 50.0, 1.0, 200.0)
    third = bank.add(-40.0, 20.0, -2.0, 250.0)
    rows = np.array([third, 0, second])
    bodies, _ = bank.predict_bodies(rows)
    for body, row in zip(bodies, rows, strict=True):
        assert body == pytest.approx(oracle.body(bank.means[row], MODEL[SPEED_MIN]))
    before = [state(bank, row) for row in rows]
    measured = bodies + np.array([1.0, -2.0, 0.1]) * np.arange(1, 4)[:, None]
    deviations = np.array([1.0, 2.0, 0.1]) * np.arange(1, 4)[:, None]
    likelihoods, distances = bank.update(rows, measured, deviations)
    for k, row in enumerate(rows):
        m, p, likelihood, distance = oracle.correct(*before[k], MODEL, measured[k], deviations[k])
        same(state(bank, row), (m, p), rel=1e-5)
        assert (likelihoods[k], distances[k]) == pytest.approx((likelihood, distance), rel=1e-6)


@pytest.mark.parametrize("off", [0.1, math.pi + 0.1, -2 * math.pi + 0.1, math.pi / 2 - 0.2])
def test_an_axis_has_no_front(off):
    bank, other = bank_with(), bank_with()
    body = oracle.body(bank.means[0], MODEL[SPEED_MIN])
    deviation = np.array([[1.0, 1.0, 0.05]])
    bank.update(ROW, (body + np.array([0, 0, off]))[None], deviation)
    near = (off + math.pi / 2) % math.pi - math.pi / 2
    other.update(ROW, (body + np.array([0, 0, near]))[None], deviation)
    same(state(bank), state(other))


@pytest.mark.parametrize(("back_um", "turned"), [(40.0, True), (2.0, False)])
def test_a_cell_that_swims_backwards_is_turned_around(back_um, turned):
    bank = bank_with(70.0)
    bank.covariances[0, SPEED, SPEED] = 4e4
    bank.predict([(0.3, 0.0, 0.0)])
    m, p = state(bank)
    measured = oracle.body(m, MODEL[SPEED_MIN]) - back_um * np.array(
        [math.cos(0.4), math.sin(0.4), 0]
    )
    deviation = np.array([1.0, 1.0, 0.5])
    expected, covariance, *_ = oracle.correct(m, p, MODEL, measured, deviation)
    bank.update(ROW, measured[None], deviation[None])
    same(state(bank), (expected, covariance), rel=1e-4)
    assert (abs(bank.means[0, HEADING] - m[HEADING]) > 2) == turned
    assert bank.means[0, SPEED] > -MODEL[SPEED_MIN]


def test_without_a_field_only_the_unexplained_turning_turns():
    bank = HelixFilter(field_known=False)
    row = bank.add(0.0, 0.0, 0.5, 300.0)
    bank.means[row, TURN] = 2.0
    bank.covariances[row] = 1e-12 * np.eye(STATE_SIZE)
    bank.predict([(0.02, 0.0, 0.0)])
    assert bank.means[row, HEADING] == pytest.approx(0.5 + 2.0 * 0.02)
    assert bank.means[row, A] == 0.0
    middle = 0.5 + 2.0 * 0.01
    assert bank.means[row, [X, Y]] == pytest.approx(
        6.0 * np.array([math.cos(middle), math.sin(middle)]), rel=1e-3
    )


def test_a_helix_turns_at_its_rate_and_decays_slowly():
    bank = bank_with()
    rate = bank.means[0, RATE]
    swing = complex(4.0, -3.0)
    bank.predict([(0.04, 0.0, 0.0)] * 5)
    swing *= np.exp((1j * rate - 1 / 5.0) * 0.2)
    assert complex(*bank.means[0, [C, S]]) == pytest.approx(swing)


# ---- rows of the filter ----


def test_a_copy_is_a_row_of_its_own_and_a_dropped_row_is_used_again():
    bank = bank_with()
    copy = bank.copy_row(0)
    assert copy != 0
    same(state(bank), state(bank, copy))
    bank.means[copy, X] += 5.0
    assert bank.means[0, X] == 3.0
    bank.free_row(0)
    assert bank.add(9.0, 8.0, 0.0, 100.0) == 0
    assert bank.means[0, [X, Y, HEADING, SPEED]].tolist() == [9.0, 8.0, 0.0, 100.0]
    assert bank.covariances[0] == pytest.approx(new_cell(TETRAHYMENA, True).covariance)


def test_there_is_room_for_many_cells():
    bank = HelixFilter()
    rows = [bank.add(float(k), 0.0, 0.0, 300.0) for k in range(40)]
    assert sorted(rows) == list(range(40)) and bank.is_used.sum() == 40
    assert bank.means[rows, X].tolist() == list(range(40))


def test_a_moved_cell_keeps_its_speed_and_rates_but_no_offset_from_its_axis():
    bank = bank_with()
    bank.means[0, A] = 2.5
    m, p = state(bank)
    row = bank.copy_row_to(0, 50.0, 60.0, 2.0)
    moved, covariance = state(bank, row)
    assert moved[[X, Y, HEADING, C, S]].tolist() == [50.0, 60.0, 2.0, 0.0, 0.0]
    kept = [k for k in range(STATE_SIZE) if k not in (X, Y, HEADING, C, S)]
    assert moved[kept].tolist() == m[kept].tolist()
    assert covariance[np.ix_(kept, kept)].tolist() == p[np.ix_(kept, kept)].tolist()
    new = np.diagonal(new_cell(TETRAHYMENA, True).covariance)
    assert np.diagonal(covariance)[[X, Y, HEADING, C, S]] == pytest.approx(
        new[[X, Y, HEADING, C, S]]
    )
    assert not covariance[np.ix_([X, Y, HEADING, C, S], kept)].any()
    same((m, p), state(bank))


def test_a_loosened_cell_is_as_uncertain_as_a_new_one_where_it_is_but_not_how_it_turns():
    bank = bank_with()
    _, p = state(bank)
    bank.widen([0])
    added = bank.covariances[0] - p
    new = new_cell(TETRAHYMENA, True).covariance.copy()
    new[RATE:] = 0.0
    assert added == pytest.approx(new)
