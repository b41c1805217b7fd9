"""A lab's log is consistent: times in order, and robots at rest at the end."""

from dataclasses import replace

import numpy as np
import pytest
from support import random_trials
from support.made_labs import lab_log, lost
from tetractl_emulator.rehearsal.log_checks import log_differences

from tetractl.core.plan import Outcome
from tetractl.log.read.reader import read_trial


def test_steps_of_the_lab_come_in_order(tmp_path):
    log = read_trial(random_trials.write(random_trials.trial(simulated=False), tmp_path / "t.mcap"))
    before, step = log.steps[1:3]
    back = replace(step, observation=replace(step.observation, frame=before.observation.frame - 1))
    forged = replace(log, steps=(*log.steps[:2], back, *log.steps[3:]))
    differences = {log_difference.field for log_difference in log_differences(forged)}
    assert "command.sent_ns" in differences


@pytest.mark.parametrize(
    ("outcome", "after", "wrong"),
    [(Outcome.ABORTED, 1, False), (Outcome.ABORTED, 0, True), (Outcome.NO_BETTER_PLAN, 1, True)],
)
def test_a_frame_counter_goes_back_only_as_a_trial_aborts(outcome, after, wrong, tmp_path):
    """For whatever reason it aborts: robots may be lost just before."""
    lab_trial = random_trials.trial(simulated=False)
    log = read_trial(random_trials.write(lab_trial, tmp_path / "t.mcap"))
    steps = log.steps[:3]
    last = int(np.searchsorted(log.mocap_ns, steps[-1].observation.sampled_ns))
    numbers = log.frames.copy()
    numbers[last + after :] -= 30
    result = replace(log.result, outcome=outcome, reason="red is lost")
    changed = replace(log, frames=numbers, steps=steps, result=result)
    fields = {difference.field for difference in log_differences(changed)}
    assert ("mocap.frames" in fields) == wrong


@pytest.mark.parametrize("metres", [0.001, 1.0])
@pytest.mark.parametrize(
    ("valid", "speed_mm", "halts", "said"),
    [
        (lost(0, 100), 0.0, "yes", ""),
        (lost(1, 96), 0.0, "yes", ""),
        (lost(1, 40, 90), 0.0, "yes", ""),
        (lost(1, 70), 0.0, "yes", "complete, but blue was not tracked for the last 0.30 s"),
        (lost(1, 70), 0.0, "no", "complete, but blue was not tracked for the last 0.30 s"),
        (lost(2, 0), 0.0, "yes", "complete, but red was not tracked for the last 0.99 s"),
        (lost(0, 100), 60.0, "yes", "complete, but green moved by 15 mm in the last 0.25 s"),
        (lost(0, 100), 60.0, "no", ""),
    ],
)
def test_a_complete_lab_trial_shows_every_robot_at_rest(
    tmp_path, valid, speed_mm, halts, said, metres
):
    log = lab_log(tmp_path, valid, speed_mm, halts, metres)
    differences = log_differences(log)
    of_outcome = [
        difference.message for difference in differences if difference.field == "result.outcome"
    ]
    assert of_outcome == ([said] if said else [])
