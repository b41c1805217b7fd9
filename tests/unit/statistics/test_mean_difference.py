"""Tests of comparing two means or ranks, against SciPy, and of detectable differences."""

import math

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from tetractl.statistics.estimate import distributions
from tetractl.statistics.mean_difference import (
    EXACT_VALUES_MAX,
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


def distribution_of(values):
    """The one distribution of one row of values."""
    (distribution,) = distributions(np.array([values], dtype=float))
    return distribution


def assert_agrees(difference, scipy_test):
    interval = scipy_test.confidence_interval()
    assert difference.p_value == pytest.approx(scipy_test.pvalue, rel=1e-6, abs=1e-12)
    assert difference.degrees == pytest.approx(scipy_test.df, rel=1e-6)
    assert difference.ci95.low == pytest.approx(interval.low, rel=1e-6, abs=1e-6)
    assert difference.ci95.high == pytest.approx(interval.high, rel=1e-6, abs=1e-6)


@given(varied, varied)
def test_welch_from_figures_agrees_with_scipy_on_the_values(ours, theirs):
    a = distribution_of(ours)
    b = distribution_of(theirs)
    difference = welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
    assert_agrees(difference, scipy.stats.ttest_ind(ours, theirs, equal_var=False))


@given(st.lists(st.tuples(lengths, lengths), min_size=2, max_size=20))
def test_pairs_agree_with_scipy(pairs):
    ours, theirs = np.array(pairs).T
    differences = ours - theirs
    largest = np.abs(differences).max()
    rounding = max(1e-6 * largest, 1e-100)  # differences that are equal but for it have no spread
    if np.ptp(differences) > rounding:
        difference = paired_t(differences)
        assert difference.value == pytest.approx(differences.mean(), abs=1e-9)
        assert_agrees(difference, scipy.stats.ttest_rel(ours, theirs))


@pytest.mark.parametrize(
    ("difference", "value", "why"),
    [
        (welch(1, 600.0, math.nan, 20, 648.6, 225.1), -48.6, "Welch's t needs two values on each"),
        (welch(5, 600.0, 0.0, 20, 648.6, 0.0), -48.6, "the values do not vary on either side"),
        (paired_t(np.array([3.0])), 3.0, "an interval needs two pairs"),
        (paired_t(np.full(9, 2.0)), 2.0, "all differences are equal"),
    ],
)
def test_too_few_or_equal_values_have_a_difference_and_the_reason_why_there_is_no_test(
    difference, value, why
):
    assert difference.value == pytest.approx(value)
    assert not difference.ci95.known
    assert math.isnan(difference.p_value)
    assert why in difference.ci95.reason


def test_the_interval_from_both_intervals_is_zou_and_donners():
    ours = distribution_of([1, 2, 3, 5, 9])
    theirs = distribution_of([10, 14, 15, 40])
    interval = from_both_intervals(ours, theirs)
    below = math.hypot(ours.mean - ours.ci95.low, theirs.ci95.high - theirs.mean)
    above = math.hypot(ours.ci95.high - ours.mean, theirs.mean - theirs.ci95.low)
    difference = ours.mean - theirs.mean
    assert interval.low == pytest.approx(difference - below)
    assert interval.high == pytest.approx(difference + above)


@pytest.mark.parametrize(
    ("sizes", "tests", "expected"),
    [((8,), 1, 1.16), ((20,), 1, 0.66), ((100,), 1, 0.283), ((20, 20), 1, 0.91), ((20,), 10, 0.91)],
)
def test_what_n_detects_is_what_the_noncentral_t_says_within_a_percent(sizes, tests, expected):
    """A t test with that true effect exceeds its bound at 5 % in 80 % of batches.

    `sizes` are the number of pairs, or those of two groups; `tests` share the 5 %.
    """
    effect = detectable(*sizes, tests=tests)
    assert effect == pytest.approx(expected, rel=0.015)
    degrees = sum(sizes) - len(sizes)
    effective_n = sizes[0] if len(sizes) == 1 else math.prod(sizes) / sum(sizes)
    noncentrality = effect * math.sqrt(effective_n)
    bound = scipy.stats.t.ppf(1 - 0.025 / tests, degrees)
    assert scipy.stats.nct.sf(bound, degrees, noncentrality) == pytest.approx(0.8, abs=0.015)


def test_ranks_of_few_values_without_ties_are_exact():
    rng = np.random.default_rng(1)
    ours = rng.normal(0, 1, 20)
    theirs = rng.normal(0.5, 1, 9)
    assert rank_sum(ours, theirs) == scipy.stats.mannwhitneyu(ours, theirs, method="exact").pvalue
    assert signed_rank(ours) == scipy.stats.wilcoxon(ours, method="exact").pvalue


def test_the_ranks_of_many_values_are_asymptotic():
    rng = np.random.default_rng(1)
    ours = rng.normal(0, 1, 20)
    many = rng.normal(0.3, 1, EXACT_VALUES_MAX)
    test = scipy.stats.mannwhitneyu(ours, many, method="asymptotic", use_continuity=False)
    assert rank_sum(ours, many) == test.pvalue


def test_holm_steps_down():
    """The example of four tests that every textbook gives."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.01, math.nan, 0.02]) == pytest.approx([0.02, math.nan, 0.02], nan_ok=True)


def test_there_is_an_interval_from_both_where_one_of_both_varies():
    varying = distribution_of([1, 2, 3, 5, 9])
    flat = distribution_of([3.0] * 9)
    assert from_both_intervals(flat, varying).known
    assert "do not vary" in from_both_intervals(flat, flat).reason


def test_there_is_no_interval_from_both_where_one_has_too_few_values():
    varying = distribution_of([1, 2, 3, 5, 9])
    two_values = distribution_of([1, 2])
    assert "needs at least 3 values" in from_both_intervals(varying, two_values).reason


@pytest.mark.parametrize("sizes", [(1,), (9, 1)])
def test_single_values_detect_nothing(sizes):
    assert math.isnan(detectable(*sizes))


def test_a_difference_of_0_has_no_sign_and_no_rank():
    differences = np.random.default_rng(1).normal(0, 1, 20)
    assert signed_rank(np.append(differences, 0.0)) == signed_rank(differences)


def test_nothing_to_rank_has_no_p():
    no_values = np.zeros(0)
    assert math.isnan(signed_rank(np.zeros(9)))
    assert math.isnan(rank_sum(no_values, np.ones(3)))


def test_equal_values_have_no_ranks_that_differ():
    equal = np.ones(90)
    assert rank_sum(equal, equal) == 1.0
