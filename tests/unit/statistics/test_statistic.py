"""Tests that every kind of figure has a text, a short text, and items in JSON."""

import numpy as np
from testkit.batches import batch

from tetractl.core.plan import Outcome
from tetractl.statistics import built_in_statistics
from tetractl.statistics.built_in_statistics import MEANINGS
from tetractl.statistics.estimate import distributions, proportion_interval
from tetractl.statistics.statistic import count, fraction, mean_figure, number, share_figure

VALUES = np.array([1.0, 1.0, 1.0, 100.0])  # one of four is above 10 times the median
(FOUR,) = distributions(VALUES[None])
THREE_OF_20 = proportion_interval(3, 20).bounds
ERRORS = [[1.0], [1.0], [1.0], [100.0]]  # of one robot in four trials


def test_a_share_has_an_interval_and_beside_others_it_has_none_if_it_says_what_it_counts():
    plain = share_figure("late", "late", 3, 20)
    assert plain.text == "3 of 20 (95 % interval 5 to 36 %)"
    assert plain.brief is None  # it stays as it is
    assert plain.items == {"late": 3, "late_ci95": THREE_OF_20}
    of_bodies = share_figure("late", "late", 3, 20, counting="bodies")
    assert of_bodies.text == "3 of 20 (95 % interval 5 to 36 %), counting bodies"
    assert of_bodies.brief == "3 of 20 (bodies)"
    assert of_bodies.items == plain.items


def test_a_mean_states_its_interval_and_its_trials_where_they_are_asked_for():
    interval = FOUR.ci95.text("{:.1f}".format)
    assert mean_figure("far", "far", FOUR).text == f"25.8 (95 % interval {interval})"
    with_n = mean_figure("far", "far", FOUR, states_n=True)
    assert with_n.text == f"25.8 (n 4, 95 % interval {interval})"
    assert with_n.items == {"far": FOUR.as_dict()}


def test_a_count_and_a_share_are_of_the_trials_for_which_a_condition_holds():
    trials = batch(ERRORS)
    (late,) = count("late", "late trials", lambda trial: trial.trial > 0).of_batch(trials)
    assert (late.label, late.text, late.items) == ("late trials", "3", {"late": 3})
    (part,) = fraction("part", "of them", lambda trial: trial.trial > 0).of_batch(trials)
    assert part.text.startswith("3 of 4 (95 % interval ")


def test_outcomes_are_explained_where_there_is_room():
    trials = batch([*ERRORS, [1.0]])
    done = trials[0].outcome
    trials[4] = batch([[1.0]], outcome=Outcome.ABORTED, reason="")[0]
    (figure,) = built_in_statistics.OUTCOMES.of_batch(trials)
    explained = f"4 {done.value} ({MEANINGS[done]}); 1 aborted ({MEANINGS[Outcome.ABORTED]})"
    assert figure.text == explained
    assert figure.brief == f"4 {done.value}, 1 aborted"
    assert set(figure.items["outcomes"]) == {way.value for way in Outcome}
    seen = {way: n for way, n in figure.items["outcomes"].items() if n}
    assert seen == {done.value: 4, "aborted": 1}
    assert figure.items["aborted"] == 1


def test_aborts_are_named_the_most_frequent_first():
    reasons = ["green left", "blue hit", "green left", "green lost", "red lost", "blue lost"]
    trials = [batch([[1.0]], outcome=Outcome.ABORTED, reason=reason)[0] for reason in reasons]

    def text(trials):
        (figure,) = built_in_statistics.OUTCOMES.of_batch(trials)
        return figure.text

    assert text(trials[:1]) == "1 aborted (green left)"
    assert text([trials[0], trials[2]]) == "2 aborted (green left)"
    assert text(trials[:3]) == "3 aborted (2 x green left; 1 x blue hit)"
    named = "2 x green left; 1 x blue hit; 1 x green lost; 2 x other reasons"
    assert text(trials) == f"6 aborted ({named})"


def test_what_is_unknown_says_why_and_is_null_in_json():
    trials = batch(ERRORS)
    (arrived,) = built_in_statistics.ARRIVED.of_batch(trials)
    assert arrived.text == "- (no arrival_tolerance)"
    assert arrived.items == {"arrived": None, "arrived_ci95": None}
    (clearance,) = built_in_statistics.EDGE.of_batch(trials)
    assert clearance.text == "-"


def test_a_mean_of_a_number_is_followed_by_its_tail_which_json_has_with_the_mean():
    far = number("far", "far", lambda result: result.total_error)
    mean, tail = far.of_batch(batch(ERRORS))
    assert mean.items == {"far": FOUR.as_dict()}
    assert tail.label == "  errors above 10 times the median"
    assert tail.text.startswith("1 of 4 above 10.0 (")
    assert not tail.items
