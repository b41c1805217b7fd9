import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tetractl.results.estimate import distributions
from tetractl.results.mean_difference import (
    EXACT,
    detectable,
    from_both_intervals,
    holm,
    paired_t,
    rank_sum,
    signed_rank,
    welch,
)

lengths = st.floats(0, 5000, allow_subnormal=False)
varied = st.lists(lengths, min_size=2, max_size=20).filter(lambda v: np.std(v) > 1e-3)


def only(values):
    (found,) = distributions(np.array([values], dtype=float))
    return found


def agrees(found, test):
    interval = test.confidence_interval()
    assert found.p_value == pytest.approx(test.pvalue, rel=1e-6, abs=1e-12)
    assert found.degrees == pytest.approx(test.df, rel=1e-6)
    assert (found.ci95.low, found.ci95.high) == pytest.approx(
        (interval.low, interval.high), rel=1e-6, abs=1e-6
    )


@given(varied, varied)
def test_welch_from_figures_agrees_with_scipy_on_the_values(ours, theirs):
    a, b = only(ours), only(theirs)
    found = welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
    agrees(found, stats.ttest_ind(ours, theirs, equal_var=False))


@given(st.lists(st.tuples(lengths, lengths), min_size=2, max_size=20))
def test_pairs_agree_with_scipy(pairs):
    ours, theirs = np.array(pairs).T
    differences = ours - theirs
    if np.ptp(differences) > max(1e-6 * np.abs(differences).max(), 1e-100):
        found = paired_t(differences)
        assert found.value == pytest.approx(differences.mean(), abs=1e-9)
        agrees(found, stats.ttest_rel(ours, theirs))


@pytest.mark.parametrize(
    ("found", "value", "why"),
    [
        (welch(1, 600.0, math.nan, 20, 648.6, 225.1), -48.6, "Welch's t needs two values on each"),
        (welch(5, 600.0, 0.0, 20, 648.6, 0.0), -48.6, "the values do not vary on either side"),
        (paired_t(np.array([3.0])), 3.0, "an interval needs two pairs"),
        (paired_t(np.full(9, 2.0)), 2.0, "all differences are equal"),
    ],
)
def test_too_few_or_equal_values_have_a_difference_and_the_reason_why_there_is_no_test(
    found, value, why
):
    assert found.value == pytest.approx(value)
    assert not found.ci95.known and math.isnan(found.p_value)
    assert why in found.ci95.reason


def test_the_interval_from_both_intervals_is_zou_and_donners():
    ours, theirs = only([1, 2, 3, 5, 9]), only([10, 14, 15, 40])
    found = from_both_intervals(ours, theirs)
    low = math.hypot(ours.mean - ours.ci95.low, theirs.ci95.high - theirs.mean)
    high = math.hypot(ours.ci95.high - ours.mean, theirs.mean - theirs.ci95.low)
    middle = ours.mean - theirs.mean
    assert (found.low, found.high) == pytest.approx((middle - low, middle + high))
    flat = only([3.0] * 9)
    assert from_both_intervals(flat, ours).known
    assert "do not vary" in (from_both_intervals(flat, flat).reason or "")
    assert "needs 3 values" in (from_both_intervals(ours, only([1, 2])).reason or "")


@pytest.mark.parametrize(
    ("sizes", "level", "size"),
    [((8,), 1, 1.16), ((20,), 1, 0.66), ((100,), 1, 0.283), ((20, 20), 1, 0.91), ((20,), 10, 0.91)],
)
def test_what_n_detects_is_what_the_noncentral_t_says_within_a_percent(sizes, level, size):
    found = detectable(*sizes, tests=level)
    assert found == pytest.approx(size, rel=0.015)
    degrees = sum(sizes) - len(sizes)
    root = math.sqrt(sizes[0] if len(sizes) == 1 else math.prod(sizes) / sum(sizes))
    bound = stats.t.ppf(1 - 0.025 / level, degrees)
    assert stats.nct.sf(bound, degrees, found * root) == pytest.approx(0.8, abs=0.015)


def test_single_values_detect_nothing():
    assert math.isnan(detectable(1)) and math.isnan(detectable(9, 1))


def test_ranks_of_few_values_without_ties_are_exact():
    rng = np.random.default_rng(1)
    ours, theirs = rng.normal(0, 1, 20), rng.normal(0.5, 1, 9)
    assert rank_sum(ours, theirs) == stats.mannwhitneyu(ours, theirs, method="exact").pvalue
    assert signed_rank(ours) == stats.wilcoxon(ours, method="exact").pvalue
    assert signed_rank(np.append(ours, 0.0)) == signed_rank(ours)
    many = rng.normal(0.3, 1, EXACT)
    found = stats.mannwhitneyu(ours, many, method="asymptotic", use_continuity=False)
    assert rank_sum(ours, many) == found.pvalue


def test_nothing_to_rank_has_no_p():
    assert math.isnan(signed_rank(np.zeros(9)))
    assert math.isnan(rank_sum(np.zeros(0), np.ones(3)))
    assert rank_sum(np.ones(90), np.ones(90)) == 1.0


def test_holm_steps_down():
    """The example of four tests that every textbook gives."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.01, math.nan, 0.02]) == pytest.approx([0.02, math.nan, 0.02], nan_ok=True)
