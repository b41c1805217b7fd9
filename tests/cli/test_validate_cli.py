"""Tests of `tetractl validate` and `schema`; reading logs must give no warnings."""

import json
from functools import partial

import pytest
from testkit import cli
from testkit.paths import ROOT, SPECS

pytestmark = pytest.mark.slow

EXPERIMENTS = ROOT / "experiments"
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
    "warning: alike.yaml:4:3: robots: the smallest total error of any plan is 50 mm; no controller "
    "can achieve a smaller error with these a, speeds, starts and targets",
    "warning: alike.yaml:5:59: robots.1.a: 6: two turns at the same rate as one and starts with "
    "the same heading, so the 2 can only move in parallel: their total error cannot fall below "
    "50 mm; give the robots different turning rates a, or targets with the same relative "
    "positions as their starts",
]


@pytest.fixture
def tetractl(tmp_path):
    (tmp_path / "alike.yaml").write_text(ALIKE, encoding="utf-8")
    return partial(cli.tetractl, tmp_path)


@pytest.mark.long
def test_good_specs_are_ok(tetractl):
    result = tetractl("validate", *SPECS).ok()
    warned = result.stderr.splitlines()  # holds of cells, as tight as they can be
    assert len(warned) == 2 and all("hold.radius" in line for line in warned), warned
    named = {spec.stem for spec in SPECS if f"{spec.name}:" in result.stderr}
    assert named == {"magnetospirillum_hold", "tetrahymena_hold"}
    lines = result.stdout.splitlines()
    assert len(lines) == len(SPECS)
    assert all(line.startswith(f"{spec}: ok: ") for spec, line in zip(SPECS, lines, strict=True))
    assert "name three-m3pi, robots 3, obstacles 1" in result.stdout


def test_all_problems_of_all_bad_specs_are_printed(tetractl, tmp_path):
    good = EXPERIMENTS / "three_m3pi.yaml"
    text = good.read_text("utf-8")
    number = {word: text[: text.index(word)].count("\n") + 1 for word in ("a: 6", "accept_error:")}
    (tmp_path / "one.yaml").write_text(
        text.replace("a: 6", "a: -6").replace("accept_error:", "accept_eror:"), encoding="utf-8"
    )
    (tmp_path / "two.yaml").write_text("name: [x\n", encoding="utf-8")
    result = tetractl("validate", "one.yaml", good, "two.yaml")
    assert result.returncode == 2
    one_a, one_horizon, ok, two = result.stdout.splitlines()
    assert one_a.startswith(f"one.yaml:{number['a: 6']}:")
    assert one_a.endswith("robots.0.a: -6: must be greater than 0")
    assert one_horizon == (
        f"one.yaml:{number['accept_error:']}:3: controller.accept_eror: unknown key; "
        "did you mean 'accept_error'?"
    )
    assert ok.startswith(f"{good}: ok")
    assert two.startswith("two.yaml:2:1: not valid YAML")


def test_json_holds_summaries_and_problems(tetractl, tmp_path):
    (tmp_path / "bad.yaml").write_text("name: 5\n", encoding="utf-8")
    result = tetractl("validate", EXPERIMENTS / "single_cell.yaml", "bad.yaml", "--json")
    assert result.returncode == 2
    good, bad = json.loads(result.stdout)["specs"]
    assert (good["ok"], good["name"], good["robots"], good["trials"]) == (
        True,
        "single-cell",
        1,
        10,
    )
    assert len(good["hash"]) == 64
    assert (bad["ok"], bad["path"]) == (False, "bad.yaml")
    first = next(problem for problem in bad["problems"] if problem["field"] == "name")
    assert (first["line"], first["column"], first["value"]) == (1, 7, "5")
    assert first["message"] == "must be text; put it in quotes"


def test_schema_is_printed_or_written(tetractl, tmp_path):
    printed = tetractl("schema").ok()
    assert json.loads(printed.stdout)["title"] == "Experiment"
    assert tetractl("schema", "-o", "new.json").returncode == 0
    assert (tmp_path / "new.json").read_text("utf-8") == printed.stdout


def warned(result):
    return [line for line in result.stderr.splitlines() if line.startswith("warning: ")]


def test_json_holds_warnings_and_the_least_error(tetractl):
    good = EXPERIMENTS / "single_cell.yaml"
    result = tetractl("validate", good, "alike.yaml", "--set", "trials.seed=2", "--json")
    sound, doubtful = json.loads(result.stdout)["specs"]
    assert (sound["ok"], sound["warnings"], sound["least_total_error"]) == (True, [], 0)
    assert doubtful["ok"]
    assert doubtful["least_total_error"] == pytest.approx(50)
    first, second = doubtful["warnings"]
    assert (first["field"], first["line"], first["column"]) == ("robots", 4, 3)
    assert (second["field"], second["line"], second["value"]) == ("robots.1.a", 5, "6")
    assert second["hint"].startswith("give the robots different turning rates a")


def test_set_replaces_a_value_of_every_arm_of_a_study(tetractl, tmp_path):
    """Regression: with --set, a study was refused as if it were a spec."""
    (tmp_path / "study.yaml").write_text(
        "name: two\nbase: alike.yaml\ntrials: {count: 4, seed: 7}\n"
    )
    moved = "robots.two.target=[300, 700]"
    assert len(warned(tetractl("validate", "study.yaml", "--strict"))) == len(WARNINGS)
    done = tetractl("validate", "study.yaml", "--set", "robots.two.a=3", "--set", moved).ok()
    assert done.stdout == "study.yaml: ok: study two, arms 1, trials 4 each\n"
    assert warned(done) == []
    wrong = tetractl("validate", "study.yaml", "--set", "robots.two.a=fast")
    assert wrong.returncode == 2
    assert wrong.stdout == "--set robots.two.a=fast: robots.1.a: fast: must be a number\n"


@pytest.mark.parametrize(
    "words", ["validate alike.yaml", "run alike.yaml --out logs", "run alike.yaml --dry-run"]
)
def test_warnings_are_a_line_each_and_stop_nothing(tetractl, words):
    result = tetractl(*words.split()).ok()
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
        == "error: the spec has 2 warnings, and with --strict, warnings are errors; nothing was run"
    )
    assert not (tmp_path / "logs").exists()
