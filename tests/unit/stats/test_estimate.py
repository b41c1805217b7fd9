import math
import statistics

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tetractl.stats.estimate import (
    ENOUGH,
    bootstrap_difference,
    cliffs_delta,
    describe,
    proportion_interval,
    welch,
)

lengths = st.floats(0, 5000, allow_subnormal=False)
samples = st.lists(lengths, min_size=1, max_size=30)
SKEWED = np.array([3, 5, 8, 9, 14, 20, 33, 61, 88, 240], dtype=float)


def only(values):
    (found,) = describe(np.array([values], dtype=float))
    return found


@settings(max_examples=40)
@given(samples)
def test_figures_agree_with_the_standard_library(values):
    found = only(values)
    assert found.n == len(values)
    assert found.mean == pytest.approx(statistics.fmean(values), rel=1e-12)
    assert found.median == pytest.approx(statistics.median(values), rel=1e-12)
    assert (found.min, found.max) == (min(values), max(values))
    if len(values) > 1:
        assert found.std == pytest.approx(statistics.stdev(values), rel=1e-9, abs=1e-9)


@settings(max_examples=40)
@given(samples)
def test_the_interval_holds_the_mean_or_says_why_there_is_none(values):
    found = only(values)
    if found.ci95.known:
        assert found.ci95.low <= found.mean <= found.ci95.high
        assert found.ci95.reason is None
    else:
        assert found.ci95.reason
        assert len(set(values)) == 1


@settings(max_examples=30)
@given(st.permutations(SKEWED.tolist()))
def test_the_order_of_the_trials_changes_nothing(values):
    assert only(values) == only(SKEWED)


@settings(max_examples=30)
@given(st.lists(lengths, min_size=2, max_size=20), st.sampled_from([1e-3, 0.1, 25.4, 1000.0]))
def test_another_unit_of_length_scales_every_figure(values, factor):
    one, other = only(values), only(np.array(values) * factor)
    near = {"rel": 1e-6, "abs": 1e-6 * factor * (1 + max(values))}
    for name in ("mean", "std", "median", "min", "max"):
        assert getattr(other, name) == pytest.approx(factor * getattr(one, name), **near)
    if one.ci95.known and other.ci95.known:
        assert other.ci95.low == pytest.approx(factor * one.ci95.low, **near)
        assert other.ci95.high == pytest.approx(factor * one.ci95.high, **near)


def test_rows_are_described_apart():
    rows = np.array([SKEWED, SKEWED[::-1] * 2, np.full(10, 7.0)])
    assert describe(rows) == [only(row) for row in rows]


def test_no_value_and_one_value_carry_no_interval():
    nothing, single = only([]), only([12.5])
    assert (nothing.n, nothing.ci95.reason) == (0, "no values")
    assert math.isnan(nothing.mean)
    assert (single.mean, single.median) == (12.5, 12.5)
    assert math.isnan(single.std)
    assert single.ci95.reason == "one value has no spread"


@pytest.mark.parametrize("n", [2, 20])
def test_equal_values_have_no_deviation_and_no_interval(n):
    found = only([0.1] * n)
    assert (found.mean, found.std) == (0.1, 0.0)
    assert found.ci95.reason == f"all {n} values are equal"


def test_a_small_batch_gets_students_t():
    values = SKEWED[: ENOUGH - 1]
    low, high = stats.t.interval(0.95, len(values) - 1, values.mean(), stats.sem(values))
    found = only(values).ci95
    assert found.method == "t"
    assert (found.low, found.high) == pytest.approx((low, high))


def reference_bca(values, resamples, rng):
    """Efron's BCa step by step, after Efron and Tibshirani (1993), 14.3."""
    n, mean = len(values), values.mean()
    means = np.array([rng.choice(values, n).mean() for _ in range(resamples)])
    bias = stats.norm.ppf(((means < mean).mean() + (means <= mean).mean()) / 2)
    left_out = np.array([np.delete(values, i).mean() for i in range(n)])
    gaps = left_out.mean() - left_out
    acceleration = (gaps**3).sum() / (6 * (gaps**2).sum() ** 1.5)
    ends = []
    for z in stats.norm.ppf([0.025, 0.975]):
        shifted = bias + (bias + z) / (1 - acceleration * (bias + z))
        ends.append(np.quantile(means, stats.norm.cdf(shifted)))
    return ends, np.quantile(means, [0.025, 0.975])


def test_the_bootstrap_agrees_with_bca_written_out():
    (low, high), percentile = reference_bca(SKEWED, 40_000, np.random.default_rng(5))
    error = stats.sem(SKEWED)
    found = only(SKEWED).ci95
    assert found.method == "BCa"
    assert found.low == pytest.approx(low, abs=0.1 * error)
    assert found.high == pytest.approx(high, abs=0.25 * error)
    assert found.high - percentile[1] > 0.5 * error  # the corrections matter for these values


def test_welch_gives_the_handbooks_figures():
    """NIST/SEMATECH e-Handbook 1.3.5.3, AUTO83B.DAT: miles a gallon of U.S. and Japanese cars."""
    found = welch(249, 20.14458, 6.414700, 79, 30.48101, 6.107710)
    error = found.value / -12.94627
    assert found.value == pytest.approx(-10.33643)
    assert found.degrees == pytest.approx(136.8750, rel=1e-5)
    half = 1.977478 * error  # t(0.975, 136.875)
    assert found.ci95.low == pytest.approx(found.value - half, rel=1e-5)
    assert found.ci95.high == pytest.approx(found.value + half, rel=1e-5)
    assert found.p_value < 1e-20


@settings(max_examples=50)
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


def test_the_difference_of_two_bootstraps_is_near_welchs():
    rng = np.random.default_rng(8)
    ours, theirs = rng.normal(500, 100, 40), rng.normal(600, 200, 60)
    found = bootstrap_difference(ours, theirs)
    a, b = only(ours), only(theirs)
    other = welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
    assert found.low == pytest.approx(other.ci95.low, abs=8)
    assert found.high == pytest.approx(other.ci95.high, abs=8)
    back = bootstrap_difference(theirs, ours)
    assert (-back.high, -back.low) == pytest.approx((found.low, found.high), abs=8)


def test_the_bootstrap_of_a_difference_needs_values_that_vary():
    few, flat = SKEWED[: ENOUGH - 1], np.full(10, 3.0)
    assert "needs 8 values" in (bootstrap_difference(few, SKEWED).reason or "")
    assert "do not vary" in (bootstrap_difference(flat, flat).reason or "")
    assert bootstrap_difference(flat, SKEWED).known


@settings(max_examples=60)
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


def test_wilsons_interval_of_a_proportion():
    """Newcombe, Statistics in Medicine 17 (1998), table I: 81 of 263 and 0 of 20."""
    found = proportion_interval(81, 263)
    assert (found.low, found.high) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    found = proportion_interval(0, 20)
    assert (found.low, found.high) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert proportion_interval(0, 0).reason == "no trials"
