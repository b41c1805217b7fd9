"""Runs in an emulated lab in which nothing goes wrong, over every kind of wire."""

import math

import numpy as np
import pytest
from support.lab_processes import play

from tetractl.emulate.script import load_script
from tetractl.log.read.reader import read_trial
from tetractl.replay.audit import audit

SLAVES = tuple(f"lab.actuator.robots.{i}.address={i + 1}" for i in range(3))
UNEVEN = """
emulation:
  camera: {version: '4.3'}
  actuator:
    robots:
      - {name: green, left: {gain_mm: 7.2, dead_zone: 6}, right: {gain_mm: 8.4, dead_zone: 4}}
      - {name: blue, swap: true, lag: 0.08}
"""
OFFSET = "lab.camera.robots.2.heading_offset=0.4"
RUNS = {
    "multicast, two trials": (
        "",
        ("lab.camera.transport=multicast", "trials.count=2", "lab.limits.placing=30"),
        ("--replace-after", "0.5"),
    ),
    "transparent radio, uneven robots": (
        UNEVEN,
        ("lab.actuator.mode=transparent", "lab.actuator.robots.1.swap=true"),
        (),
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_a_run_in_which_nothing_goes_wrong(name, tmp_path):
    text, sets, options = RUNS[name]
    script = tmp_path / "script.yaml"
    script.write_text("about: nothing goes wrong\n" + text)
    played = play(script, load_script(script), tmp_path, *options, sets=sets)
    assert played.exits == [0], played.said
    count = 2 if "trials.count=2" in sets else 1
    assert len(played.logs) == count
    for log in played.logs:
        trial = read_trial(log)
        assert trial.damage is None
        assert trial.result.outcome.complete
        assert audit(trial, same_host=True).problems == []
    check_poses(played, trial)
    assert played.of("robot", moving=False), "they drove, and stand"


def check_poses(played, trial):
    """The log's poses are the true ones, frame by frame."""
    first = {e["frame"]: e["poses"] for e in played.of("truth")}
    true = np.array([first[number] for number in trial.frames])
    assert len(true) > 100
    np.testing.assert_allclose(trial.mocap[:, :, :2], true[:, :, :2], atol=0.05)
    turned = np.vectorize(lambda a: math.remainder(a, math.tau))(
        trial.mocap[:, :, 2] - true[:, :, 2]
    )
    np.testing.assert_allclose(turned, 0.0, atol=1e-3)
    steps = np.diff(true[:, :, :2], axis=0)
    assert (np.hypot(steps[..., 0], steps[..., 1]).sum(axis=0) > 50).all()
