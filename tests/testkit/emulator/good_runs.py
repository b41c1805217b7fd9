"""Runs without faults in an emulated lab, with the expected result of each.

`RUNS` contains for each name the section `emulation` of a script, settings of both sides, and for
how many seconds robots stand still before they are put back on their starts.
"""

import math

import numpy as np

from tetractl.log.read.reader import read_trial
from tetractl.verification.result_check import result_differences

UNEVEN = """
emulation:
  camera: {version: '4.3'}
  actuator:
    robots:
      - {name: green, left: {gain_mm: 7.2, dead_zone: 6}, right: {gain_mm: 8.4, dead_zone: 4}}
      - {name: blue, swap: true, lag: 0.08}
"""
OFFSET = "lab.camera.robots.2.heading_offset=0.4"
BEFORE_OBSTACLE = "controller.time_limit=1"
"""In real time no two runs take the same way, and in 1.8 s blue may come to the obstacle's corner.
In 1 s it drives 212 mm, with the latency, and the guard looks 30 mm ahead; its body would touch the
obstacle after 253 mm."""
RUNS = {
    "multicast, two trials": (
        "",
        (
            "lab.camera.transport=multicast",
            "trials.count=2",
            "lab.limits.placing=30",
            BEFORE_OBSTACLE,
        ),
        6.0,  # longer than the run watches the robots after a trial
    ),
    "version 2.9, z up, elsewhere": (
        "emulation: {camera: {version: '2.9'}}",
        (
            "lab.camera.up_axis=z",
            "lab.camera.origin=[300, -200]",
            "lab.camera.rotation=1.1",
            OFFSET,
        ),
        None,
    ),
    "version asked for, 38400 baud": (
        "emulation: {camera: {version: '4.2'}}",
        ("lab.camera.version='3.1'", "lab.actuator.baud=38400"),
        None,
    ),
    "uneven robots": (
        UNEVEN,
        (
            "lab.actuator.robots.1.swap=true",
            "lab.limits.wheel_error=0.4",  # the spec knows of no dead zone: a quarter of the speed
        ),
        None,
    ),
}


def script_of(name, folder):
    """Write the script of a run into a folder; return its path."""
    script = folder / "script.yaml"
    script.write_text("about: nothing goes wrong\n" + RUNS[name][0])
    return script


def check(sets, played):
    """Every trial is complete, its log agrees with itself, and its poses are the true ones."""
    assert played.exits == [0], played.said
    count = 2 if "trials.count=2" in sets else 1
    assert len(played.logs) == count
    for log in played.logs:
        trial = read_trial(log)
        assert trial.damage is None
        assert trial.result.outcome.complete
        differs = [*result_differences(trial, trial.result)]
        assert not differs, differs
    check_poses(played, trial)
    assert played.of("robot", moving=False), "they drove, and stand"


def check_poses(played, trial):
    """The log's poses are the true ones, frame by frame.

    Regression: on a busy host, a trial's log goes on after its robots were carried back to their
    starts; until new poses are accepted, it keeps the last ones.
    """
    first = {e["frame"]: e["poses"] for e in played.of("truth")}
    accepted = trial.valid.all(axis=1)
    true = np.array([first[number] for number in trial.frames])[accepted]
    assert len(true) > 100
    poses = trial.mocap[accepted]
    np.testing.assert_allclose(poses[:, :, :2], true[:, :, :2], atol=0.05)
    turned = np.vectorize(lambda a: math.remainder(a, math.tau))(poses[:, :, 2] - true[:, :, 2])
    np.testing.assert_allclose(turned, 0.0, atol=1e-3)
    steps = np.diff(true[:, :, :2], axis=0)
    assert (np.hypot(steps[..., 0], steps[..., 1]).sum(axis=0) > 50).all()
