"""Tests of verdicts on claims: they depend only on intervals, and experiments get none."""

import math

import numpy as np
import pytest
from scipy import stats
from tetractl_papers.claim import (
    Claim,
    Fate,
    NumberKind,
    OurNumber,
    as_often,
    assess,
    at_least,
    at_most,
    deviation_of,
    mean_of,
    not_judged,
    rarely,
    same_number,
    share_of,
)


def fate_of(asked, values):
    """The verdict on the values of trials."""
    return asked.decide(asked.number(values))


VALUES = np.array([10.0, 11.0, 12.0, 13.0])
"""Mean 11.5, 95 % interval 9.6 to 13.8: Student's t on a logarithmic scale."""


@pytest.mark.parametrize(
    ("bound", "verdict"),
    [(15, Fate.REACHED), (12, Fate.UNDECIDED), (8, Fate.MISSED)],
)
def test_a_mean_is_reached_or_missed_by_its_whole_interval(bound, verdict):
    assert fate_of(at_most(bound), VALUES) is verdict
    assert fate_of(at_least(-bound), -VALUES) is verdict


@pytest.mark.parametrize(
    ("count", "n", "verdict"),
    [
        (0, 20, Fate.UNDECIDED),  # Wilson: 0 to 16 %
        (0, 100, Fate.REACHED),  # 0 to 3.7 %
        (3, 100, Fate.UNDECIDED),  # 1 to 8.5 %
        (22, 100, Fate.MISSED),  # 15 to 31 %
    ],
)
def test_absence_needs_as_many_trials_as_presence(count, n, verdict):
    values = (np.arange(n) < count).astype(float)
    assert fate_of(rarely(0.05), values) is verdict
    assert rarely(0.05).number(values).kind is NumberKind.SHARE


def test_a_published_number_agrees_if_our_interval_holds_it():
    assert fate_of(same_number(11.0), VALUES) is Fate.AGREES
    assert fate_of(same_number(20.0), VALUES) is Fate.MISSED


@pytest.mark.parametrize("number", [mean_of, deviation_of])
def test_the_number_of_an_experiment_is_not_judged_whatever_ours_is(number):
    for values in (VALUES, 100 * VALUES):
        asked = not_judged(number)
        ours = asked.number(values)
        assert asked.decide(ours) is Fate.NOT_JUDGED
        assert ours.low < ours.value < ours.high


def test_a_difference_is_paired_and_tells_both_means():
    claim = Claim("f", "less", "ours", lambda trial: trial, at_most(0), minus="other")
    row = assess(claim, {"ours": [1.0, 2.0, 3.0, 9.0], "other": [2.0, 3.0, 4.0]})
    assert row.ours.value == -1
    assert row.ours.means == (2, 3)
    assert row.verdict is Fate.REACHED


# ---- numbers against SciPy, and criteria at their bounds ----


@pytest.mark.parametrize("n", [2, 5, 40])
def test_a_deviation_has_its_chi_square_interval(n):
    """As often as 95 of 100 times, (n - 1) s^2 / sigma^2 is between the quantiles."""
    values = np.random.default_rng(905_117).normal(20, 3, n)
    ours = deviation_of(values)
    assert ours.value == pytest.approx(np.std(values, ddof=1))
    assert ours.n == n
    squares = (n - 1) * ours.value**2
    assert stats.chi2(n - 1).sf(squares / ours.low**2) == pytest.approx(0.025)
    assert stats.chi2(n - 1).cdf(squares / ours.high**2) == pytest.approx(0.025)


def test_the_deviation_of_one_value_is_unknown_and_that_of_two_is_not():
    assert math.isnan(deviation_of(np.array([3.0])).value)
    assert deviation_of(np.array([3.0, 5.0])).value == pytest.approx(math.sqrt(2))


@pytest.mark.parametrize(("count", "n"), [(0, 20), (7, 20), (20, 20), (1, 100)])
def test_a_share_has_wilsons_interval_and_counts_what_is_above_zero(count, n):
    values = np.where(np.arange(n) < count, 0.5, 0.0)
    ours = share_of(values)
    interval = stats.binomtest(count, n).proportion_ci(method="wilson")
    assert (ours.value, ours.n) == (count / n, n)
    assert (ours.low, ours.high) == pytest.approx(interval, abs=1e-9)


@pytest.mark.parametrize("values", [[4.0], [4.0, 4.0, 4.0]])
def test_a_mean_without_an_interval_is_a_point(values):
    ours = mean_of(np.array(values))
    assert (ours.low, ours.value, ours.high) == (4, 4, 4)


def number(low, high):
    return OurNumber(NumberKind.MEAN, (low + high) / 2, 9, low, high)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (1.0, 2.0, Fate.REACHED),  # up to the bound
        (2.0, 2.0, Fate.REACHED),
        (1.0, 2.001, Fate.UNDECIDED),
        (2.0, 3.0, Fate.UNDECIDED),
        (2.001, 3.0, Fate.MISSED),
    ],
)
def test_a_bound_itself_satisfies_the_criterion(low, high, verdict):
    assert at_most(2).decide(number(low, high)) is verdict
    assert at_least(-2).decide(number(-high, -low)) is verdict


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (1.0, 2.0, Fate.AGREES),
        (2.0, 3.0, Fate.AGREES),
        (2.0, 2.0, Fate.AGREES),
        (1.0, 1.999, Fate.MISSED),
        (2.001, 3.0, Fate.MISSED),
    ],
)
def test_an_interval_holds_its_ends(low, high, verdict):
    assert same_number(2).decide(number(low, high)) is verdict
    assert as_often(2).decide(number(low, high)) is verdict


def test_criteria_say_what_they_ask_in_percent():
    assert rarely(0.05).words == "in fewer than 5 %"
    assert as_often(0.25).words == "agreement with 25 %"


def test_without_a_difference_all_trials_of_the_arm_count():
    claim = Claim("f", "3", "ours", lambda trial: trial, at_most(3))
    row = assess(claim, {"ours": [1.0, 2.0, 6.0], "other": [2.0]})
    assert (row.ours.value, row.ours.n, row.ours.means) == (3, 3, None)
    assert row.verdict is Fate.UNDECIDED


@pytest.mark.parametrize("shorter", ["ours", "other"])
def test_a_difference_takes_the_trials_that_both_arms_have(shorter):
    results = {"ours": [5.0, 6.0, 8.0], "other": [1.0, 2.0, 3.0]}
    results[shorter] = results[shorter][:2]
    claim = Claim("f", "4", "ours", lambda trial: trial, same_number(4), minus="other")
    row = assess(claim, results)
    assert (row.ours.value, row.ours.n) == (4, 2)
    assert row.ours.means == (5.5, 1.5)
    assert row.verdict is Fate.AGREES


def test_a_trial_without_the_number_is_no_trial_that_may_be_left_out():
    claim = Claim("f", "4", "ours", lambda trial: trial, at_most(4))
    with pytest.raises(AssertionError, match="f: the trials have no such number"):
        assess(claim, {"ours": [1.0, math.nan]})
