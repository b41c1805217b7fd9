import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from support.batches import DISTURBED, REFERENCE, SCALE, batch, experiment, group, result, trial
from support.marked_robots import MarkedRobots

from tetractl.core.commands import Verdict
from tetractl.core.errors import UsageError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.log.read.trial_log import Origin
from tetractl.results.as_json import batch_items
from tetractl.results.batch_rows import batch_rows
from tetractl.results.flagged import flagged
from tetractl.results.open_batch import Batch, Damaged

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3))


@settings(max_examples=15)
@given(st.randoms(use_true_random=False))
def test_the_order_of_the_logs_changes_nothing(random):
    trials = batch(ERRORS.tolist(), experiment(reference=REFERENCE, scale=SCALE))
    mixed = random.sample(trials, len(trials))
    one, other = group(trials), group(mixed)
    assert other.total == one.total
    assert other.robots == one.robots
    assert batch_rows(other) == batch_rows(one)


def test_only_trials_that_ran_to_their_end_enter_the_means():
    trials = batch(ERRORS[:3].tolist())
    spec = trials[0].experiment
    for i, outcome in enumerate([Outcome.ABORTED, Outcome.INTERRUPTED], start=3):
        trials.append(trial(f"{outcome}.mcap", spec, result([9e5] * 3, outcome=outcome), i))
    trials.append(trial("lost.mcap", spec, result([math.nan, 1, 1]), 5))
    found = group(trials)
    assert (len(found.batch.trials), found.counted) == (6, 3)
    assert (batch_items(found)["aborted"], batch_items(found)["interrupted"]) == (1, 1)
    assert found.total.mean == pytest.approx(ERRORS[:3].sum(axis=1).mean())


@pytest.mark.parametrize(
    "outcome", [Outcome.ARRIVED, Outcome.SEQUENCE_COMPLETED, Outcome.STEPS_MAX]
)
def test_outcomes_decided_by_the_controller_count(outcome):
    found = group(batch(ERRORS.tolist(), outcome=outcome))
    assert found.counted == 20
    assert batch_items(found)["outcomes"][outcome.value] == 20


def test_arrivals_are_not_known_where_nothing_says_what_arriving_is():
    arrived = [
        group(batch(ERRORS.tolist(), experiment(controller={"arrival_tolerance": tolerance})))
        for tolerance in (0, 20)
    ]
    assert [batch_items(found)["arrived"] for found in arrived] == [None, 0]
    assert [batch_items(found)["arrived_ci95"] is None for found in arrived] == [True, False]


def test_solve_times_are_over_all_steps_of_all_trials():
    trials = batch([[1.0], [2.0]])
    trials[0] = replace(
        trials[0], result=result([1.0], solve_ns=tuple(range(0, 99_000_000, 1_000_000)))
    )
    trials[1] = replace(trials[1], result=result([2.0], solve_ns=(900_000_000,), deadline_misses=1))
    found = group(trials)
    times = [*range(99), 900]
    assert batch_items(found)["solve_ms"]["p50"] == pytest.approx(np.percentile(times, 50))
    assert batch_items(found)["solve_ms"]["p99"] == pytest.approx(np.percentile(times, 99))
    assert batch_items(found)["solve_ms"]["max"] == 900
    assert batch_items(found)["deadline_misses"] == 1


def test_the_published_result_is_compared_by_welch():
    found = group(batch(ERRORS.tolist(), experiment(reference=REFERENCE, plant=DISTURBED)))
    totals = ERRORS.sum(axis=1)
    test = stats.ttest_ind_from_stats(
        totals.mean(), totals.std(ddof=1), 20, 648.6, 225.1, 20, equal_var=False
    )
    comparison = batch_items(found)["reference"]
    assert comparison["difference"] == pytest.approx(totals.mean() - 648.6)
    assert comparison["p_value"] == pytest.approx(test.pvalue)
    low, high = comparison["ci95"]
    assert low < comparison["difference"] < high
    assert batch_items(group(batch(ERRORS.tolist())))["reference"] is None


def test_errors_scale_by_the_ratio_of_speeds():
    spec = experiment(reference=REFERENCE, scale=SCALE, plant=DISTURBED)
    found = batch_items(group(batch([[200, 300, 358.8]] * 3, spec)))["scaled"]
    speed = (180 + 200 + 150) / 3
    assert found["mean"] == pytest.approx(858.8 / 3 * 300 / speed)
    assert found["body_lengths"] == pytest.approx(found["mean"] / 50)
    assert found["published_mean"] == pytest.approx(648.6 / 3 * 300 / speed)
    assert found["ci95"] is None


def test_robots_that_stand_still_have_no_scaled_error():
    still = experiment(1).robots[0].model_copy(update={"speed": 0.0})
    spec = experiment(1, scale=SCALE, plant=DISTURBED).model_copy(update={"robots": (still,)})
    found = batch_items(group(batch([[1.0], [2.0]], spec)))["scaled"]
    assert math.isnan(found["mean"])
    assert found["ci95"] is None


def test_two_experiments_in_one_batch_are_refused_with_what_differs():
    trials = batch(ERRORS[:2].tolist())
    other = experiment(controller={"motion": "exact"}, plant={"dead_time": 0.15})
    trials[1] = replace(trials[1], experiment=other)
    with pytest.raises(UsageError) as caught:
        group(trials)
    assert "trial-000.mcap and trial-001.mcap have different experiments" in str(caught.value)
    assert "controller.motion: euler != exact" in str(caught.value)
    assert "plant.dead_time: 0.0 != 0.15" in str(caught.value)
    assert caught.value.hint
    assert "--against" in caught.value.hint


def test_a_trial_aborted_before_it_chose_its_robots_is_of_the_same_experiment():
    marks = (900, 900), (900, 1300), (1200, 700)
    chose = experiment(chosen=MarkedRobots(marks=marks, found=True))
    wanted = chose.model_copy(update={"chosen": MarkedRobots(marks=marks)})
    wanted = wanted.model_copy(update={"robots": wanted.robots[::-1]})
    trials = batch(ERRORS[:2].tolist(), chose)
    aborted = trial("aborted.mcap", wanted, result([1, 1, 1], outcome=Outcome.ABORTED), 2)
    assert group([*trials, aborted]).counted == 2


def test_other_seeds_and_counts_are_the_same_experiment():
    trials = batch(ERRORS[:2].tolist(), experiment(trials={"count": 2, "seed": 1}))
    more = batch(ERRORS[2:4].tolist(), experiment(trials={"count": 5, "seed": 2}))
    assert group(trials + [replace(trial, seed=2) for trial in more]).counted == 4


def test_a_trial_given_twice_is_refused():
    trials = batch(ERRORS[:2].tolist())
    with pytest.raises(UsageError, match="are the same trial"):
        group([*trials, replace(trials[0], log="copy.mcap")])


def test_a_trial_in_the_lab_can_be_done_again_but_not_given_twice():
    lab = [replace(one, origin=Origin.LAB, digest=one.log) for one in batch(ERRORS[:2].tolist())]
    again = replace(lab[0], log="again.mcap", digest="other")
    torn = replace(lab[0], log="torn.mcap", digest=None, recovered=True)
    assert group([*lab, again, torn, replace(torn, log="too.mcap")]).counted == 5
    with pytest.raises(UsageError, match="are the same trial"):
        group([*lab, replace(lab[1], log="copy.mcap")])


@pytest.mark.parametrize(
    ("plant", "origin", "compared"),
    [
        ({"type": "sim"}, Origin.UNDISTURBED, False),
        (DISTURBED, Origin.DISTURBED, True),
        ({"type": "sim"}, Origin.EMULATED, False),
        ({"type": "sim"}, Origin.LAB, True),
    ],
)
def test_only_real_robots_or_a_disturbed_plant_stand_beside_a_published_result(
    plant, origin, compared
):
    spec = experiment(reference=REFERENCE, scale=SCALE, plant=plant)
    found = group([replace(trial, origin=origin) for trial in batch(ERRORS.tolist(), spec)])
    assert found.origin is origin
    items = batch_items(found)
    assert items["reference"]["comparable"] == (items["scaled"] is not None) == compared


def test_a_lab_and_its_emulation_are_no_batch():
    trials = batch(ERRORS[:2].tolist())
    mixed = [replace(trials[0], origin=Origin.LAB), replace(trials[1], origin=Origin.EMULATED)]
    with pytest.raises(UsageError, match=r"from the lab, trial-001\.mcap from the emulated lab"):
        group(mixed)


@pytest.mark.parametrize(
    "name", ["trial-000.attempt-1.mcap", "trial-000.mcap.part.unfinished-1", "old/anything.mcap"]
)
def test_an_attempt_is_told_apart_whatever_it_is_called(name):
    trials = batch(ERRORS[:3].tolist())
    spec = trials[0].experiment
    stopped = result([9e5] * 3, outcome=Outcome.ABORTED, reason="the cable came off")
    found = group([*trials, trial(name, spec, stopped, 0)], [Damaged(f"{name}x", "torn")])
    assert (len(found.batch.trials), found.counted, batch_items(found)["aborted"]) == (3, 3, 0)
    assert [attempt.log for attempt in found.batch.attempts] == [name]
    last = flagged(found.batch)[-1]
    assert (last.log, last.outcome) == (name, "aborted")
    assert last.notes == ("an earlier attempt, excluded", "the cable came off")
    assert len(found.batch.lost) == 1
    assert not found.batch.whole


def test_an_attempt_that_cannot_be_read_is_counted_and_leaves_the_batch_whole():
    lost = Damaged("trial-000.attempt-1.mcap.part", "not an MCAP file")
    found = group(batch(ERRORS[:3].tolist()), [lost])
    assert (batch_items(found)["n_attempts"], found.batch.lost, found.batch.whole) == (1, (), True)
    assert flagged(found.batch)[0].notes[-1] == "not an MCAP file"


def test_no_trial_and_nothing_but_attempts_are_no_batch():
    attempt = replace(batch([[1.0]])[0], log="trial-000.attempt-1.mcap")
    for trials, why in (([], "no trial"), ([attempt], "all logs are earlier attempts")):
        with pytest.raises(UsageError, match=why):
            group(trials)


def test_flagged_trials_are_those_that_ended_oddly():
    trials = batch(ERRORS[:5].tolist())
    assert flagged(Batch.of(trials)) == []
    inside = Verdict(Poses.of(np.zeros((3, 3))), (True, False, True), (-1.0, 5.0, -2.0))
    trials[1] = replace(trials[1], result=result([1, 2, 3], verdict=inside))
    trials[2] = replace(trials[2], result=result([1, 2, 3], outcome=Outcome.STEPS_MAX))
    trials[3] = replace(trials[3], warnings=2)  # of the disturbances that the spec asks for
    found = flagged(Batch.of(trials))
    assert [(one.log, *one.notes) for one in found] == [
        ("trial-001.mcap", "green, red entered an obstacle"),
        ("trial-002.mcap", "did not end in 31 steps"),
    ]
    lab = [replace(one, origin=Origin.LAB, digest=one.log) for one in trials]
    assert ("2 warnings",) in [one.notes for one in flagged(Batch.of(lab))]
