"""Warnings as a user meets them: validate, run and --dry-run, and none where logs are read."""

import json
from functools import partial

import pytest
from support import cli
from support.paths import ROOT

ALIKE = """\
name: alike
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: one, start: [100, 300], target: [300, 300], a: 6, speed: 200}
  - {name: two, start: [100, 700], target: [300, 750], a: 6, speed: 200}
controller: {type: pso-mpc, horizon_max: 6, steps_max: 6,
  optimizer: {type: pso, particles: 10, iterations: 10}}
trials: {count: 1, seed: 7}
"""
WARNINGS = [
    "warning: alike.yaml:4:3: robots: least total error of any plan: 50 mm; no controller can do "
    "better with these a, speeds, starts and targets",
    "warning: alike.yaml:5:59: robots.1.a: 6: is that of one, and so is the start heading: two can "
    "only move in parallel, and the least total error of the 2 is 50 mm; give them different a, "
    "or targets with the same relative positions as the starts",
]


@pytest.fixture
def tetractl(tmp_path):
    (tmp_path / "alike.yaml").write_text(ALIKE, encoding="utf-8")
    return partial(cli.tetractl, tmp_path)


def warned(result):
    return [line for line in result.stderr.splitlines() if line.startswith("warning: ")]


def test_json_holds_warnings_and_the_least_error(tetractl):
    good = ROOT / "experiments" / "single_cell.yaml"
    result = tetractl("validate", good, "alike.yaml", "--set", "trials.seed=2", "--json")
    sound, doubtful = json.loads(result.stdout)["specs"]
    assert (sound["ok"], sound["warnings"], sound["least_total_error"]) == (True, [], 0)
    assert doubtful["ok"]
    assert doubtful["least_total_error"] == pytest.approx(50)
    first, second = doubtful["warnings"]
    assert (first["field"], first["line"], first["column"]) == ("robots", 4, 3)
    assert (second["field"], second["line"], second["value"]) == ("robots.1.a", 5, "6")
    assert second["hint"].startswith("give them different a")


@pytest.mark.parametrize(
    "words", ["validate alike.yaml", "run alike.yaml --out logs", "run alike.yaml --dry-run"]
)
def test_warnings_are_a_line_each_and_stop_nothing(tetractl, words):
    result = tetractl(*words.split())
    assert result.returncode == 0
    assert warned(result) == WARNINGS


@pytest.mark.parametrize("more", [["--dry-run"], []])
def test_a_strict_run_runs_nothing(tetractl, tmp_path, more):
    result = tetractl("run", "alike.yaml", "--strict", "--out", "logs", *more)
    assert result.returncode == 2
    assert result.stdout == ""
    *warnings, error = result.stderr.splitlines()
    assert warnings == WARNINGS
    assert (
        error
        == "error: the spec has 2 warnings, and --strict treats warnings as errors; nothing was run"
    )
    assert not (tmp_path / "logs").exists()
