"""Tests of repeating the decisions of a log: what the logged searches must obey, and the end."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from testkit.hand_clock import HandTimer
from testkit.trials import DISTURBED, FRAMES, THREE_M3PI, cut_short, in_lab

from tetractl.core.loggable import DRAWING_PRECISION
from tetractl.core.plan import Limits, Outcome, StopReason
from tetractl.core.trial import Note
from tetractl.log.read.limits import seconds_limit
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import Damage
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.load import parse_contents
from tetractl.verification.recompute import (
    NoSearchError,
    StepSearches,
    TooLongError,
    plan_again,
    recompute,
    steps_before_gap,
)

pytestmark = pytest.mark.slow

STEPS = 3


def small_log():
    """A trial of a few steps, whose controller ends it after the largest number of steps."""
    controller = THREE_M3PI["controller"] | {"steps_max": 5, "horizon_max": 8}
    spec = parse_contents(THREE_M3PI | DISTURBED | {"controller": controller}, "small.yaml", ())
    with TemporaryDirectory() as folder:
        run_logged(spec, Path(folder))
        return read_trial(log_path(Path(folder), 0))


WHOLE = small_log()


def requests_of(log, step_number):
    """The searches that the controller asks for in one of the first steps, by their index."""
    searches = StepSearches(False)
    key, _ = trial_seeds(log.start.seed, log.start.trial)
    controller = searches.controller(log, key)
    last = None
    for step in log.steps[: step_number + 1]:
        searches.start_step(step.plan.searches)
        plan_again(controller, log, last, step.observation)
        last = step
    return searches.requests


@pytest.fixture(scope="module")
def request_and_search():
    """A search of step 1, which starts from the sequence of step 0, and its request."""
    requests = requests_of(WHOLE, 1)
    index = 1
    return requests[index], WHOLE.steps[1].plan.searches[index]


def contradicted(request, search):
    """The field that contradicts the request if the log has this search; None if none does."""
    searches = StepSearches(False)
    searches.start_step([search])
    searches.search(request)
    return None if searches.contradiction is None else searches.contradiction.field


# ---- What a logged search must obey ----


def test_a_search_as_it_was_contradicts_nothing(request_and_search):
    request, search = request_and_search
    assert contradicted(request, search) is None


def test_every_request_of_a_step_is_kept_with_the_index_of_its_search():
    searches = WHOLE.steps[1].plan.searches
    requests = requests_of(WHOLE, 1)
    assert {i: request.length for i, request in requests.items()} == {
        i: search.length for i, search in enumerate(searches)
    }


def test_signals_have_to_have_the_stated_cost(request_and_search):
    request, search = request_and_search
    moved = search.signals + np.eye(len(search.signals))[0] * 1e-4
    assert contradicted(request, replace(search, signals=moved)) == "searches.0.cost"


@pytest.mark.parametrize(("share", "field"), [(1e-13, None), (1e-6, "searches.0.cost")])
def test_a_cost_may_be_rounded_otherwise_but_not_be_another(request_and_search, share, field):
    request, search = request_and_search
    for sign in (-1, 1):
        cost = search.cost * (1 + sign * share)
        history = search.history.copy()
        history[history == search.cost] = cost
        if (np.diff(history) > 0).any():
            continue
        assert contradicted(request, replace(search, cost=cost, history=history)) == field


def test_a_history_falls_to_the_cost_and_never_rises(request_and_search):
    request, search = request_and_search
    history = search.history
    risen = history.copy()
    risen[3] = risen[2] + 1
    ends_above = np.append(history[:-1], history[-1] + 1e-3)
    for wrong in (risen, ends_above, history[:0]):
        assert contradicted(request, replace(search, history=wrong)) == "searches.0.history"


@pytest.mark.parametrize("change", [-1, 1])
def test_the_number_of_evaluations_follows_from_the_history(request_and_search, change):
    request, search = request_and_search
    swarm = request.optimizer
    assert search.evaluations == swarm.particles * len(search.history) + 1  # and a warm start
    wrong = replace(search, evaluations=search.evaluations + change)
    assert contradicted(request, wrong) == "searches.0.evaluations"


def test_without_a_warm_start_a_search_evaluates_one_sequence_less(request_and_search):
    request, search = request_and_search
    cold = replace(request, warm=None)
    assert contradicted(cold, search) == "searches.0.evaluations"
    one_less = replace(search, evaluations=search.evaluations - 1)
    assert contradicted(cold, one_less) is None


def test_only_one_reason_fits_a_search_that_its_criterion_ended(request_and_search):
    request, search = request_and_search
    assert search.stopped == StopReason.CRITERION
    for reason in set(StopReason) - {StopReason.CRITERION, StopReason.FIXED}:
        assert contradicted(request, replace(search, stopped=reason)) == "searches.0.stopped"


def of_iterations(search, swarm, count):
    """The search cut after so many iterations, in which no criterion ends it."""
    last = search.cost
    history = np.append(last * np.geomspace(1e6, 10, count), last)
    evaluations = swarm.particles * len(history) + 1
    return replace(search, history=history, evaluations=evaluations)


LIMITED = {
    "nothing": (Limits(), set()),
    "evaluations": (Limits(evaluations=10**6), {StopReason.EVALUATIONS}),
    "a deadline": (Limits(expired=lambda spent: False), {StopReason.DEADLINE}),
    "both": (
        Limits(10**6, lambda spent: False),
        {StopReason.EVALUATIONS, StopReason.DEADLINE},
    ),
}


@pytest.mark.parametrize(("limits", "reasons"), LIMITED.values(), ids=LIMITED.keys())
def test_a_search_is_cut_short_only_by_a_limit_that_it_has(request_and_search, limits, reasons):
    request, search = request_and_search
    swarm = request.optimizer
    for count, possible in ((5, reasons), (swarm.iterations, {StopReason.ITERATIONS})):
        cut = of_iterations(search, swarm, count)
        limited = replace(request, limits=limits)
        agreeing = {
            reason
            for reason in set(StopReason) - {StopReason.FIXED}
            if contradicted(limited, replace(cut, stopped=reason)) is None
        }
        assert agreeing == possible


def test_a_search_of_another_length_is_no_answer(request_and_search):
    request, search = request_and_search
    searches = StepSearches(False)
    searches.start_step([search])
    with pytest.raises(NoSearchError):
        searches.search(replace(request, length=request.length + 1))
    assert searches.contradiction.field == "searches.0.length"


def test_the_first_contradiction_of_a_step_is_kept_until_the_next_step(request_and_search):
    request, search = request_and_search
    wrong = replace(search, evaluations=3)
    searches = StepSearches(False)
    searches.start_step([search, wrong, replace(search, cost=1.0)])
    for _ in range(3):
        searches.search(request)
    assert searches.contradiction.field == "searches.1.evaluations"
    searches.start_step([search])
    assert searches.contradiction is None
    assert searches.requests == {}


def test_there_are_no_more_searches_than_the_log_has_and_given_signals_are_none(
    request_and_search,
):
    request, search = request_and_search
    searches = StepSearches(False)
    searches.start_step([replace(search, stopped=StopReason.FIXED), search])
    assert searches.search(request) is search
    assert set(searches.requests) == {1}
    with pytest.raises(NoSearchError):
        searches.search(request)


# ---- The limit of time ----


def test_the_limit_counts_from_the_start_and_is_not_yet_over_when_it_is_reached():
    cpu = HandTimer(100.0)
    searches = StepSearches(False, cpu)
    cpu.now_s += seconds_limit()
    assert not searches.is_expired()
    searches.require_time()
    cpu.now_s += 1e-3
    assert searches.is_expired()
    with pytest.raises(TooLongError):
        searches.require_time()


def test_compiling_before_the_first_repeated_search_takes_none_of_the_time(request_and_search):
    request, search = request_and_search
    cpu = HandTimer(100.0)
    searches = StepSearches(True, cpu)
    cpu.now_s += 10 * seconds_limit()
    assert not searches.is_expired()
    searches.start_step([search, search])
    again = searches.search(request)
    assert again.cost == search.cost
    assert again.signals.tolist() == search.signals.tolist()
    cpu.now_s += seconds_limit() + 1e-3
    with pytest.raises(TooLongError):
        searches.search(request)


def test_a_search_that_a_deadline_ended_is_repeated_to_its_logged_evaluations(request_and_search):
    request, search = request_and_search
    spent = request.optimizer.particles * 7 + 1
    searches = StepSearches(True)
    searches.start_step([replace(search, stopped=StopReason.DEADLINE, evaluations=spent), search])
    cut = searches.search(request)
    assert (cut.evaluations, cut.stopped) == (spent, StopReason.DEADLINE)
    assert searches.search(request).evaluations == search.evaluations  # and others to their end


# ---- The steps that can be repeated ----


def test_a_whole_log_agrees_in_each_step():
    for search_again in (True, False):
        repeated = recompute(WHOLE, search_again)
        assert (repeated.agreeing_steps, repeated.difference) == (len(WHOLE.steps), None)


def with_plan(k, **fields):
    """The log in which some fields of the plan of a step are others."""
    steps = list(WHOLE.steps)
    steps[k] = replace(steps[k], plan=replace(steps[k].plan, **fields))
    return replace(WHOLE, steps=tuple(steps))


def differs_in(log, search_again):
    """The step and the field of the first difference; None if there is none."""
    difference = recompute(log, search_again).difference
    return None if difference is None else (difference.step, difference.field)


def test_only_repeated_searches_have_to_give_the_same_bits():
    plan = WHOLE.steps[2].plan
    rounded = with_plan(2, target_cost=np.nextafter(plan.target_cost, 0))
    assert differs_in(rounded, True) == (2, "target_cost")
    assert differs_in(rounded, False) is None
    for search_again in (True, False):
        wrong = with_plan(2, target_cost=plan.target_cost * (1 + 1e-7))
        assert differs_in(wrong, search_again) == (2, "target_cost")


def test_a_path_may_be_rounded_in_the_other_direction_unless_bits_are_compared():
    path = WHOLE.steps[1].plan.path.copy()
    path[3, 2, 1] *= 1 + 1.5 * DRAWING_PRECISION
    rounded = with_plan(1, path=path)
    assert differs_in(rounded, True) == (1, "path.3.2.1")
    assert differs_in(rounded, False) is None
    path[3, 2, 1] *= 1 + 1.5 * DRAWING_PRECISION
    for search_again in (True, False):
        assert differs_in(with_plan(1, path=path), search_again) == (1, "path.3.2.1")


def test_a_random_key_that_seed_and_trial_do_not_give_is_the_difference():
    for search_again in (True, False):
        wrong = with_plan(1, generator=WHOLE.steps[1].plan.generator + 1)
        assert differs_in(wrong, search_again) == (1, "generator")


def test_a_missing_search_and_one_of_another_length_are_told_apart():
    searches = WHOLE.steps[1].plan.searches
    assert differs_in(with_plan(1, searches=searches[:-1]), False) == (1, "searches")
    *before, last = searches
    longer = replace(last, length=last.length + 1)
    wrong = with_plan(1, searches=(*before, longer))
    assert differs_in(wrong, False) == (1, f"searches.{len(before)}.length")


def test_steps_after_a_missing_one_are_left_out():
    steps = WHOLE.steps
    lacking = replace(WHOLE, steps=(*steps[:2], *steps[3:]))
    assert steps_before_gap(lacking) == list(steps[:2])
    assert recompute(lacking, False).agreeing_steps == 2
    assert steps_before_gap(replace(WHOLE, steps=steps[1:])) == []


@pytest.mark.parametrize(
    ("lost", "has_result", "counts"),
    [
        (("frames",), True, False),
        (("frames", "the result"), False, False),
        (("the result",), False, True),  # what is lost is the end alone
        ((), True, True),
    ],
)
def test_steps_after_a_lost_frame_count_only_if_frames_are_not_what_was_lost(
    lost, has_result, counts
):
    missing = 2 * FRAMES + 5
    kept = np.arange(len(WHOLE.frames)) != missing
    log = replace(
        WHOLE,
        frames=WHOLE.frames[kept],
        mocap_ns=WHOLE.mocap_ns[kept],
        result=WHOLE.result if has_result else None,
        damage=Damage(("torn",), lost),
    )
    assert len(steps_before_gap(log)) == (len(WHOLE.steps) if counts else 3)


def test_a_step_whose_own_frame_is_lost_is_left_out():
    kept = np.arange(len(WHOLE.frames)) != 2 * FRAMES
    log = replace(
        WHOLE,
        frames=WHOLE.frames[kept],
        mocap_ns=WHOLE.mocap_ns[kept],
        damage=Damage(("torn",), ("frames",)),
    )
    assert len(steps_before_gap(log)) == 2


def test_a_log_that_was_cut_short_has_no_end_to_check():
    cut = cut_short(WHOLE, STEPS)
    repeated = recompute(cut, False)
    assert (repeated.agreeing_steps, repeated.difference) == (STEPS, None)


# ---- The end ----


def ended(log=WHOLE, **fields):
    """The difference of the outcome if the result of the log states these fields."""
    return recompute(replace(log, result=replace(log.result, **fields)), False).difference


@pytest.mark.parametrize("outcome", [one for one in Outcome if one != WHOLE.result.outcome])
def test_no_other_outcome_fits_the_last_frame_of_a_simulation(outcome):
    difference = ended(outcome=outcome, reason="why")
    assert difference.field == "outcome"
    assert f"logged {outcome.value!r}, but the controller decides " in difference.message


@pytest.mark.parametrize("outcome", [Outcome.ABORTED, Outcome.INTERRUPTED])
def test_a_lab_may_abort_or_be_interrupted_when_its_controller_would_end(outcome):
    assert ended(in_lab(WHOLE), outcome=outcome) is None


def test_an_abort_in_a_simulation_needs_the_error_that_it_names():
    def aborted(level, text):
        noted = replace(WHOLE, notes=(Note(0, level, text),))
        return ended(noted, outcome=Outcome.ABORTED, reason="the plant failed")

    assert aborted("error", "the plant failed") is None
    assert aborted("error", "something else") is not None
    assert aborted("warning", "the plant failed") is not None


def test_a_trial_that_the_controller_would_go_on_with_was_not_ended_by_it():
    steps = WHOLE.steps[:STEPS]
    stop = replace(WHOLE.stop, sent_ns=WHOLE.steps[STEPS].command.sent_ns)
    early = replace(WHOLE, steps=steps, stop=stop)
    for outcome in (Outcome.ARRIVED, WHOLE.result.outcome):
        assert "the controller goes on" in ended(early, outcome=outcome).message
    for outcome in (Outcome.ABORTED, Outcome.INTERRUPTED):
        assert ended(early, outcome=outcome) is None


def arriving(row):
    """The log with all robots at their targets in one frame after the last step, which ends it.

    The frame is `row` frames after the step's own.
    """
    first = len(WHOLE.steps[:STEPS]) * FRAMES - FRAMES
    mocap = WHOLE.mocap.copy()
    mocap[first + row, :, :2] = WHOLE.start.setup.targets
    stop = replace(WHOLE.stop, sent_ns=WHOLE.steps[STEPS].command.sent_ns)
    return replace(WHOLE, steps=WHOLE.steps[:STEPS], stop=stop, mocap=mocap)


@pytest.mark.parametrize(("row", "ends"), [(FRAMES - 1, False), (FRAMES, True)])
def test_a_simulation_ends_on_the_newest_frame_one_period_after_its_last_command(row, ends):
    difference = ended(arriving(row), outcome=Outcome.ARRIVED)
    assert (difference is None) == ends


@pytest.mark.parametrize(
    ("row", "ends"), [(1, True), (FRAMES - 1, True), (FRAMES, True), (FRAMES + 1, False)]
)
def test_a_lab_may_end_on_any_frame_between_its_last_step_and_its_stop(row, ends):
    difference = ended(in_lab(arriving(row)), outcome=Outcome.ARRIVED)
    assert (difference is None) == ends


def test_a_seed_that_no_trial_has_is_the_difference():
    log = replace(WHOLE, start=replace(WHOLE.start, trial=-1))
    assert recompute(log, False).difference.field == "seed"


def test_a_log_without_stop_or_result_has_no_outcome_to_check():
    for log in (replace(WHOLE, stop=None), replace(WHOLE, result=None)):
        assert recompute(log, False).difference is None
