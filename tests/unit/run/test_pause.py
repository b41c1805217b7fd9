"""Tests of stops during a trial: robots pause before a wall, and start again from standstill."""

import numpy as np
import pytest
from testkit.paths import ROOT

from tetractl.core.commands import Turn
from tetractl.core.plan import PAUSE_S, Outcome
from tetractl.core.poses import wrap
from tetractl.log.read.reader import read_trial
from tetractl.report.trial_data import trial_data
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import load_spec
from tetractl.verification.verify import verify
from tetractl.view.player import Recording
from tetractl.view.terminal.replay_screen import format_step

SLOW = ("controller.period=0.2", "controller.signal_periods=1")  # 5 Hz
SILENT = (
    *SLOW,
    "trials.seed=7000",
    "plant.dead_time=0.11",
    "plant.a_error=0.2",
    "plant.speed_error=0.1",
    "plant.heading_noise=0.03",
    "plant.measurement_noise={position: 0.3, heading: 0.004}",
    "plant.lost_commands=0.02",
    "plant.disturbances=[{type: silent-radio, times: 3, duration: 1, between: [1, 14]}]",
)


@pytest.mark.long
@pytest.mark.slow
def test_robots_pause_rather_than_leave_and_go_on_to_their_targets(tmp_path):
    spec = load_spec(ROOT / "experiments" / "three_m3pi.yaml", SILENT)
    result = run_logged(spec, tmp_path, 10)
    log = read_trial(log_path(tmp_path, 10))
    pauses = [k for k, step in enumerate(log.steps) if step.plan.pauses]
    assert pauses
    assert [note.text for note in log.notes if "pause" in note.text] == [
        "all robots pause until the next plan starts, or until the trial ends"
    ] * len(pauses)
    for k in pauses:
        assert log.steps[k].command.stops
        if k + 1 == len(log.steps):  # the trial ends at rest
            continue
        waited = log.steps[k + 1].observation.sampled_ns - log.steps[k].command.sent_ns
        assert waited / 1e9 > PAUSE_S
        assert not log.steps[k + 1].deadline_missed
    assert result.total_error < 30
    assert not (result.entered_obstacle or result.left_arena)
    verdict = verify(log_path(tmp_path, 10))
    assert verdict.problems == ()
    assert verdict.checked == len(log.steps)


FACING = (*SLOW, "robots.green.start=[552, 800]", "robots.green.heading=3.14159")  # a wall


def test_where_nothing_can_move_safely_the_log_holds_the_searches_that_say_so(
    tmp_path, monkeypatch
):
    """Regression: the trial ended on searches that no log held, and `verify` failed it."""
    monkeypatch.setattr("tetractl.control.methods.mpc.choose_facing", lambda *_: None)
    spec = load_spec(ROOT / "experiments" / "three_m3pi.yaml", FACING)
    result = run_logged(spec, tmp_path, 3)
    log = read_trial(log_path(tmp_path, 3))
    assert result.outcome is Outcome.NO_BETTER_PLAN
    assert log.steps[-1].plan.pauses
    assert len(log.steps[-1].plan.searches) > 1
    assert verify(log_path(tmp_path, 3)).problems == ()


@pytest.mark.long
def test_robots_without_a_safe_way_ahead_turn_on_the_spot_and_the_log_verifies(tmp_path):
    spec = load_spec(ROOT / "experiments" / "three_m3pi.yaml", FACING)
    run_logged(spec, tmp_path, 3)
    log = read_trial(log_path(tmp_path, 3))
    turns = [k for k, step in enumerate(log.steps) if isinstance(step.plan.action, Turn)]
    assert turns
    assert turns[-1] + 1 < len(log.steps)
    for k in turns:
        before, after = (log.steps[i].observation.poses for i in (k, k + 1))
        assert before.distances(after.xy).max() < 1.0
        off = [wrap(log.steps[k].plan.action.facing - poses.heading) for poses in (before, after)]
        assert (np.abs(off[1]) <= np.abs(off[0]) + 1e-3).all()
    recording = Recording(log)
    for k, text in ((turns[0], "direction turning on the spot"), (turns[-1] + 1, " deg")):
        assert text in format_step(recording, k)
    assert trial_data(log, "t.mcap")["steps"]["doing"][turns[0]] == "turning on the spot"
    starts = [k for k in turns if k - 1 not in turns]
    turning = "all robots turn on the spot, because they have no safe path ahead"
    assert [note.text for note in log.notes].count(turning) == len(starts)
    assert verify(log_path(tmp_path, 3)).problems == ()
