"""Tests that `verify` accepts every kind of run bit for bit, and notices every change."""

import time
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from numba import njit
from testkit import mutate, random_trials
from testkit.made_labs import lab_log, lost
from testkit.mutate import of_host, rewrite, stating, with_entry
from testkit.trials import three_robots

from tetractl.core.clock import SECOND
from tetractl.core.plan import Outcome, Plan
from tetractl.core.poses import Poses
from tetractl.core.trial import Verdict
from tetractl.log import provenance
from tetractl.log.format.channels import COMMANDS, LOG, RESULT, STEP
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Damage
from tetractl.run.checked_controller import CheckedController
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.controller import ALONE
from tetractl.spec.load import parse_spec
from tetractl.tools.kernels.kernel_cache import computing_s
from tetractl.verification.recompute import recompute, steps_before_gap
from tetractl.verification.result_check import result_differences
from tetractl.verification.verify import Method, verify

pytestmark = pytest.mark.slow

SPEC = """
name: quick
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: one, start: [100, 500], target: [300, 450], a: 6, speed: 200}
  - {name: two, start: [100, 300], target: [300, 350], a: 3, speed: 150}
obstacles: [{type: circle, center: [250, 400], radius: 20}]
wheels: {radius: 40}
controller: {type: pso-mpc, horizon_max: 6, steps_max: 5, optimizer: {particles: 6, iterations: 14}}
plant: {type: sim, camera_rate: 30, measurement_noise: {position: 1}, heading_noise: 0.1}
trials: {count: 3, seed: 7}
"""

MPC = "controller={{type: mpc, period: 0.2, horizon_max: {}, optimizer: {}}}"
SETTINGS = {
    "the paper's": [],
    "multistart": ["controller.optimizer={type: multistart}"],
    "dead time, estimated": [
        MPC.format(6, "{type: pso, particles: 6, iterations: 14}"),
        "controller.dead_time=0.15",
        "plant.dead_time=0.15",
    ],
    "whole": [
        "plant.dead_time=0.15",
        "plant.lost_commands=0.1",
        MPC.format(20, "{type: multistart}"),
        "controller.accept_error=10",
        "controller.time_limit=8.2",
        "controller.collision.radius=10",
    ],
    "deadlines": [
        MPC.format(20, "{type: multistart, tolerance: 1.0e-9}"),
        "controller.deadline=0.001",
    ],
    "held": [
        MPC.format(6, "{type: pso, particles: 6, iterations: 14}"),
        "controller.signal_periods=2",
    ],
    "exact motion, with margins": [
        MPC.format(6, "{type: multistart}"),
        "controller.collision.margin=5",
        "controller.motion=exact",
    ],
    "arrives": ["controller.arrival_tolerance=60", "controller.time_limit=6.2"],
    "commands lost": ["plant.lost_commands=0.3"],
    "target stop": ["controller.optimizer.stop={type: target, cost: 40}"],
}


TRIAL = 1


def run(folder, sets, interrupt=None):
    """Run one trial of the spec with these settings; return the path of its log."""
    spec = parse_spec(SPEC, "quick.yaml", sets)
    run_logged(spec, folder, TRIAL, interrupt=interrupt)
    return log_path(folder, TRIAL)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return run(tmp_path_factory.mktemp("log"), [])


@pytest.fixture(scope="module")
def contents(log):
    return scan(log)


def test_only_numbers_that_the_log_has_are_compared(log, monkeypatch):
    """So that logs of versions whose controllers said fewer are verified by later ones."""
    trial = read_trial(log)
    first = trial.steps[0]
    saying = replace(first.plan, numbers={"margin_mm": 2.0})
    changed = replace(trial, steps=(replace(first, plan=saying), *trial.steps[1:]))
    assert str(recompute(changed, True).difference) == (
        "step 0: numbers.margin_mm: the log has a value here, but none was computed"
    )
    decide = CheckedController.plan

    def say(controller, *given):
        decision = decide(controller, *given)
        if isinstance(decision, Plan):
            return replace(decision, numbers={"margin_mm": 1.0})
        return decision

    monkeypatch.setattr(CheckedController, "plan", say)
    assert recompute(trial, True).difference is None
    assert str(recompute(changed, True).difference) == (
        "step 0: numbers.margin_mm: logged 2.0, computed 1.0"
    )


@pytest.mark.parametrize("sets", SETTINGS.values(), ids=SETTINGS.keys())
def test_every_decision_comes_out_with_the_same_bits(tmp_path, sets):
    path = run(tmp_path, sets)
    verification = verify(path)
    assert verification.problems == ()
    assert verification.method is Method.RECOMPUTED
    assert verification.elsewhere == ()
    assert verification.checked == verification.steps > 0
    has_deadline = "controller.deadline=0.001" in sets
    note = "the trial was not run again, because a deadline ended one of its searches"
    assert verification.notes == (note,) * has_deadline
    for search_again in (True, False):
        assert recompute(read_trial(path), search_again).difference is None


class LateClock:
    """Stands for the clock that searches look at: past every deadline after so many looks."""

    wrap = staticmethod(ALONE.wrap)

    def __init__(self, looks):
        self.looks = looks
        self.time = 0

    def __call__(self):
        self.time += SECOND // self.looks
        return self.time


@pytest.mark.long
@pytest.mark.parametrize(
    "swarm",
    ["{type: pso, iterations: 60, stop: {type: budget}}", "{type: multistart, tolerance: 1.0e-9}"],
)
@pytest.mark.parametrize(
    "looks", [*(pytest.param(looks, marks=pytest.mark.release) for looks in (1, 2)), 4, 9, 20]
)
def test_what_a_deadline_cut_short_comes_out_too(tmp_path, monkeypatch, swarm, looks):
    monkeypatch.setattr("tetractl.run.checked_controller.WorkClock", lambda: LateClock(looks))
    sets = [MPC.format(12, swarm), "controller.deadline=0.5", "controller.estimate=false"]
    path = run(tmp_path, sets)
    steps = read_trial(path).steps
    searches = [search for step in steps for search in step.plan.searches]
    cut_short = any(search.stopped == "deadline" for search in searches)
    searches_left_out = len(steps[1].plan.searches) < 3
    assert cut_short or searches_left_out or looks > 4
    assert verify(path).problems == ()


@pytest.fixture
def no_time(monkeypatch):
    """Let no decision be computed in time, and no simulation run again."""
    monkeypatch.setattr("tetractl.verification.recompute.seconds_limit", lambda: 1e-9)
    monkeypatch.setattr("tetractl.verification.run_again.limits.seconds_limit", lambda: 1e-9)


@pytest.mark.parametrize("simulated_again", [True, False])
def test_a_log_that_takes_too_long_is_not_checked_to_the_end(
    log, monkeypatch, no_time, simulated_again
):
    """A third verdict: the log may be right."""
    if not simulated_again:
        monkeypatch.setattr(
            "tetractl.verification.run_again.why_not_again", lambda *_: "another host wrote it"
        )
    verification = verify(log)
    assert verification.problems == ()
    assert not verification.ok
    assert verification.verdict == "not checked to the end"
    first, why, *_ = verification.lines
    assert first.startswith(f"{log}: not checked to the end: ")
    assert "TETRACTL_LOG_FACTOR=2, twice as much is allowed" in why


def test_a_contradiction_is_a_failure_even_if_the_check_does_not_reach_the_end(
    tmp_path, log, no_time
):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(log.read_bytes()[:-6000])
    verification = verify(torn)
    assert verification.unchecked
    assert verification.verdict == "FAILED"


def test_compiling_does_not_count_against_the_limits():
    """Regression: "FAILED: 1 of 145 decisions" of a right log, as kernels were compiled."""
    before_s = computing_s()
    thread_s = time.thread_time()
    njit(lambda x: x @ x.T + np.linalg.inv(x))(np.eye(3))  # kept in no cache
    compiling_s = time.thread_time() - thread_s
    assert compiling_s > 0
    assert computing_s() - before_s < compiling_s / 2


def test_a_torn_log_is_checked_up_to_the_tear(tmp_path, log):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(log.read_bytes()[:-6000])
    verification = verify(torn)
    assert 0 < verification.checked == verification.steps
    assert {problem.field for problem in verification.problems} == {"damage"}


def index_of_step(contents, k):
    """Which message of the log is that of control step k."""
    steps = [i for i, entry in enumerate(contents.entries) if entry.topic == STEP]
    return steps[k]


def test_the_first_step_and_field_that_differ_are_named(tmp_path, contents):
    place = ("searches", 1, "history", 3)
    step_2 = index_of_step(contents, 2)
    verification = verify(with_entry(contents, tmp_path / "changed.mcap", step_2, place))
    assert verification.checked == 2
    first = verification.problems[0]
    assert first.step == 2
    assert first.field == "searches.1.history.3"


def on_another_machine(contents):
    """The message of the host of another kind of processor, to be given to `rewrite`."""
    return of_host(contents, machine="another")


def test_on_another_machine_equal_bits_still_count(tmp_path, contents):
    elsewhere = rewrite(contents, tmp_path / "elsewhere.mcap", on_another_machine(contents))
    verification = verify(elsewhere)
    assert verification.method is Method.RECOMPUTED
    assert verification.problems == ()
    here = provenance.machine()
    assert verification.elsewhere == (
        f"machine: another on the computer that wrote the log, {here} on this one",
    )


@pytest.mark.parametrize(
    ("place", "change"),
    [
        (("searches", 1, "signals", 0), 1e-8),
        (("searches", 0, "cost"), 1e-8),
        (("path_x", 3), 1e-3),
        (("cost",), 1e-8),
    ],
)
def test_on_another_machine_the_costs_have_to_agree(tmp_path, contents, monkeypatch, place, change):
    """A cost that does not fit its plan is no matter of arithmetic."""
    monkeypatch.setattr(mutate, "CHANGE", change)
    step_1 = index_of_step(contents, 1)
    changed = scan(with_entry(contents, tmp_path / "changed.mcap", step_1, place))
    path = rewrite(changed, tmp_path / "elsewhere.mcap", on_another_machine(changed))
    verification = verify(path)
    assert verification.method is Method.REEVALUATED
    assert verification.problems[0].step == 1


@pytest.mark.parametrize("topic", [STEP, COMMANDS])
@pytest.mark.parametrize("k", [0, -1])
def test_on_another_machine_every_command_has_to_be_the_one_of_its_plan(
    tmp_path, contents, topic, k
):
    """The last one, too, on which no later decision depends."""
    steps = contents.entries_by_topic[STEP]
    entry = steps[k] if topic == STEP else contents.entries_by_topic[COMMANDS][: len(steps)][k]
    place = ("command", "direction") if topic == STEP else ("direction",)
    index = contents.entries.index(entry)
    changed = scan(with_entry(contents, tmp_path / "changed.mcap", index, place))
    verification = verify(rewrite(changed, tmp_path / "other.mcap", on_another_machine(changed)))
    assert k % len(steps) in {problem.step for problem in verification.problems}


@pytest.mark.parametrize("outcome", ["aborted", "interrupted"])
def test_an_outcome_is_not_changed_with_all_that_says_it(tmp_path, contents, outcome):
    """Regression: a bad trial could be taken out of the means so."""

    last_entry = contents.entries_by_topic[LOG][-1]
    last_note = Log.FromString(last_entry.data)
    last_note.message = last_note.message.replace("steps max", f"{outcome} (why)")
    replaced = {last_entry: last_entry._replace(data=last_note.SerializeToString())}
    replaced |= stating(contents, RESULT, outcome=outcome, reason="why")
    verification = verify(rewrite(contents, tmp_path / "changed.mcap", replaced))
    first = verification.problems[0]
    assert first.field == "outcome"
    assert "the controller decides 'steps max'" in first.message


def test_on_another_machine_the_errors_have_to_follow_from_the_poses(tmp_path, contents):
    replaced = on_another_machine(contents) | stating(contents, RESULT, total_error=1.0)
    verification = verify(rewrite(contents, tmp_path / "changed.mcap", replaced))
    assert [problem.field for problem in verification.problems] == ["result.total_error"]
    note = (
        "the trial was not run again, because it was written on another computer, or by other code"
    )
    assert verification.notes == (note,)


def fields_that_differ(log, result):
    return {difference.field for difference in result_differences(log, result)}


def test_a_wall_that_a_path_logged_in_the_lab_crosses_was_entered(tmp_path):
    lab_trial = random_trials.trial(simulated=False)
    clear = replace(lab_trial.result.verdict, entered=(False,) * 3, clearance=(0.0,) * 3)
    log = random_trials.write_and_read(lab_trial, tmp_path / "trial.mcap")
    fields = fields_that_differ(log, replace(log.result, verdict=clear))
    assert any(field.startswith("result.entered") for field in fields)


@pytest.fixture
def log_of_robots_at_rest(tmp_path):
    return lab_log(tmp_path, lost(0, 100), 0.0, "yes", 0.001)


@pytest.mark.parametrize(
    ("outcome", "are_stated", "agree"),
    [
        (Outcome.ABORTED, False, True),
        (Outcome.ARRIVED, False, False),
        (Outcome.ABORTED, True, False),
    ],
)
def test_only_a_trial_that_an_error_ended_may_state_no_final_poses(
    log_of_robots_at_rest, outcome, are_stated, agree
):
    """Those that it states are compared. Regression: an error while the robots came to rest left a
    log that `verify` called false."""
    log = log_of_robots_at_rest
    verdict = Verdict.unknown(3)
    if are_stated:
        verdict = replace(verdict, final=Poses.from_array(log.mocap[-1] + 1))
    result = replace(log.result, outcome=outcome, verdict=verdict)
    assert ("result.final" not in fields_that_differ(log, result)) == agree


@pytest.mark.parametrize(
    ("halts", "row", "agrees"),
    [("yes", -1, True), ("yes", 0, False), ("yes", -2, False), ("no", -20, True)],
)
def test_final_poses_are_the_last_ones_unless_robots_swim_on(tmp_path, halts, row, agrees):
    log = lab_log(tmp_path, lost(0, 100), 40.0, halts, 0.001)
    verdict = replace(log.result.verdict, final=Poses.from_array(log.mocap[row]))
    fields = fields_that_differ(log, replace(log.result, verdict=verdict))
    assert ("result.final" not in fields) == agrees


def test_frames_that_the_camera_lost_end_no_check_of_a_log_without_its_end():
    log = three_robots()
    numbers = np.where(np.arange(len(log.frames)) > 30, log.frames + 1, log.frames)
    cut = replace(log, frames=numbers, result=None, damage=Damage((), ("the result",)))
    assert steps_before_gap(cut) == list(cut.steps)


def test_what_viewers_cannot_decode_is_noticed(tmp_path, contents):
    """Regression, found by benchmarks/fuzz.py: reading a trial does not decode it."""
    entry = contents.entries_by_topic["/tf"][0]
    torn = {entry: entry._replace(data=entry.data[:-3])}
    (problem,) = verify(rewrite(contents, tmp_path / "changed.mcap", torn)).problems
    assert str(problem) == "trial: /tf[0]: is not a valid message of its channel"


def test_no_step_after_a_gap_is_a_first_step():
    """Regression: one whose number was that of its place was, where a number was repeated."""
    log = three_robots()
    first, second, third, *_ = log.steps
    with_gap = replace(log, steps=(first, third, replace(second, k=2)))
    assert steps_before_gap(with_gap) == [first]
