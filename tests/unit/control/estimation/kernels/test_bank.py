"""Which filters of a bank go on, and with which dead times: `kernels.bank.select`."""

import numpy as np
import pytest

from tetractl.control.estimation.kernels.bank import UNLIKELY, select
from tetractl.control.estimation.kernels.filter_state import (
    FINEST_STEP_S,
    LAG,
    LN_SATURATION,
    STATES,
    Bank,
    NextFilters,
)

pytestmark = pytest.mark.slow

STEP_S = 8 * FINEST_STEP_S
SAME = 0.02


def bank_of(times_s, scores, groups=None, tried=LN_SATURATION, values=None):
    """Filters of one robot with these dead times, scores and groups; `values` of the state."""
    count = len(times_s)
    group = np.zeros(count, np.int64) if groups is None else np.array(groups)
    bank = Bank.start(
        np.array(times_s, dtype=float), np.zeros((count, 1, STATES)), np.ones((1, 4)), group
    )
    bank.step_s[:] = STEP_S
    bank.score[:, 0] = scores
    bank.shared_score[:, 0] = scores
    if values is not None:
        bank.state[:, 0, :, tried] = np.array(values)[:, None]
    return bank


def selected(bank, tried=LN_SATURATION, commanded=True):
    """Whether the filters change, and which go on: rows, dead times and scores; and their step."""
    going_on = NextFilters.room_for(len(bank.score) + 9, bank)
    changed = select(bank, tried, SAME, commanded, going_on)
    count = int((going_on.rows >= 0).sum())
    assert (going_on.rows[count:] == -1).all()
    kept = [values[:count, 0].tolist() for values in going_on[:3]]
    return changed, *kept, going_on.step_s[0]


def grid(*steps):
    return [step * STEP_S for step in steps]


def test_before_robots_are_commanded_equally_likely_filters_go_on_as_they_are():
    bank = bank_of(grid(0, 1, 2), [-3.0, -2.0, -1.0])
    changed, rows, times_s, scores, step_s = selected(bank, commanded=False)
    assert not changed
    assert (rows, times_s, scores) == ([0, 1, 2], grid(0, 1, 2), [-3.0, -2.0, -1.0])
    assert step_s == STEP_S


@pytest.mark.parametrize("best", [0, 1, 2, 3, 4])
def test_only_likely_filters_and_the_neighbours_of_the_likeliest_go_on(best):
    scores = np.full(5, -UNLIKELY - 0.1)
    scores[best] = 0.0
    changed, rows, *_ = selected(bank_of(grid(0, 1, 2, 3, 4), scores), commanded=False)
    assert changed
    assert rows == [row for row in range(5) if abs(row - best) <= 1]


def test_filters_between_likely_ones_go_on():
    scores = [-UNLIKELY + 0.1, -99.0, -99.0, -99.0, 0.0]
    changed, rows, *_ = selected(bank_of(grid(0, 1, 2, 3, 4), scores), commanded=False)
    assert not changed
    assert rows == [0, 1, 2, 3, 4]


def test_three_dead_times_around_the_best_one_come_closer_with_scores_in_between():
    bank = bank_of(grid(2, 3, 4), [-4.0, -1.0, -3.0])
    changed, rows, times_s, scores, step_s = selected(bank)
    assert changed
    assert step_s == STEP_S / 2
    assert times_s == pytest.approx(grid(2.5, 3, 3.5))
    assert scores == pytest.approx([-2.5, -1.0, -2.0])
    assert rows[1] == 1


def test_the_finest_grid_around_the_best_dead_time_stays():
    bank = bank_of(grid(2, 3, 4), [-4.0, -1.0, -3.0])
    bank.step_s[:] = FINEST_STEP_S
    changed, rows, times_s, scores, step_s = selected(bank)
    assert not changed
    assert (rows, times_s, scores) == ([0, 1, 2], grid(2, 3, 4), [-4.0, -1.0, -3.0])
    assert step_s == FINEST_STEP_S


@pytest.mark.parametrize(("scores", "centre"), [([-4.0, -2.0, -1.0], 6), ([-1.0, -2.0, -4.0], 4)])
def test_the_finest_grid_moves_if_the_best_dead_time_is_at_its_end(scores, centre):
    """Beyond the old end, a dead time has the end's score."""
    times_s = [FINEST_STEP_S * k for k in (4, 5, 6)]
    bank = bank_of(times_s, scores)
    bank.step_s[:] = FINEST_STEP_S
    changed, _, moved_s, moved, step_s = selected(bank)
    assert changed
    assert step_s == FINEST_STEP_S
    assert moved_s == pytest.approx([FINEST_STEP_S * (centre + k) for k in (-1, 0, 1)])
    assert moved == pytest.approx(np.interp(moved_s, times_s, scores))


def test_no_dead_time_is_negative_and_zero_is_there_once():
    bank = bank_of(grid(0, 1, 2), [-1.0, -2.0, -4.0])
    changed, _, times_s, scores, _ = selected(bank)
    assert changed
    assert times_s == pytest.approx(grid(0, 0.5))
    assert scores == pytest.approx([-1.0, -1.5])


def test_the_finest_grid_stays_if_no_delay_is_best():
    times_s = [0.0, FINEST_STEP_S]
    bank = bank_of(times_s, [-1.0, -2.0])
    bank.step_s[:] = FINEST_STEP_S
    changed, rows, *_ = selected(bank)
    assert not changed
    assert rows == [0, 1]


def test_a_grid_of_more_than_three_dead_times_is_not_refined_yet():
    bank = bank_of(grid(0, 1, 2, 3), [-4.0, -1.0, -2.0, -3.0])
    changed, rows, *_, step_s = selected(bank)
    assert not changed
    assert (rows, step_s) == ([0, 1, 2, 3], STEP_S)


@pytest.mark.parametrize(
    ("values", "rows"),
    [
        ([0.0, 0.0, 0.5, 0.5], [0, 1, 2, 3]),
        ([0.0, 0.0, 0.5 * SAME, 0.5 * SAME], [2, 3]),  # the second group is likelier
        ([0.0, 0.0, -0.5 * SAME, -0.5 * SAME], [2, 3]),
    ],
)
def test_of_two_groups_that_have_reached_one_value_the_likelier_goes_on(values, rows):
    scores = [-2.0, -3.0, -1.0, -2.0]
    bank = bank_of(grid(0, 1, 0, 1), scores, [0, 0, 1, 1], values=values)
    changed, kept, *_ = selected(bank, commanded=False)
    assert kept == rows
    assert changed == (len(rows) < 4)


def test_an_unlikely_group_ends():
    scores = [-99.0, -99.0, -1.0, -2.0]
    bank = bank_of(grid(0, 1, 0, 1), scores, [0, 0, 1, 1], values=[0, 0, 1, 1])
    assert selected(bank, commanded=False)[1] == [2, 3]


def test_each_lag_has_a_grid_of_its_own_around_its_best_dead_time():
    times_s = grid(1, 2, 3, 4, 5, 6)
    scores = [-5.0, -3.0, -4.0, -4.0, -1.0, -2.0]
    groups = [0, 0, 0, 1, 1, 1]
    lags = [0.2] * 3 + [0.1] * 3
    bank = bank_of(times_s, scores, groups, LAG, lags)
    changed, _, laid_s, laid, step_s = selected(bank, tried=LAG)
    assert changed
    assert step_s == STEP_S / 2
    assert laid_s == pytest.approx(grid(1.5, 2, 2.5, 4.5, 5, 5.5))
    assert laid == pytest.approx([-4.0, -3.0, -3.5, -2.5, -1.0, -1.5])


def test_groups_of_another_state_share_the_likeliest_dead_time():
    times_s = grid(1, 2, 3, 1, 2, 3)
    scores = [-3.0, -4.0, -5.0, -4.0, -1.0, -2.0]
    bank = bank_of(times_s, scores, [0, 0, 0, 1, 1, 1], values=[0, 0, 0, 1, 1, 1])
    _, _, laid_s, laid, _ = selected(bank)
    assert laid_s == pytest.approx(grid(1.5, 2, 2.5, 1.5, 2, 2.5))
    assert laid == pytest.approx([-3.5, -4.0, -4.5, -2.5, -1.0, -1.5])
