"""Logs in which robots paused, or did not receive commands for a while.

What robots do between a stop and the next direction is left out. What they do while no command
reaches them contradicts no command.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from testkit.paths import ROOT
from tetractl_identify.identify import identify
from tetractl_identify.tracks import track_of

from tetractl.core.errors import UsageError
from tetractl.log.read.reader import read_trial
from tetractl.run.spec_trial import log_path, run_logged
from tetractl.spec.load import load_spec

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


@pytest.mark.long
@pytest.mark.slow
def test_the_speed_of_robots_that_paused_is_found(log):
    identified = identify([track_of(log)], log.start.setup.a)
    true = json.loads(log.start.plant.facts["true_speed"])
    speeds = [robot.speed.value for robot in identified.robots]
    assert speeds == pytest.approx(true, rel=0.01)
    for explained in (*identified.turning_explained, *identified.distance_explained):
        assert explained.fraction is not None
        assert explained.fraction > 0.95


@pytest.mark.long
@pytest.mark.slow
def test_commands_of_another_time_are_refused_though_the_radio_was_silent(log):
    track = track_of(log)
    with pytest.raises(UsageError, match="do not belong together"):
        identify([replace(track, u=np.roll(track.u, 20))], log.start.setup.a)


@pytest.mark.long
@pytest.mark.slow
def test_motion_is_not_judged_from_a_lost_command_until_the_next_one_acts(log):
    track = track_of(log)
    lost_s = [command.sent_ns / 1e9 for command in log.commands if not command.delivered[0]]
    assert len(lost_s) >= 10
    for time_s in lost_s:
        is_near = (track.time >= time_s) & (track.time < time_s + 0.3)
        assert not track.commanded[is_near, 0].any()
    assert track.commanded[:, 0].mean() > 0.5
