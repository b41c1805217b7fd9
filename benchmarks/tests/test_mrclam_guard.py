"""Tests that recordings of real robots become a log that the guard can watch."""

import mrclam_guard
import numpy as np
import pytest

from tetractl.log.read.reader import read_trial
from tetractl.verification.guard_replay import observe_log

LATE_S = 0.1


@pytest.fixture
def recordings(tmp_path):
    """Five robots on lanes, which drive straight 0.1 s after they are sent it. The fifth stands
    from 4 s on, whatever it is sent."""
    folder = tmp_path / "MRCLAM_Dataset0"
    folder.mkdir()
    for robot in range(1, 6):
        sent = [f"{1000 + k / 100} 0.08 0.0" for k in range(600)]
        lines = []
        for k in range(-60, 360):
            t = k / 60
            driven_s = max(0.0, min(t - LATE_S, 4.0 if robot == 5 else np.inf))
            noise = 1e-5 * np.sin([7 * k, 11 * k])
            lines.append(f"{1000 + t} {0.08 * driven_s + noise[0]} {robot + noise[1]} 0")
        (folder / f"Robot{robot}_Odometry.dat").write_text("\n".join(["# t v w", *sent]))
        (folder / f"Robot{robot}_Groundtruth.dat").write_text("\n".join(["# t x y", *lines]))
    return folder


def test_robots_that_obey_are_not_accused_and_one_that_stands_is(recordings, tmp_path):
    log = read_trial(mrclam_guard.convert(recordings, tmp_path / "logs"))
    assert log.start.setup.names == ("r1", "r2", "r3", "r4", "r5")
    assert log.valid.all()
    seen = observe_log(log)
    assert 5.5 < seen.watched_s <= 6.0  # after an end, a new guard waits until it has seen all
    assert {it.robot for it in seen.interventions} == {"r5"}
    first = seen.interventions[0]
    assert 4.0 < (first.t_ns - seen.began_ns) / 1e9 < 5.0


def test_robots_that_are_not_seen_together_are_in_different_frames():
    """Rows of 3 ms are one frame, a robot's next row is another one."""
    first = np.array([[0.0, 1, 1, 0], [0.016, 1, 1, 0]])
    second = np.array([[0.003, 2, 2, 0], [0.030, 2, 2, 0]])
    times_s, shown = mrclam_guard.join_frames([first, second])
    assert times_s.tolist() == [0.0, 0.016, 0.030]
    assert np.isnan(shown[:, :, 0]).tolist() == [[False, False], [False, True], [True, False]]
