"""Tests of means, tails and fractions with intervals, against the standard library and SciPy."""

import math
import statistics

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tetractl.statistics.estimate import distributions, proportion_interval, published_distribution

lengths = st.floats(0, 5000, allow_subnormal=False)
samples = st.lists(lengths, min_size=1, max_size=30)
stated_bounds = st.one_of(st.none(), st.floats(1, 5000))
SKEWED = np.array([3, 5, 8, 9, 14, 20, 33, 61, 88, 240], dtype=float)


def distribution_of(values):
    """The one distribution of one row of values."""
    (distribution,) = distributions(np.array([values], dtype=float))
    return distribution


@given(samples)
def test_figures_agree_with_the_standard_library(values):
    distribution = distribution_of(values)
    assert distribution.n == len(values)
    assert distribution.mean == pytest.approx(statistics.fmean(values), rel=1e-12)
    assert distribution.median == pytest.approx(statistics.median(values), rel=1e-12)
    assert distribution.min == min(values)
    assert distribution.max == max(values)
    if len(values) > 1:
        assert distribution.std == pytest.approx(statistics.stdev(values), rel=1e-9, abs=1e-9)


@given(samples)
def test_the_interval_holds_the_mean_or_says_why_there_is_none(values):
    distribution = distribution_of(values)
    interval = distribution.ci95
    if interval.known:
        assert interval.low <= distribution.mean <= interval.high
        assert interval.reason is None
    else:
        assert interval.reason
        assert len(set(values)) == 1 or len(values) == 2


@given(samples, stated_bounds)
def test_the_tail_is_what_lies_above_the_bound(values, stated_bound):
    (distribution,) = distributions(np.array([values], dtype=float), stated_bound)
    tail = distribution.tail
    bound = stated_bound if stated_bound is not None else 10 * statistics.median(values)
    if bound <= 0:
        assert math.isnan(tail.bound)
        assert tail.text() == "-"
        return
    above = sum(value > bound for value in values)
    assert tail.above == above
    assert tail.n == len(values)
    assert tail.stated == (stated_bound is not None)
    assert tail.ci95 == proportion_interval(above, len(values))
    assert distribution.as_dict()["tail"]["n_above"] == above


def test_one_value_carries_no_interval():
    single = distribution_of([12.5])
    assert single.mean == 12.5
    assert single.median == 12.5
    assert math.isnan(single.std)
    assert single.ci95.reason == "a single value has no spread"


@pytest.mark.parametrize("n", [2, 20])
def test_equal_values_have_no_deviation_and_no_interval(n):
    distribution = distribution_of([0.1] * n)
    assert distribution.mean == 0.1
    assert distribution.std == 0.0
    assert distribution.ci95.reason == f"all {n} values are equal"


def test_halls_transformation_takes_the_skewness_out_of_t():
    """The upper end solves f(T) = t(0.025, n - 1), with Hall's f written out."""
    n = len(SKEWED)
    distribution = distribution_of(SKEWED)
    t = (distribution.mean - distribution.ci95.high) * math.sqrt(n) / distribution.std
    g = scipy.stats.skew(SKEWED, bias=False) / math.sqrt(n)
    f = t + g * t**2 / 3 + g**2 * t**3 / 27 + g / 6
    assert f == pytest.approx(scipy.stats.t.ppf(0.025, n - 1))


def test_values_that_may_be_negative_get_students_t():
    values = SKEWED - 20
    standard_error = scipy.stats.sem(values)
    low, high = scipy.stats.t.interval(0.95, len(values) - 1, values.mean(), standard_error)
    interval = distribution_of(values).ci95
    assert interval.method == "t"
    assert interval.low == pytest.approx(low)
    assert interval.high == pytest.approx(high)


def draws_and_true_mean(name, shape, rng):
    """Values of a distribution that is never negative, and its mean."""
    match name:
        case "normal":  # one in 470 is clipped to 0, which moves the mean by 0.0002
            return rng.normal(1, 0.35, shape).clip(0), 1.0
        case "gamma":
            return rng.gamma(2, 1, shape), 2.0
        case "lognormal":
            return rng.lognormal(0, 0.5, shape), math.exp(0.5**2 / 2)


@pytest.mark.parametrize("n", [5, 8, 20])
@pytest.mark.parametrize("name", ["normal", "gamma", "lognormal"])
def test_the_interval_covers_as_often_as_it_says(name, n):
    """BCa covers 0.80 to 0.90 of these at n = 8; benchmarks/intervals.py has the whole table."""
    rng = np.random.default_rng([n, 3])
    rows, true_mean = draws_and_true_mean(name, (2000, n), rng)
    intervals = [distribution.ci95 for distribution in distributions(rows)]
    covered = np.mean([interval.low <= true_mean <= interval.high for interval in intervals])
    assert 0.93 < covered < 0.98


def test_a_published_result_has_a_positive_interval_too():
    n = 4
    mean = 10.0
    std = 12.0
    interval = published_distribution(n, mean, std).ci95
    half = scipy.stats.t.ppf(0.975, n - 1) * std / math.sqrt(n) / mean  # of the logarithm
    assert interval.low == pytest.approx(mean * math.exp(-half))
    assert interval.high == pytest.approx(mean * math.exp(half))


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"), [(81, 263, 0.2553, 0.3662), (0, 20, 0.0, 0.1611)]
)
def test_the_interval_of_a_proportion_is_wilsons(successes, n, low, high):
    """Newcombe, Statistics in Medicine 17 (1998), table I."""
    interval = proportion_interval(successes, n)
    assert interval.low == pytest.approx(low, abs=5e-5)
    assert interval.high == pytest.approx(high, abs=5e-5)


def test_rows_are_described_apart():
    rows = np.array([SKEWED, SKEWED[::-1] * 2, np.full(10, 7.0)])
    assert distributions(rows) == [distribution_of(row) for row in rows]


def test_no_value_carries_no_figure():
    nothing = distribution_of([])
    assert nothing.n == 0
    assert math.isnan(nothing.mean)
    assert nothing.ci95.reason == "no values"


def test_without_skewness_the_logarithm_of_the_mean_is_students():
    values = 100 + np.arange(-5.0, 6.0)  # 11 values about 100, thus 10 degrees of freedom
    interval = distribution_of(values).ci95
    half = stats.t.ppf(0.975, 10) * stats.sem(values) / 100
    assert math.log(interval.low) == pytest.approx(math.log(100) - half)
    assert math.log(interval.high) == pytest.approx(math.log(100) + half)


def test_a_published_mean_of_0_has_no_interval():
    assert not published_distribution(4, 0.0, 0.0).ci95.known


def test_a_proportion_of_no_trials_has_no_interval():
    assert proportion_interval(0, 0).reason == "no trials"
