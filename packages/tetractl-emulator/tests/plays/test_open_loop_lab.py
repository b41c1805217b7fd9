"""Tests of robots of an emulated lab that are driven open loop by a sequence, and identified."""

import json

import pytest
from testkit.cli import tetractl
from testkit.emulator.lab_processes import SMALL, SPEC, flags
from testkit.emulator.virtual_lab import virtual_lab

from tetractl.log.read.reader import read_trial

pytestmark = pytest.mark.long

PERIOD_S = 0.2
DIRECTIONS = [1.5 * PERIOD_S * step for step in range(20)]  # rad: a circle, clear of obstacles
SEQUENCE = f"controller={{type: sequence, period: {PERIOD_S}, directions: {DIRECTIONS}}}"


def test_a_sequence_is_driven_and_its_robots_are_identified(tmp_path):
    def call(*words):
        done = tetractl(tmp_path, *words).ok()
        return done.stdout

    of_the_lab = (setting for setting in SMALL if not setting.startswith("controller."))
    sets = (*of_the_lab, SEQUENCE, "lab.limits.placing=30")
    with virtual_lab(tmp_path, *sets, spec=SPEC, replace_after=6.0, ahead_s=0.5) as lab:
        run = ("run", SPEC, "--plant", "lab", "--yes", "--quiet", "--out", "driven")
        call(*run, *flags(lab.settings))
        log = read_trial(next((tmp_path / "driven").glob("*.mcap")))
        assert log.result.outcome.complete
        assert log.result.verdict.entered == (False,) * 3
        printed = json.loads(call("identify", "driven", "--json"))
        assert printed["origin"] == "emulated lab"
        for robot, a, speed in zip(printed["robots"], (6, 4, 3), (180, 200, 150), strict=True):
            assert robot["a"]["value"] == pytest.approx(a, rel=0.3)
            assert robot["speed"]["value"] == pytest.approx(speed, rel=0.05)
