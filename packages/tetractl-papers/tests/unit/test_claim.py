"""Tests of verdicts on claims: they depend only on intervals, and experiments get none."""

import numpy as np
import pytest
from tetractl_papers.claim import (
    Claim,
    Fate,
    NumberKind,
    assess,
    at_least,
    at_most,
    deviation_of,
    mean_of,
    not_judged,
    rarely,
    same_number,
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
