"""Robots of an emulated lab driven open loop, by a design to identify them."""

import json

import pytest
from support.cli import tetractl
from support.lab_processes import SMALL, SPEC, flags
from support.virtual_lab import virtual_lab

from tetractl.log.read.reader import read_trial

pytestmark = pytest.mark.long


def test_a_design_is_driven_and_its_robots_are_identified(tmp_path):
    def call(*words):
        done = tetractl(tmp_path, *words).ok()
        return done.stdout

    sets = (*SMALL, "lab.limits.placing=30")
    with virtual_lab(tmp_path, *sets, spec=SPEC, replace_after=0.2, ahead_s=0.5) as lab:
        design = ("design", SPEC, "--seconds", "4", "--plant", "lab", "--yes")
        said = call(*design, "--logs", "design", "--json", *flags(lab.settings))
        found = json.loads(said)
        assert found["origin"] == "emulated lab"
        log = read_trial(next((tmp_path / "design").glob("*.mcap")))
        assert log.result.outcome.complete
        assert log.result.verdict.entered == (False,) * 3
        for robot, a, speed in zip(found["robots"], (6, 4, 3), (180, 200, 150), strict=True):
            assert robot["a"]["value"] == pytest.approx(a, rel=0.3)
            assert robot["speed"]["value"] == pytest.approx(speed, rel=0.05)
