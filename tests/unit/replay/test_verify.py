"""`verify`: every kind of run comes out with the same bits, and no change goes unnoticed."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from numpy._core._multiarray_umath import __cpu_dispatch__
from support import mutate, random_trials
from support.made_labs import lab_log, lost
from support.mutate import of_host, rewrite, stating, with_entry
from support.paths import ROOT
from support.trials import three_robots

from tetractl.core.commands import Verdict
from tetractl.core.errors import LogError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.experiment.controller import ALONE
from tetractl.experiment.load import parse_spec
from tetractl.log import provenance
from tetractl.log.format.channels import LOG, RESULT, STEP
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Damage
from tetractl.replay.lab_result import lab_differences
from tetractl.replay.recompute import first_steps, recompute
from tetractl.replay.verify import Method, verify
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import log_path, run_trial

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
    "arcs, with margins": [
        MPC.format(6, "{type: multistart}"),
        "controller.collision.margin=5",
        "controller.motion=arc",
    ],
    "arrives": ["controller.arrival_tolerance=60", "controller.time_limit=6.2"],
    "a square first": ["controller.first_plan={type: square, side: 1.5}"],
    "commands lost": ["plant.lost_commands=0.3"],
    "target stop": ["controller.optimizer.stop={type: target, cost: 40}"],
}


def run(folder, sets, trial=1, interrupt=None):
    spec = parse_spec(SPEC, "quick.yaml", sets)
    run_trial(spec, folder, trial, interrupt=interrupt)
    return log_path(folder, trial)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return run(tmp_path_factory.mktemp("log"), [])


@pytest.fixture(scope="module")
def contents(log):
    return scan(log)


@pytest.mark.parametrize("sets", SETTINGS.values(), ids=SETTINGS.keys())
def test_every_decision_comes_out_with_the_same_bits(tmp_path, sets):
    found = verify(run(tmp_path, sets))
    assert found.problems == ()
    assert (found.method, found.elsewhere) == (Method.RECOMPUTED, ())
    ended = "controller.deadline=0.001" in sets
    assert found.notes == ("the trial is not run again: a deadline ended a search",) * ended
    assert found.checked == found.steps > 0
    log = read_trial(tmp_path / "trial-001.mcap")
    assert recompute(log, search_again=False).difference is None


class Late:
    """A clock that is past every deadline after so many looks at it."""

    wrap = staticmethod(ALONE.wrap)

    def __init__(self, looks):
        self.looks, self.time = looks, 0

    def __call__(self):
        self.time += 10**9 // self.looks
        return self.time


@pytest.mark.long
@pytest.mark.parametrize(
    "swarm",
    ["{type: pso, iterations: 60, stop: {type: budget}}", "{type: multistart, tolerance: 1.0e-9}"],
)
@pytest.mark.parametrize("looks", [1, 2, 4, 9, 20])
def test_what_a_deadline_cut_short_comes_out_too(tmp_path, monkeypatch, swarm, looks):
    monkeypatch.setattr("tetractl.run.checked_controller.WorkClock", lambda: Late(looks))
    sets = [MPC.format(12, swarm), "controller.deadline=0.5", "controller.estimate=false"]
    path = run(tmp_path, sets)
    stopped = [s.stopped for step in read_trial(path).steps for s in step.plan.searches]
    assert "deadline" in stopped or looks > 4 or len(read_trial(path).steps[1].plan.searches) < 3
    assert verify(path).problems == ()


def test_an_interrupted_trial_comes_out_as_far_as_it_went(tmp_path):
    interrupt = Interrupt()
    interrupt.request()
    path = run(tmp_path, [], interrupt=interrupt)
    found = verify(path)
    assert read_trial(path).start.trial == 1
    assert (found.problems, found.checked) == ((), 1)


def test_a_torn_log_is_checked_up_to_the_tear(tmp_path, log):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(log.read_bytes()[:-6000])
    found = verify(torn)
    assert 0 < found.checked == found.steps
    assert {problem.field for problem in found.problems} == {"damage"}


def noticed(path):
    try:
        return not verify(path).ok
    except LogError:  # it does not even fit together
        return True


def test_the_first_step_and_field_that_differ_are_named(tmp_path, contents):
    steps = [i for i, entry in enumerate(contents.entries) if entry.topic == STEP]
    place = ("searches", 1, "history", 3)
    found = verify(with_entry(contents, tmp_path / "changed.mcap", steps[2], place))
    assert found.checked == 2
    assert (found.problems[0].step, found.problems[0].field) == (2, "searches.1.history.3")


def elsewhere(contents):
    return of_host(contents, cpu="another")


def test_on_another_processor_equal_bits_still_count(tmp_path, contents):
    found = verify(rewrite(contents, tmp_path / "other.mcap", elsewhere(contents)))
    assert (found.method, found.problems) == (Method.RECOMPUTED, ())
    assert found.elsewhere == (
        f"cpu: another on the log's host, {provenance.host()['cpu']} on this one",
    )


def test_on_another_processor_the_costs_have_to_agree(tmp_path, contents, monkeypatch):
    """A last bit that differs is arithmetic there; a cost that does not fit its plan is not."""
    steps = [i for i, entry in enumerate(contents.entries) if entry.topic == STEP]
    place = ("searches", 1, "history", 0)  # of no consequence to any cost
    changed = scan(with_entry(contents, tmp_path / "changed.mcap", steps[1], place))
    assert verify(tmp_path / "changed.mcap").problems
    found = verify(rewrite(changed, tmp_path / "there.mcap", elsewhere(changed)))
    assert (found.method, found.problems) == (Method.REEVALUATED, ())
    for place, change in (
        (("searches", 1, "signals", 0), 1e-8),
        (("searches", 0, "cost"), 1e-8),
        (("path_x", 3), 1e-3),
        (("cost",), 1e-8),
    ):
        monkeypatch.setattr(mutate, "CHANGE", change)
        name = tmp_path / f"{'-'.join(map(str, place))}.mcap"
        changed = scan(with_entry(contents, name, steps[1], place))
        found = verify(rewrite(changed, name.with_suffix(".there.mcap"), elsewhere(changed)))
        assert found.method == Method.REEVALUATED
        assert found.problems[0].step == 1


@pytest.mark.parametrize("outcome", ["aborted", "interrupted"])
def test_an_outcome_is_not_changed_with_all_that_says_it(tmp_path, contents, outcome):
    """Regression: a bad trial could be taken out of the means so."""

    last = [entry for entry in contents.entries if entry.topic == LOG][-1]
    note = Log.FromString(last.data)
    note.message = note.message.replace("steps max", f"{outcome} (why)")
    said = {last: last._replace(data=note.SerializeToString())}
    said |= stating(contents, RESULT, outcome=outcome, reason="why")
    found = verify(rewrite(contents, tmp_path / "changed.mcap", said))
    assert found.problems[0].field == "outcome"
    assert "the controller decides 'steps max'" in found.problems[0].message


DIFFERENT = """
import sys
from pathlib import Path
from tetractl.experiment.load import parse_spec
from tetractl.run.spec_trial import run_trial

run_trial(parse_spec(sys.argv[1], "quick.yaml"), Path(sys.argv[2]), 1)
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__)}, "numpy_dispatch"),
        pytest.param(
            {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
            "numba_settings",
            marks=pytest.mark.system,  # compiles everything again
        ),
    ],
)
def test_a_log_of_other_instruction_sets_is_honest(tmp_path, settings, key):
    """Regression: under one name of a processor it was said to be wrong."""
    subprocess.run(
        [sys.executable, "-c", DIFFERENT, SPEC, str(tmp_path)],
        env=os.environ | settings | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"},
        check=True,
    )
    found = verify(log_path(tmp_path, 1))
    assert found.problems == ()
    assert [line.split(":")[0] for line in found.elsewhere] == [key]


def test_the_time_that_verifying_takes_is_bounded(log):
    ticks = iter(range(0, 100_000, 4))
    found = recompute(read_trial(log), search_again=True, cpu=lambda: next(ticks))
    assert found.difference is not None
    assert "not computed again: the rest takes over 15 s" in found.difference.message


def test_on_another_processor_a_history_has_to_fall(tmp_path, contents):
    entry = next(e for e in contents.entries if e.topic == STEP)
    step = ControllerStep.FromString(entry.data)
    step.searches[0].history[0] = step.searches[0].cost - 1.0
    changed = {entry: entry._replace(data=step.SerializeToString())} | elsewhere(contents)
    found = verify(rewrite(contents, tmp_path / "changed.mcap", changed))
    assert found.problems[0].field == "searches.0.history"


def test_on_another_processor_the_errors_have_to_follow_from_the_poses(tmp_path, contents):
    changed = elsewhere(contents) | stating(contents, RESULT, total_error=1.0)
    found = verify(rewrite(contents, tmp_path / "changed.mcap", changed))
    assert [one.field for one in found.problems] == ["result.total_error"]
    assert found.notes == ("the trial is not run again: another host, or other code, wrote it",)


def test_what_viewers_cannot_decode_is_noticed(tmp_path, contents):
    """Regression, found by benchmarks/fuzz.py: reading a trial does not decode it."""
    entry = next(e for e in contents.entries if e.topic == "/tf")
    spoilt = {entry: entry._replace(data=entry.data[:-3])}
    found = verify(rewrite(contents, tmp_path / "changed.mcap", spoilt))
    assert [str(one) for one in found.problems] == [
        "trial: /tf[0]: not a valid message of its channel"
    ]


def test_a_wall_that_a_path_logged_in_the_lab_crosses_was_entered(tmp_path):
    made = random_trials.trial(simulated=False)
    clear = replace(made.result.verdict, entered=(False,) * 3, clearance=(0.0,) * 3)
    log = read_trial(random_trials.write(made, tmp_path / "trial.mcap"))
    found = lab_differences(log, replace(log.result, verdict=clear))
    assert any(problem.field.startswith("result.entered") for problem in found)


@pytest.mark.parametrize(("row", "agrees"), [(-1, True), (-20, False)])
def test_cells_whose_pictures_ended_before_the_stop_have_the_last_poses(tmp_path, row, agrees):
    """The stop comes 0.8 s after the last frame: 0.5 s until the trial aborts, and repeats."""
    log = lab_log(tmp_path, lost(0, 100), 40.0, "no", 0.001)
    stop = replace(log.stop, sent_ns=1_790_000_000)
    result = replace(
        log.result,
        outcome=Outcome.ABORTED,
        verdict=replace(log.result.verdict, final=Poses.of(log.mocap[row])),
    )
    found = {one.field for one in lab_differences(replace(log, stop=stop), result)}
    assert ("result.final" not in found) == agrees


def test_a_trial_whose_end_was_torn_by_an_error_may_state_no_final_poses(tmp_path):
    """Regression: an error while the robots came to rest left a log that `verify` called false."""
    log = lab_log(tmp_path, lost(0, 100), 0.0, "yes", 0.001)
    untold = Verdict.unknown(3)
    for outcome, verdict, said in (
        (Outcome.ABORTED, untold, set()),
        (Outcome.ARRIVED, untold, {"result.final"}),
        (Outcome.ABORTED, replace(untold, final=Poses.of(log.mocap[-1] + 1)), {"result.final"}),
    ):
        result = replace(log.result, outcome=outcome, verdict=verdict)
        found = {one.field for one in lab_differences(log, result)}
        assert {one for one in found if one == "result.final"} == said


def test_frames_that_the_camera_lost_end_no_check_of_a_log_without_its_end():
    whole = three_robots()
    numbers = whole.frames + (np.arange(len(whole.frames)) > 30)
    ended = replace(whole, frames=numbers, result=None, damage=Damage((), ("the result",)))
    assert first_steps(ended) == list(whole.steps)
    torn = replace(ended, damage=Damage((), ("a chunk", "the result")))
    assert len(first_steps(torn)) == 2


def test_no_step_after_a_gap_is_a_first_step():
    """Regression: one whose number was that of its place was, where a number was repeated."""
    whole = three_robots()
    first, second, third, *_ = whole.steps
    assert first_steps(replace(whole, steps=(first, third, replace(second, k=2)))) == [first]


def test_no_step_of_a_seed_that_has_no_trial_counts_as_checked():
    whole = three_robots()
    decisions = recompute(replace(whole, start=replace(whole.start, seed=-1)), search_again=False)
    assert decisions.agreeing == 0
    assert decisions.difference is not None
    assert decisions.difference.field == "seed"
