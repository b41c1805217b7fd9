"""Tests of means, tails and fractions with intervals, against the standard library and SciPy."""

import math
import statistics

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tetractl.statistics.estimate import (
    ArmErrors,
    Interval,
    are_numeric,
    distributions,
    percent,
    proportion_interval,
    published_distribution,
    t_quantile,
)

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


@given(st.lists(st.floats(0.1, 1e4), min_size=4, max_size=12, unique=True), st.floats(1e-3, 1e3))
def test_lengths_in_another_unit_give_the_same_figures_in_this_unit(values, scale):
    ours = distribution_of(values)
    theirs = distribution_of([scale * value for value in values])
    for name in ("mean", "std", "median", "min", "max"):
        assert getattr(theirs, name) == pytest.approx(scale * getattr(ours, name), rel=1e-9)
    ends = [(ours.ci95.low, theirs.ci95.low), (ours.ci95.high, theirs.ci95.high)]
    for mine, scaled in ends:
        assert scaled == pytest.approx(scale * mine, rel=1e-6)
    assert 0 < ours.ci95.low < ours.ci95.high


@pytest.mark.parametrize(
    ("values", "bound", "reason"),
    [
        ([0.0, 0.0, 9.0], None, "the median is not positive"),
        ([1.0, 2.0, 9.0], 0.0, "the bound is not positive"),
        ([1.0, 2.0, 9.0], -1.0, "the bound is not positive"),
        ([0.0, 0.0, 9.0], math.nan, "the bound is not positive"),
    ],
)
def test_a_tail_without_a_positive_bound_says_what_is_not_positive(values, bound, reason):
    (distribution,) = distributions(np.array([values]), bound)
    assert distribution.tail.ci95.reason == reason
    assert math.isnan(distribution.tail.bound)
    assert distribution.tail.as_dict()["n_above"] is None


def test_the_tail_names_its_bound_with_a_unit_and_by_whom_it_was_set():
    (stated,) = distributions(np.array([[1.0, 2.0, 85.0, 99.0]]), 85.0)
    assert stated.tail.above == 1  # not the one at the bound
    assert stated.tail.label == "errors above error_bound"
    assert stated.tail.text("mm") == "1 of 4 above 85.0 mm (95 % interval 5 to 70 %)"
    (own,) = distributions(np.array([[1.0, 2.0, 3.0]]))
    assert own.tail.label == "errors above 10 times the median"
    assert own.tail.text() == "0 of 3 above 20.0 (95 % interval 0 to 56 %)"


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        (Interval(1.25, 2.5, "t"), "1.2 to 2.5"),
        (Interval.none("too few"), "none: too few"),
        (Interval.none(""), "-"),
        (Interval(1.0, math.inf), "-"),
        (Interval(math.nan, 1.0), "-"),
    ],
)
def test_an_interval_is_known_if_both_ends_are(interval, text):
    assert interval.text("{:.1f}".format) == text
    known = text == "1.2 to 2.5"
    assert interval.known == known
    assert interval.bounds == ([1.25, 2.5] if known else None)
    assert (percent(interval) != "") == known


@pytest.mark.parametrize(("mean", "std", "known"), [(5, 1, True), (5, 0, False), (0, 1, False)])
def test_a_published_result_has_an_interval_if_its_mean_and_deviation_are_positive(
    mean, std, known
):
    published = published_distribution(9, mean, std)
    assert published.ci95.known == known
    assert (published.n, published.mean, published.std) == (9, mean, std)
    for unknown in (published.median, published.min, published.max, published.tail.bound):
        assert math.isnan(unknown)


@given(st.integers(1, 200), st.floats(0.01, 0.999))
def test_the_bound_of_t_is_two_sided(degrees, confidence):
    bound = t_quantile(degrees, confidence)
    assert 2 * scipy.stats.t.sf(bound, degrees) == pytest.approx(1 - confidence, abs=1e-9)


@given(st.integers(1, 60), st.data())
def test_wilsons_interval_holds_the_fraction_and_mirrors_its_complement(n, data):
    successes = data.draw(st.integers(0, n))
    interval = proportion_interval(successes, n)
    other = proportion_interval(n - successes, n)
    assert 0 <= interval.low <= successes / n <= interval.high <= 1
    assert (interval.low == 0) == (successes == 0)
    assert (interval.high == 1) == (successes == n)
    assert interval.low == pytest.approx(1 - other.high)


@pytest.mark.parametrize(
    ("values", "are_numbers"),
    [((1, 2.5), True), ((1, "exact"), False), ((True, False), False), ((None, 1), False)],
)
def test_only_numbers_can_be_an_axis(values, are_numbers):
    arms = [ArmErrors.from_errors(v, str(v), 1, np.array([1.0, 2.0])) for v in values]
    assert are_numeric(arms) == are_numbers


def test_an_arm_has_the_distribution_of_its_errors_and_its_bound():
    arm = ArmErrors.from_errors(0.1, "0.1", 3, np.array([1.0, 2.0, 9.0]), bound=5.0)
    assert arm.error.n == 3
    assert arm.error.mean == 4.0
    assert (arm.error.tail.above, arm.error.tail.stated) == (1, True)
    assert (arm.value, arm.label, arm.arms) == (0.1, "0.1", 3)
