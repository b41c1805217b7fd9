"""Tests of `tetractl lab guard`, which reports what the guard would have done in logged trials."""

import json

import pytest
from testkit.cli import tetractl
from testkit.paths import ROOT

GOLDEN = ROOT / "tests" / "golden"
SIM = GOLDEN / "format-4-sim.mcap"


def test_each_intervention_has_its_check_value_and_limit_and_a_table_counts_them():
    """The robot "one" of this log drives into its obstacle, as it starts near it."""
    done = tetractl(GOLDEN, "lab", "guard", SIM)
    assert done.returncode == 0, done.stderr
    assert "one is about to enter an obstacle" in done.stdout
    counts = done.stdout[done.stdout.index("What the guard would have done in 1 log") :]
    (obstacle,) = [line.split() for line in counts.splitlines() if line.startswith(" obstacle")]
    assert int(obstacle[3]) >= 1  # runs ended
    assert {line.split()[0] for line in counts.splitlines()[3:] if line.strip()} >= {
        "frame",
        "tracking",
        "motion",
        "drift",
    }


def test_json_gives_the_numbers():
    items = json.loads(tetractl(GOLDEN, "lab", "guard", SIM, "--json").stdout)
    (log,) = items["logs"]
    ends = [it for it in log["interventions"] if it["act"] == "ends the run"]
    assert ends[0]["robot"] == "one"
    assert {"check", "value", "limit", "unit", "robot"} == set(ends[0]["excess"])
    hours = {row["check"]: row["hours"] for row in items["checks"]}
    assert hours["drift"] * 3600 == pytest.approx(log["watched_s"])


def test_other_limits_can_be_tried():
    wide = tetractl(GOLDEN, "lab", "guard", SIM, "--json", "--set", "lab.limits.reaction=0")
    before = json.loads(tetractl(GOLDEN, "lab", "guard", SIM, "--json").stdout)
    after = json.loads(wide.stdout)

    def ends(items):
        return next(row["runs_ended"] for row in items["checks"] if row["check"] == "obstacle")

    assert ends(after) < ends(before)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("robots.one.speed=3", "this command accepts only `lab.limits.NAME=VALUE`"),
        ("lab.limits.wheel_error", "this command accepts only `lab.limits.NAME=VALUE`"),
        ("lab.limits.wheel_error=3", "lab.limits.wheel_error: must be at most 1"),
        ("lab.limits.no_such=3", "lab.limits.no_such: unknown key"),
        ("lab.limits.height_mm=[5, 2]", "must be two heights"),
    ],
)
def test_a_wrong_setting_is_one_line(setting, message):
    done = tetractl(GOLDEN, "lab", "guard", SIM, "--set", setting)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_log_without_wheel_speeds_says_what_was_not_observed(cells_log):
    done = tetractl(GOLDEN, "lab", "guard", cells_log)
    assert (
        "not checked, because no log has wheel speeds: frozen, motion, drift, wheels" in done.stdout
    )


@pytest.fixture(scope="module")
def cells_log(tmp_path_factory):
    """A log of a cell that swims for a second."""
    spec = """
name: cells
units: {length: um}
arena: {left: -500, bottom: -500, width: 1000, height: 1000}
robots: [{name: one, start: [0, 0], target: [100, 0], a: 6, speed: 100}]
controller: {type: sequence, period: 0.2, directions: [0, 0, 0, 0, 0]}
plant: {type: sim}
trials: {count: 1, seed: 1}
"""
    folder = tmp_path_factory.mktemp("cells")
    (folder / "cells.yaml").write_text(spec)
    done = tetractl(folder, "run", folder / "cells.yaml", "--out", folder / "logs", "--quiet")
    assert done.returncode == 0, done.stderr
    return folder / "logs" / "trial-000.mcap"
