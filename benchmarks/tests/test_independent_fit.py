"""The independent fit finds the values of a robot that is made up here."""

import numpy as np
import pytest
from independent_fit import fit, moments, windows, without_far
from recordings import create

DEAD_S, LAG_S, TURNING, SPEED, VEER = 0.1, 0.2, 0.9, 0.8, -0.1
STEP_S = 0.01


def recording():
    """Return 40 s of a robot's poses (M, 4) at 50 Hz and commands (K, 3) at 2 Hz, integrated in
    steps of STEP_S."""
    rng = np.random.default_rng(1)
    sent_s = np.arange(0, 40, 0.5)
    sent = np.column_stack([0.2 + 0.1 * rng.random(len(sent_s)), rng.normal(size=len(sent_s))])
    time_s = np.arange(0, 40, STEP_S)
    index = np.searchsorted(sent_s, time_s - DEAD_S, "right") - 1
    motion = sent[0]
    pose = np.zeros(3)
    poses = []
    for now_s, k in zip(time_s, np.maximum(index, 0), strict=True):
        poses.append([now_s, *pose])
        motion = sent[k] + (motion - sent[k]) * np.exp(-STEP_S / LAG_S)
        way = SPEED * motion[0] * STEP_S
        turn = TURNING * motion[1] * STEP_S + VEER * motion[0] * STEP_S
        middle = pose[2] + turn / 2
        pose += np.array([way * np.cos(middle), way * np.sin(middle), turn])
    return np.array(poses)[::2], np.column_stack([sent_s, sent])


def test_a_robot_that_is_made_up_is_found():
    used = without_far(windows([recording()]))
    turns, ways = moments(used, np.unique(used.block))
    values = fit(turns.sum(0), ways.sum(0))
    assert values["dead time [s]"] == pytest.approx(DEAD_S, abs=0.011)
    assert values["turning lag [s]"] == pytest.approx(LAG_S, abs=0.021)
    assert values["turning gain"] == pytest.approx(TURNING, abs=0.01)
    assert values["speed gain"] == pytest.approx(SPEED, abs=0.01)
    assert values["veer [rad/m]"] == pytest.approx(VEER, abs=0.02)
    assert values["turns explained"] > 0.99


def test_a_run_of_mrclam_is_read_from_its_first_command_on(tmp_path):
    (tmp_path / "Robot1_Groundtruth.dat").write_text("9.5 0 0 0\n10.5 1 0 0\n")
    (tmp_path / "Robot1_Odometry.dat").write_text("10 0.1 0\n10 0.1 0\n11 0.2 0.3\n")
    take = create(tmp_path / "Robot1_Groundtruth.dat")
    assert take.poses[:, 0].tolist() == [-0.5, 0.5]
    assert take.commands.tolist() == [[0, 0.1, 0], [1, 0.2, 0.3]]
