"""Tests of which trials of a batch count, and of what its figures are computed from."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit.batches import DISTURBED, REFERENCE, batch, experiment, group, result, trial

from tetractl.core.errors import UsageError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Verdict
from tetractl.log.read.trial_log import Origin
from tetractl.statistics.as_json import batch_items
from tetractl.statistics.flagged import flagged
from tetractl.statistics.open_batch import Batch, Damaged
from tetractl.statistics.tables import figure_lines

TRIALS = 20
ERRORS = np.random.default_rng(4).gamma(4, 50, (TRIALS, 3)).tolist()  # of three robots [mm]
TOTALS = np.sum(ERRORS, axis=1)


def of_origin(origin, trials):
    """The same trials with another origin; logs of a lab differ by their digests."""
    return [replace(trial, origin=origin, digest=trial.log) for trial in trials]


@settings(max_examples=15)
@given(st.randoms(use_true_random=False))
def test_the_order_of_the_logs_changes_nothing(random):
    trials = batch(ERRORS, experiment(reference=REFERENCE))
    in_order = group(trials)
    shuffled = group(random.sample(trials, len(trials)))
    assert shuffled.total == in_order.total
    assert shuffled.robots == in_order.robots
    assert list(figure_lines(shuffled)) == list(figure_lines(in_order))


def test_only_trials_that_ran_to_their_end_enter_the_means():
    complete = batch(ERRORS[:3])
    spec = complete[0].experiment
    aborted = result([9e5] * 3, outcome=Outcome.ABORTED)
    interrupted = result([9e5] * 3, outcome=Outcome.INTERRUPTED)
    without_error = result([math.nan, 1, 1])
    described = group(
        [
            *complete,
            trial("aborted.mcap", spec, aborted, 3),
            trial("interrupted.mcap", spec, interrupted, 4),
            trial("lost.mcap", spec, without_error, 5),
        ]
    )
    items = batch_items(described)
    assert len(described.batch.trials) == 6
    assert described.counted == 3
    assert items["aborted"] == 1
    assert items["interrupted"] == 1
    assert described.total.mean == pytest.approx(TOTALS[:3].mean())


@pytest.mark.parametrize(("tolerance", "arrived"), [(20, 0), (0, None)])
def test_arrivals_are_known_where_a_controller_says_what_arriving_is(tolerance, arrived):
    """None came within 20 mm of its target; 0 says nothing."""
    spec = experiment(controller={"arrival_tolerance": tolerance})
    items = batch_items(group(batch(ERRORS, spec)))
    assert items["arrived"] == arrived
    assert (items["arrived_ci95"] is None) == (arrived is None)


def test_solve_times_are_of_all_trials_while_robots_drove():
    """Regression: first plans and plans at rest hid by how much a plan for driving robots is in
    time."""
    fast, slow = batch([[1.0], [2.0]])
    fast_ms = range(99)
    fast_ns = tuple(time_ms * 1_000_000 for time_ms in fast_ms)
    fast = replace(fast, result=result([1.0], solve_ns=(5_000_000_000, *fast_ns)))  # an older log
    times_ns = (4_000_000_000, 900_000_000, 3_000_000_000)
    drove = (False, True, False)
    ended = result([2.0], solve_ns=times_ns, drove=drove, deadline_misses=1)
    items = batch_items(group([fast, replace(slow, result=ended)]))
    times_ms = [*fast_ms, 900]
    assert items["solve_all_max_ms"] == 5000
    assert items["solve_ms"]["p50"] == pytest.approx(np.percentile(times_ms, 50))
    assert items["solve_ms"]["p99"] == pytest.approx(np.percentile(times_ms, 99))
    assert items["solve_ms"]["max"] == 900
    assert items["deadline_misses"] == 1


@pytest.mark.parametrize(
    ("found_s", "text", "unusual"),
    [
        ((0.1, 0.2, 0.15), "0.150 measured (n = 3, 95 % interval 0.", True),
        ((0.14, 0.14), "0.140 measured (n = 2), 0.000 in the spec", True),  # equal: no interval
        ((0.01, 0.01), "0.010 measured (n = 2), 0.000 in the spec", False),
    ],
)
def test_a_found_lag_of_the_wheels_stands_next_to_that_of_the_spec(found_s, text, unusual):
    trials = batch(ERRORS[: len(found_s)])
    lags = zip(trials, found_s, strict=True)
    found = group([replace(t, result=replace(t.result, wheel_lag_s=lag_s)) for t, lag_s in lags])
    (figure,) = (one for one in found.figures if one.label == "lag of the wheels [s]")
    assert figure.text.startswith(text)
    assert figure.text.endswith(", 0.000 in the spec")
    assert figure.unusual == unusual
    assert batch_items(found)["wheel_lag_s"] == pytest.approx(np.mean(found_s))


def test_of_robots_whose_controller_finds_no_lag_none_is_said():
    described = group(batch(ERRORS[:2]))
    assert "lag of the wheels [s]" not in [figure.label for figure in described.figures]
    assert batch_items(described)["wheel_lag_s"] is None


def test_the_published_result_is_compared_by_welch():
    spec = experiment(reference=REFERENCE)
    described = group(of_origin(Origin.LAB, batch(ERRORS, spec)))
    mean = TOTALS.mean()
    std = TOTALS.std(ddof=1)
    published = (REFERENCE["mean"], REFERENCE["std"], REFERENCE["n"])
    test = scipy.stats.ttest_ind_from_stats(mean, std, TRIALS, *published, equal_var=False)
    comparison = batch_items(described)["reference"]
    assert comparison["difference"] == pytest.approx(mean - REFERENCE["mean"])
    assert comparison["p_value"] == pytest.approx(test.pvalue)
    low, high = comparison["ci95"]
    assert low < comparison["difference"] < high


def test_two_experiments_in_one_batch_are_refused_with_what_differs():
    trials = batch(ERRORS[:2])
    exact_and_late = experiment(controller={"motion": "exact"}, plant={"dead_time": 0.15})
    trials[1] = replace(trials[1], experiment=exact_and_late)
    with pytest.raises(UsageError) as caught:
        group(trials)
    assert "trial-000.mcap and trial-001.mcap are from different experiments" in str(caught.value)
    assert "controller.motion: euler != exact" in str(caught.value)
    assert "plant.dead_time: 0.0 != 0.15" in str(caught.value)
    assert caught.value.hint
    assert "--against" in caught.value.hint


def test_a_trial_given_twice_is_refused():
    trials = batch(ERRORS[:2])
    with pytest.raises(UsageError, match="contain the same trial"):
        group([*trials, replace(trials[0], log="copy.mcap")])


@pytest.mark.parametrize(
    ("plant", "origin", "compared"),
    [
        ({"type": "sim"}, Origin.UNDISTURBED, False),
        (DISTURBED, Origin.DISTURBED, False),
        ({"type": "sim"}, Origin.EMULATED, False),
        ({"type": "sim"}, Origin.LAB, True),
    ],
)
def test_only_real_robots_are_compared_with_a_published_result(plant, origin, compared):
    spec = experiment(reference=REFERENCE, plant=plant)
    described = group(of_origin(origin, batch(ERRORS, spec)))
    assert described.origin is origin
    reference = batch_items(described)["reference"]
    assert reference["comparable"] == compared
    assert math.isfinite(reference["difference"]) == compared
    assert math.isfinite(reference["p_value"]) == compared
    assert (reference["ci95"] is not None) == compared


def test_a_lab_and_its_emulation_are_no_batch():
    trials = batch(ERRORS[:2])
    mixed = [replace(trials[0], origin=Origin.LAB), replace(trials[1], origin=Origin.EMULATED)]
    with pytest.raises(
        UsageError, match=r"from the lab, but trial-001\.mcap from the emulated lab"
    ):
        group(mixed)


@pytest.mark.parametrize(
    "name", ["trial-000.attempt-1.mcap", "trial-000.mcap.part.unfinished-1", "old/anything.mcap"]
)
def test_an_attempt_does_not_count_whatever_its_log_is_called(name):
    trials = batch(ERRORS[:3])
    described = group([*trials, an_aborted_attempt(name, trials[0].experiment)])
    assert len(described.batch.trials) == 3
    assert described.counted == 3
    assert batch_items(described)["aborted"] == 0
    assert [attempt.log for attempt in described.batch.attempts] == [name]


def an_aborted_attempt(name, spec):
    """The log of an earlier attempt of trial 0, with errors that would show in any mean."""
    stopped = result([9e5] * 3, outcome=Outcome.ABORTED, reason="the cable came off")
    return trial(name, spec, stopped, 0)


def test_an_attempt_that_cannot_be_read_is_counted_and_leaves_the_batch_whole():
    unreadable = Damaged("trial-000.attempt-1.mcap.part", "not an MCAP file")
    described = group(batch(ERRORS[:3]), [unreadable])
    assert batch_items(described)["n_attempts"] == 1
    assert described.batch.lost == ()
    assert described.batch.whole
    assert flagged(described.batch)[0].notes[-1] == "not an MCAP file"


def test_nothing_but_attempts_is_no_batch():
    attempt = replace(batch([[1.0]])[0], log="trial-000.attempt-1.mcap")
    with pytest.raises(UsageError, match="all of these logs are earlier attempts"):
        group([attempt])


def notes_by_log(trials):
    return {trial.log: trial.notes for trial in flagged(Batch.from_results(trials))}


def test_flagged_trials_are_those_that_ended_oddly():
    trials = batch(ERRORS[:5])
    assert notes_by_log(trials) == {}
    inside = Verdict(Poses.from_array(np.zeros((3, 3))), (True, False, True), (-1.0, 5.0, -2.0))
    trials[1] = replace(trials[1], result=result([1, 2, 3], verdict=inside))
    trials[2] = replace(trials[2], result=result([1, 2, 3], outcome=Outcome.STEPS_MAX))
    assert notes_by_log(trials) == {
        "trial-001.mcap": ("green, red entered an obstacle",),
        "trial-002.mcap": ("did not end in 31 steps",),
    }
