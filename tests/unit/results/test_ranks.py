import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tetractl.results.mean_difference import EXACT, holm, rank_sum, signed_rank

values = st.lists(st.floats(-1e3, 1e3, allow_subnormal=False), min_size=2, max_size=25)
tied = st.lists(st.integers(-3, 3), min_size=2, max_size=8)


@given(tied.filter(lambda found: any(found)))
def test_with_ties_every_case_is_counted(found):
    kept = np.array([value for value in found if value], dtype=float)
    ranks = stats.rankdata(np.abs(kept))
    signs = np.array(np.meshgrid(*[[0, 1]] * len(kept))).reshape(len(kept), -1)
    sums = ranks @ signs
    seen = ranks[kept > 0].sum()
    expected = min(1.0, 2 * min((sums <= seen).mean(), (sums >= seen).mean()))
    assert signed_rank(np.array(found, dtype=float)) == pytest.approx(expected)


@given(values, values)
def test_the_rank_sum_test_is_scipys_without_ties(ours, theirs):
    if len({*ours, *theirs}) < len(ours) + len(theirs):
        return
    expected = stats.mannwhitneyu(ours, theirs, method="exact").pvalue
    assert rank_sum(np.array(ours), np.array(theirs)) == pytest.approx(expected)


def test_the_rank_sum_test_counts_every_case_with_ties():
    ours, theirs = np.array([1.0, 2, 2, 5]), np.array([2.0, 3, 3, 5, 7])
    method = stats.PermutationMethod(n_resamples=10**6)  # more than there are: all of them
    expected = stats.mannwhitneyu(ours, theirs, method=method).pvalue
    assert rank_sum(ours, theirs) == pytest.approx(expected)


def test_many_values_are_taken_as_normal():
    rng = np.random.default_rng(1)
    ours, theirs = (rng.integers(0, 30, EXACT + n).astype(float) for n in (1, 9))
    expected = stats.mannwhitneyu(ours, theirs, method="asymptotic", use_continuity=False).pvalue
    assert rank_sum(ours, theirs) == pytest.approx(expected)
    pairs = rng.normal(0.3, 1, EXACT + 1)
    expected = stats.wilcoxon(pairs, method="asymptotic", correction=False).pvalue
    assert signed_rank(pairs) == pytest.approx(expected)


def test_nothing_to_rank_has_no_p():
    assert math.isnan(signed_rank(np.zeros(9)))
    assert math.isnan(rank_sum(np.zeros(0), np.ones(3)))
    assert rank_sum(np.ones(90), np.ones(90)) == 1.0


def test_holm_steps_down():
    """The example of four tests that every textbook gives."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    with_none = holm([0.01, math.nan, 0.02])
    assert (with_none[0], with_none[2]) == pytest.approx((0.02, 0.02))
    assert math.isnan(with_none[1])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_never_lowers_a_p_and_keeps_the_order(found):
    corrected = holm(found)
    assert all(one >= p for one, p in zip(corrected, found, strict=True))
    assert max(corrected) <= 1
    assert [c for _, c in sorted(zip(found, corrected, strict=True))] == sorted(corrected)
