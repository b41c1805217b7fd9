"""Tests with logs in which robots paused, or did not receive commands for a while.

What a robot does between a stop and the next direction must be left out, and also what it does
after its watchdog has stopped it. A robot that loses a single command follows the previous one.
"""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from testkit.paths import ROOT
from tetractl_identify.identify import identify
from tetractl_identify.response import fit_responses
from tetractl_identify.tracks import SETTLING_S, extract_track, extract_wheel_track

from tetractl.core.errors import UsageError
from tetractl.log.read.reader import read_trial
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import load_spec

WATCHDOG_S = 0.25  # of the robots in three_m3pi.yaml
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


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The log of a trial in which the radio is silent for 1 s three times."""
    folder = tmp_path_factory.mktemp("silent")
    spec = load_spec(ROOT / "experiments" / "three_m3pi.yaml", SILENT)
    run_logged(spec, folder, 10)
    return read_trial(log_path(folder, 10))


def assert_explained(identified):
    """Assert that the directions explain more than 95 % of each robot's motion."""
    for explained in (*identified.turning_explained, *identified.distance_explained):
        assert explained.fraction is not None
        assert explained.fraction > 0.95


@pytest.mark.long
@pytest.mark.slow
def test_the_speed_of_robots_that_paused_is_found(log):
    identified = identify([extract_track(log)], log.start.setup.a)
    true = json.loads(log.start.plant.facts["true_speed"])
    speeds = [robot.speed.value for robot in identified.robots]
    assert speeds == pytest.approx(true, rel=0.01)
    assert_explained(identified)


@pytest.mark.long
@pytest.mark.slow
def test_commands_of_another_time_are_refused_though_the_radio_was_silent(log):
    track = extract_track(log)
    with pytest.raises(UsageError, match="do not belong together"):
        identify(
            [replace(track, direction_rad=np.roll(track.direction_rad, 20))], log.start.setup.a
        )


@pytest.mark.long
@pytest.mark.slow
def test_motion_is_not_judged_while_a_watchdog_has_stopped_a_robot(log):
    track = extract_track(log)
    received_s = [command.sent_ns / 1e9 for command in log.commands if command.delivered[0]]
    pauses = [
        (last_s + WATCHDOG_S, again_s + SETTLING_S)
        for last_s, again_s in pairwise(received_s)
        if again_s - last_s > WATCHDOG_S
    ]
    assert len(pauses) == 4  # three silences of the radio, and a single lost command
    is_left_out = np.zeros(len(track.time_s), dtype=bool)
    for begin_s, end_s in pauses:
        is_left_out |= (track.time_s >= begin_s) & (track.time_s < end_s)
    is_before_stop = track.time_s < track.stop_s
    assert (track.follows_commands[:, 0] == (track.valid[:, 0] & ~is_left_out))[
        is_before_stop
    ].all()
    assert track.follows_commands[:, 0].mean() > 0.5


# ---- Robots that lose 30 % of the commands, at 20 Hz ----


LOSSY = (
    "trials.seed=7100",
    "plant.dead_time=0.11",
    "plant.a_error=0.2",
    "plant.speed_error=0.1",
    "plant.heading_noise=0.03",
    "plant.measurement_noise={position: 0.3, heading: 0.004}",
    "plant.lost_commands=0.3",
)
LOSSY_BENCH = ("trials.seed=7200", "plant.lost_commands=0.3", "plant.drive.rate=20")


def run_log(folder, name, sets):
    spec = load_spec(ROOT / "experiments" / f"{name}.yaml", sets)
    run_logged(spec, folder, 0)
    return read_trial(log_path(folder, 0))


@pytest.mark.long
@pytest.mark.slow
def test_directions_of_which_robots_lose_30_percent_are_read(tmp_path):
    log = run_log(tmp_path, "three_m3pi", LOSSY)
    identified = identify([extract_track(log)], log.start.setup.a)
    facts = log.start.plant.facts
    speeds = [robot.speed.value for robot in identified.robots]
    rates = [robot.a.value for robot in identified.robots]
    assert speeds == pytest.approx(json.loads(facts["true_speed"]), rel=0.01)
    assert rates == pytest.approx(json.loads(facts["true_a"]), rel=0.05)
    assert_explained(identified)


@pytest.mark.long
@pytest.mark.slow
def test_wheels_that_lose_30_percent_of_their_speeds_are_read(tmp_path):
    """Regression: 'drives in only 6 steps between its poses'."""
    log = run_log(tmp_path, "three_m3pi_bench", LOSSY_BENCH)
    for response in fit_responses([extract_wheel_track(log)]):
        assert response.turning_lag.value == pytest.approx(0.04, abs=0.015)
        assert response.turning_gain.value == pytest.approx(1.0, abs=0.06)
        assert response.speed_gain.value == pytest.approx(1.0, abs=0.03)
