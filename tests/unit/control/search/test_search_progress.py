"""Tests of how far a search has come: its best sequence, its history, and its limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.control.search.search_progress import SearchProgress
from tetractl.core.plan import Limits, StopReason

COSTS = st.lists(st.floats(-100, 100), min_size=1, max_size=6)


@given(st.lists(COSTS, min_size=1, max_size=6))
def test_the_best_of_all_sequences_is_kept_and_the_history_never_rises(rounds):
    progress = SearchProgress(2, Limits())
    number = 0
    for costs in rounds:
        signals = np.array([number + np.arange(len(costs)), np.zeros(len(costs))], dtype=float)
        progress.add_iteration(signals, np.array(costs))
        number += len(costs)
    search = progress.to_search()
    every_cost = np.concatenate(rounds)
    assert search.cost == every_cost.min()
    assert search.signals[0] == every_cost.argmin()  # of equal ones, the first
    assert search.evaluations == number
    so_far = [every_cost[: sum(map(len, rounds[: k + 1]))].min() for k in range(len(rounds))]
    assert search.history.tolist() == so_far
    assert (search.length, search.stopped) == (2, StopReason.ITERATIONS)


def test_a_first_sequence_whose_cost_is_infinite_is_kept_until_there_is_a_better_one():
    progress = SearchProgress(1, Limits())
    progress.add_to_history(np.array([3.0]), np.inf)
    progress.add_to_history(np.array([4.0]), np.inf)
    assert progress.best_signals.tolist() == [3]
    progress.add_to_history(np.array([5.0]), 7.0)
    assert (progress.best_signals.tolist(), progress.best_cost) == ([5], 7)


def test_what_the_caller_does_with_his_arrays_later_does_not_matter():
    signals = np.array([[1.0, 2.0]])
    progress = SearchProgress(1, Limits())
    progress.add_iteration(signals, np.array([5.0, 3.0]))
    signals[:] = 9.0
    assert progress.best_signals.tolist() == [2]


@pytest.mark.parametrize(("further", "reason"), [(4, None), (5, StopReason.EVALUATIONS)])
def test_a_search_may_use_all_evaluations_but_not_one_more(further, reason):
    progress = SearchProgress(1, Limits(evaluations=10))
    progress.add_best(np.zeros(1), 1.0, 6)
    assert progress.find_limit(further) is reason


def test_the_deadline_is_asked_with_the_evaluations_so_far():
    progress = SearchProgress(1, Limits(expired=lambda spent: spent >= 6))
    assert progress.find_limit(100) is None
    progress.add_best(np.zeros(1), 1.0, 6)
    assert progress.find_limit(1) is StopReason.DEADLINE
    progress.stop_reason = StopReason.DEADLINE
    assert progress.to_search().stopped is StopReason.DEADLINE
