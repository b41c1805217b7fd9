import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tetractl.results.estimate import distributions, proportion_interval, published_distribution

lengths = st.floats(0, 5000, allow_subnormal=False)
samples = st.lists(lengths, min_size=1, max_size=30)
SKEWED = np.array([3, 5, 8, 9, 14, 20, 33, 61, 88, 240], dtype=float)


def only(values):
    (found,) = distributions(np.array([values], dtype=float))
    return found


@given(samples)
def test_figures_agree_with_the_standard_library(values):
    found = only(values)
    assert found.n == len(values)
    assert found.mean == pytest.approx(statistics.fmean(values), rel=1e-12)
    assert found.median == pytest.approx(statistics.median(values), rel=1e-12)
    assert (found.min, found.max) == (min(values), max(values))
    if len(values) > 1:
        assert found.std == pytest.approx(statistics.stdev(values), rel=1e-9, abs=1e-9)


@given(samples)
def test_the_interval_holds_the_mean_or_says_why_there_is_none(values):
    found = only(values)
    if found.ci95.known:
        assert found.ci95.low <= found.mean <= found.ci95.high
        assert found.ci95.reason is None
    else:
        assert found.ci95.reason
        assert len(set(values)) == 1 or len(values) == 2


def test_rows_are_described_apart():
    rows = np.array([SKEWED, SKEWED[::-1] * 2, np.full(10, 7.0)])
    assert distributions(rows) == [only(row) for row in rows]


@given(samples, st.one_of(st.none(), st.floats(1, 5000)))
def test_the_tail_is_what_lies_above_the_bound(values, bound):
    (found,) = distributions(np.array([values], dtype=float), bound)
    tail, limit = found.tail, 10 * statistics.median(values) if bound is None else bound
    if limit <= 0:
        assert math.isnan(tail.bound)
        assert tail.text() == "-"
        return
    above = sum(value > limit for value in values)
    assert (tail.above, tail.n, tail.stated) == (above, len(values), bound is not None)
    assert tail.ci95 == proportion_interval(above, len(values))
    assert found.as_dict()["tail"]["n_above"] == above


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


def test_halls_transformation_takes_the_skewness_out_of_t():
    """The upper end solves f(T) = t(0.025, n - 1), with Hall's f written out."""
    n, found = len(SKEWED), only(SKEWED)
    t = (found.mean - found.ci95.high) * math.sqrt(n) / found.std
    g = stats.skew(SKEWED, bias=False) / math.sqrt(n)
    assert t + g * t**2 / 3 + g**2 * t**3 / 27 + g / 6 == pytest.approx(stats.t.ppf(0.025, n - 1))


def test_without_skewness_the_logarithm_of_the_mean_is_students():
    values = 100 + np.arange(-5.0, 6.0)
    found = only(values).ci95
    half = stats.t.ppf(0.975, 10) * stats.sem(values) / 100
    assert np.log([found.low, found.high]) == pytest.approx(math.log(100) + np.array([-half, half]))


def test_values_that_may_be_negative_get_students_t():
    values = SKEWED - 20
    low, high = stats.t.interval(0.95, len(values) - 1, values.mean(), stats.sem(values))
    found = only(values).ci95
    assert found.method == "t"
    assert (found.low, found.high) == pytest.approx((low, high))


@pytest.mark.parametrize(("n", "least"), [(5, 0.93), (8, 0.93), (20, 0.93)])
@pytest.mark.parametrize("name", ["normal", "gamma", "lognormal"])
def test_the_interval_covers_as_often_as_it_says(name, n, least):
    """BCa covers 0.80 to 0.90 of these at n = 8; benchmarks/intervals.py has the whole table."""
    rng = np.random.default_rng([n, 3])
    draws = {
        "normal": (rng.normal(1, 0.35, (2000, n)).clip(0), 1.0),
        "gamma": (rng.gamma(2, 1, (2000, n)), 2.0),
        "lognormal": (rng.lognormal(0, 0.5, (2000, n)), math.exp(0.125)),
    }
    rows, true = draws[name]
    share = np.mean([f.ci95.low <= true <= f.ci95.high for f in distributions(rows)])
    assert least < share < 0.98


def test_a_published_result_has_a_positive_interval_too():
    found = published_distribution(4, 10.0, 12.0)
    half = stats.t.ppf(0.975, 3) * 12 / 2 / 10
    ends = 10 * math.exp(-half), 10 * math.exp(half)
    assert (found.ci95.low, found.ci95.high) == pytest.approx(ends)
    assert not published_distribution(4, 0.0, 0.0).ci95.known


def test_wilsons_interval_of_a_proportion():
    """Newcombe, Statistics in Medicine 17 (1998), table I: 81 of 263 and 0 of 20."""
    found = proportion_interval(81, 263)
    assert (found.low, found.high) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    found = proportion_interval(0, 20)
    assert (found.low, found.high) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert proportion_interval(0, 0).reason == "no trials"
