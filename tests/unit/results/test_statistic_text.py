"""Every kind of number has one text, one short text, and its items in JSON."""

from collections import Counter

import numpy as np
import pytest

from tetractl.core.plan import Outcome
from tetractl.results.estimate import distributions, proportion_interval
from tetractl.results.statistic_text import brief_text, full_text, json_items
from tetractl.results.statistic_value import (
    AboveBound,
    Count,
    Mean,
    OutcomeCounts,
    Scalar,
    Share,
    StatisticValue,
    Unknown,
    Worded,
)
from tetractl.tools.table.table import digits

VALUES = np.array([1.0, 1.0, 1.0, 100.0])  # one of four is above 10 times the median
(FOUR,) = distributions(VALUES[None])
LOW, HIGH = proportion_interval(3, 20).ends
ENDED = OutcomeCounts(Counter({Outcome.ARRIVED: 3, Outcome.ABORTED: 1}))
TEXTS = [
    (Count(3), "3", "3"),
    (
        Share(3, 20),
        "3 of 20 (95 % interval 5 to 36 %)",
        "3 of 20 (95 % interval 5 to 36 %)",
    ),
    (
        Share(3, 20, "bodies"),
        "3 of 20 (95 % interval 5 to 36 %), counting bodies",
        "3 of 20 (bodies)",
    ),
    (Scalar(1.25, digits), "1.25", "1.25"),
    (Scalar(1.25, digits, n=7), "1.25 (n 7)", "1.25 (n 7)"),
    (Scalar(None, digits, n=0), "-", "-"),
    (Worded(2, "2 of 9 trials, by false poses"),) + ("2 of 9 trials, by false poses",) * 2,
    (Unknown("no radius"), "- (no radius)", "- (no radius)"),
    (Unknown(), "-", "-"),
]


@pytest.mark.parametrize(("number", "text", "brief"), TEXTS)
def test_a_number_has_a_text_and_a_brief_one(number, text, brief):
    assert full_text(number) == text
    assert brief_text(number) == brief


def test_a_mean_states_its_interval_and_its_trials_where_they_are_asked_for():
    interval = FOUR.ci95.text("{:.1f}".format)
    assert full_text(Mean(FOUR)) == f"25.8 (95 % interval {interval})"
    assert full_text(Mean(FOUR, states_n=True)) == f"25.8 (n 4, 95 % interval {interval})"
    assert full_text(AboveBound(FOUR.tail)).startswith("1 of 4 above 10.0 (")


def test_outcomes_are_explained_where_there_is_room():
    explained = f"3 arrived ({Outcome.ARRIVED.meaning}); 1 aborted ({Outcome.ABORTED.meaning})"
    assert full_text(ENDED) == explained
    assert brief_text(ENDED) == "3 arrived, 1 aborted"


def test_json_has_every_number_under_its_key():
    values = [
        StatisticValue("late", "late", Count(3)),
        StatisticValue("arrived", "arrived", Share(3, 20)),
        StatisticValue("p50", "median", Scalar(1.25, digits), within="solve_ms"),
        StatisticValue("p99", "rare", Scalar(None, digits), within="solve_ms"),
        StatisticValue("far", "far", Mean(FOUR)),
        StatisticValue("", "  tail", AboveBound(FOUR.tail)),
        StatisticValue("turned", "", Unknown("no camera")),
    ]
    assert json_items(values) == {
        "late": 3,
        "arrived": 3,
        "arrived_ci95": [LOW, HIGH],
        "solve_ms": {"p50": 1.25, "p99": None},
        "far": FOUR.as_dict(),
        "turned": None,
    }
    outcomes = json_items([StatisticValue("outcomes", "outcomes", ENDED)])["outcomes"]
    assert set(outcomes) == {way.value for way in Outcome}
    assert {way: n for way, n in outcomes.items() if n} == {"arrived": 3, "aborted": 1}
