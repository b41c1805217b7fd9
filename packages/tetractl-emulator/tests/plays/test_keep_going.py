"""Tests of a batch after an abort: it goes on only if nobody has to touch a robot or device."""

import json

import pytest
from testkit.cli import tetractl
from testkit.emulator.fault_checks import SCRIPTS
from testkit.emulator.lab_processes import SMALL, SPEC, flags
from testkit.emulator.scripts import load_script
from testkit.emulator.virtual_lab import virtual_lab

from tetractl.log.read.reader import read_result

pytestmark = pytest.mark.slow

PATHS = {path.stem: path for path in SCRIPTS}
HINT = "hint: with --keep-going, a batch goes on after an abort like this one"


def run(folder, fault, *words, trials=3):
    """Run a batch in the emulated lab, in each of whose trials a fault happens."""
    path = PATHS[fault]
    sets = (*SMALL, *load_script(path).runner.sets, f"plant.faults={path}")
    words = ("--quiet", "--trials", str(trials), "--out", "logs", *words)
    return tetractl(folder, "run", SPEC, "--plant", "emulated", *flags(sets), *words)


def logs(folder):
    return sorted((folder / "logs").glob("*.mcap"))


@pytest.mark.parametrize(
    "fault", ["into_obstacle", pytest.param("out_of_arena", marks=pytest.mark.long)]
)
def test_an_emulated_batch_goes_on_after_robots_were_seen_to_stand(tmp_path, fault):
    """Regression: 3 of 5 batches of the published controller ended early."""
    reason = load_script(PATHS[fault]).expect.says
    done = run(tmp_path, fault)
    assert done.returncode == 1
    assert len(logs(tmp_path)) == 3
    assert f"outcomes: 3 aborted ({reason})" in done.stdout
    for trial in (1, 2, 3):
        assert f"error: trial {trial}: {reason}" in done.stderr
    assert "not run" not in done.stderr
    again = run(tmp_path, fault, "--resume", "--json")
    assert again.returncode == 1, "its trials would be aborted again"
    assert json.loads(again.stdout)["aborted"] == 3


LASTING = ("driven_elsewhere", "emergency", "untracked", "stream_stops")


@pytest.mark.parametrize(
    "fault",
    ["radio_unplugged", *(pytest.param(fault, marks=pytest.mark.long) for fault in LASTING)],
)
def test_a_batch_ends_if_somebody_has_to_touch_a_robot_or_a_device(tmp_path, fault):
    done = run(tmp_path, fault, "--keep-going")
    assert done.returncode == 1
    assert len(logs(tmp_path)) == 1
    assert "2 trials were not run" in done.stderr
    assert HINT not in done.stderr


def test_a_batch_that_is_not_to_go_on_ends_at_its_first_abort(tmp_path):
    done = run(tmp_path, "into_obstacle", "--no-keep-going")
    assert done.returncode == 1
    assert len(logs(tmp_path)) == 1
    assert done.stderr.splitlines()[-1] == HINT


UNSEEN = "faults: [{fault: untracked, robot: green, at: 0.4, for: 0.5}]"
"""One body is not tracked for half a second of the first trial."""


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_batch_in_the_lab_waits_for_robots_that_are_put_back(tmp_path, goes_on):
    """In the lab a batch ends at its first abort unless it is to go on."""
    sets = (*SMALL, "lab.limits.placing=30", "trials.count=2")
    with virtual_lab(
        tmp_path, *sets, spec=SPEC, script=UNSEEN, replace_after=6.0, ahead_s=0.5
    ) as lab:
        words = ["run", SPEC, "--plant", "lab", "--yes", "--quiet", "--out", tmp_path / "logs"]
        words += flags(lab.settings)
        done = tetractl(tmp_path, *words, *(["--keep-going"] if goes_on else []))
    assert done.returncode == 1
    assert "trial 1 of 2: aborted (green is not tracked" in done.stderr
    outcomes = [read_result(path).outcome.complete for path in logs(tmp_path)]
    assert outcomes == ([False, True] if goes_on else [False])
    assert (HINT in done.stderr) == (not goes_on)
