import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tetractl.results.estimate import distributions
from tetractl.results.mean_difference import cliffs_delta, from_both_intervals, paired_t, welch

lengths = st.floats(0, 5000, allow_subnormal=False)
samples = st.lists(lengths, min_size=1, max_size=30)


def only(values):
    (found,) = distributions(np.array([values], dtype=float))
    return found


@given(
    st.lists(lengths, min_size=2, max_size=20).filter(lambda v: np.std(v) > 1e-3),
    st.lists(lengths, min_size=2, max_size=20).filter(lambda v: np.std(v) > 1e-3),
)
def test_welch_from_figures_agrees_with_scipy_on_the_values(ours, theirs):
    a, b = only(ours), only(theirs)
    found = welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
    test = stats.ttest_ind(ours, theirs, equal_var=False)
    interval = test.confidence_interval()
    assert found.p_value == pytest.approx(test.pvalue, rel=1e-6, abs=1e-12)
    assert found.degrees == pytest.approx(test.df, rel=1e-6)
    assert (found.ci95.low, found.ci95.high) == pytest.approx(
        (interval.low, interval.high), rel=1e-6, abs=1e-6
    )


def test_welch_says_nothing_where_n_cannot_carry_it():
    single = welch(1, 600.0, math.nan, 20, 648.6, 225.1)
    assert single.value == pytest.approx(-48.6)
    assert not single.ci95.known
    assert math.isnan(single.p_value)
    assert single.ci95.reason == "Welch's t needs two values on each side"
    still = welch(5, 600.0, 0.0, 20, 648.6, 0.0)
    assert not still.ci95.known
    assert still.ci95.reason == "the values do not vary on either side"


def test_the_interval_from_both_intervals_is_zou_and_donners():
    ours, theirs = only([1, 2, 3, 5, 9]), only([10, 14, 15, 40])
    found = from_both_intervals(ours, theirs)
    low = math.hypot(ours.mean - ours.ci95.low, theirs.ci95.high - theirs.mean)
    high = math.hypot(ours.ci95.high - ours.mean, theirs.mean - theirs.ci95.low)
    middle = ours.mean - theirs.mean
    assert (found.low, found.high) == pytest.approx((middle - low, middle + high))
    back = from_both_intervals(theirs, ours)
    assert (-back.high, -back.low) == pytest.approx((found.low, found.high))


def test_the_interval_from_both_needs_both():
    flat, varied = only([3.0] * 9), only([1, 2, 3, 5, 9])
    assert from_both_intervals(flat, varied).known
    assert "do not vary" in (from_both_intervals(flat, flat).reason or "")
    assert "needs 3 values" in (from_both_intervals(varied, only([1, 2])).reason or "")


@given(st.lists(st.tuples(lengths, lengths), min_size=2, max_size=20))
def test_pairs_agree_with_scipy(pairs):
    ours, theirs = np.array(pairs).T
    differences = ours - theirs
    found = paired_t(differences)
    if np.ptp(differences) <= max(1e-6 * np.abs(differences).max(), 1e-100):
        return
    test = stats.ttest_rel(ours, theirs)
    interval = test.confidence_interval()
    assert found.value == pytest.approx(differences.mean(), abs=1e-9)
    assert found.p_value == pytest.approx(test.pvalue, rel=1e-6, abs=1e-12)
    assert (found.ci95.low, found.ci95.high) == pytest.approx(
        (interval.low, interval.high), rel=1e-6, abs=1e-6
    )


def test_one_pair_or_pairs_that_differ_alike_carry_no_interval():
    assert paired_t(np.array([])).ci95.reason == paired_t(np.array([3.0])).ci95.reason
    alike = paired_t(np.full(9, 2.0))
    assert (alike.value, alike.ci95.reason) == (2.0, "all differences are equal")


@given(samples, samples)
def test_cliffs_delta_counts_pairs(ours, theirs):
    found = cliffs_delta(np.array(ours), np.array(theirs))
    pairs = [np.sign(a - b) for a in ours for b in theirs]
    assert found.value == pytest.approx(np.mean(pairs), abs=1e-12)
    if found.ci95.known:
        assert -1 <= found.ci95.low <= found.value + 1e-9
        assert found.value - 1e-9 <= found.ci95.high <= 1
        back = cliffs_delta(np.array(theirs), np.array(ours)).ci95
        assert (-back.high, -back.low) == pytest.approx((found.ci95.low, found.ci95.high), abs=1e-9)
    else:
        assert found.ci95.reason == "one value has no spread"


def test_batches_that_do_not_overlap_keep_an_interval_that_narrows_with_n():
    widths = []
    for n in (4, 20, 100):
        found = cliffs_delta(np.arange(n) + 1000.0, np.arange(n) + 0.0)
        assert (found.value, found.ci95.high) == (1.0, 1.0)
        widths.append(1 - found.ci95.low)
    assert 1 > widths[0] > widths[1] > widths[2] > 0


def test_cliffs_interval_covers_as_often_as_it_says():
    rng = np.random.default_rng(2)
    true = 2 * stats.norm.cdf(1 / math.sqrt(2)) - 1  # N(1, 1) against N(0, 1)
    found = [cliffs_delta(rng.normal(1, 1, 15), rng.normal(0, 1, 12)).ci95 for _ in range(800)]
    assert np.mean([i.low <= true <= i.high for i in found]) == pytest.approx(0.95, abs=0.025)
