"""Verdicts on claims: one rule, by intervals, and the published number's own uncertainty."""

import numpy as np
import pytest
from tetractl_papers.claim import (
    Claim,
    Fate,
    NumberKind,
    assess,
    at_least,
    at_most,
    one_run,
    rarely,
    same_deviation,
    same_mean,
)


def fate_of(asked, values):
    """The verdict on the values of trials."""
    return asked.decide(values, asked.number(values))


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


def test_a_published_mean_and_deviation_agree_within_their_own_uncertainty():
    """F = (322 / 225.1)^2 = 2.05 is below its bound 2.53 for two samples of 20."""
    draws = np.random.default_rng(1).normal(0, 1, 20)
    standardised = (draws - draws.mean()) / draws.std(ddof=1)
    values = 638.1 + 322.0 * standardised
    assert fate_of(same_deviation(225.1, 20), values) is Fate.AGREES
    assert fate_of(same_deviation(225.1, 20), 2 * values) is Fate.MISSED
    assert fate_of(same_mean(648.6, 225.1, 20), values) is Fate.AGREES
    assert fate_of(same_mean(648.6, 225.1, 20), values / 3) is Fate.MISSED


def test_a_published_run_agrees_if_it_is_no_rare_one_of_ours():
    runs = np.arange(100.0)
    assert fate_of(one_run(90.0), runs) is Fate.AGREES
    assert one_run(90.0).number(runs).value == 0.1
    assert fate_of(one_run(99.0), runs) is Fate.MISSED


def test_a_difference_is_paired_and_tells_both_means():
    claim = Claim("f", "less", "ours", lambda trial: trial, at_most(0), minus="other")
    row = assess(claim, {"ours": [1.0, 2.0, 3.0, 9.0], "other": [2.0, 3.0, 4.0]})
    assert row.ours.value == -1
    assert row.ours.means == (2, 3)
    assert row.verdict is Fate.REACHED


def test_what_no_controller_can_do_is_out_of_reach_only_if_it_is_not_reached():
    def verdict(bound):
        claim = Claim("f", "p", "ours", float, at_most(bound), expected=Fate.OUT_OF_REACH)
        return assess(claim, {"ours": VALUES}).verdict

    assert verdict(12) is Fate.OUT_OF_REACH
    assert verdict(15) is Fate.REACHED
