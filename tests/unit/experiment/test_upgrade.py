"""Old names in a spec: read, noticed, and reported at the place where they were written."""

import json
import subprocess
import sys

import pytest
from support.paths import ROOT

from tetractl.experiment.load import parse_spec
from tetractl.experiment.yaml.problems import InvalidSpecError
from tetractl.replay.verify import verify

GOLDEN = ROOT / "tests" / "golden"
HEAD = """name: s
arena: {left: 0, bottom: 0, width: 9, height: 9}
robots: [{name: r, start: [1, 1], target: [2, 2], a: 1, speed: 1}]
"""
OLD = """controller:
  type: pso-mpc
  model: exact
  swarm: {type: multistart, particles: 20}
  accept: 5
  first_lengths: spread
  collision: {check: swept, stop: true}
plant: {motion: continuous}
"""
NEW = """controller:
  type: mpc
  motion: exact
  optimizer: {type: multistart, particles: 20}
  accept_error: 5
  initial_lengths: geometric
  collision: {test: swept, stop_before_collision: true}
plant: {motion: exact}
"""


def test_an_old_spec_is_the_same_experiment_and_each_old_name_gets_one_notice():
    old, new = parse_spec(HEAD + OLD, "s.yaml"), parse_spec(HEAD + NEW, "s.yaml")
    assert old.experiment == new.experiment
    assert new.notices == ()
    assert sorted(old.notices) == [
        "s.yaml:10:15: controller.collision.check is now called controller.collision.test",
        "s.yaml:10:29: controller.collision.stop is now called "
        "controller.collision.stop_before_collision",
        "s.yaml:11:9: plant.motion: continuous is now called exact",
        "s.yaml:5:3: controller.type: pso-mpc is now called mpc",
        "s.yaml:6:3: controller.model is now called controller.motion",
        "s.yaml:7:3: controller.swarm is now called controller.optimizer",
        "s.yaml:8:3: controller.accept is now called controller.accept_error",
        "s.yaml:9:3: controller.first_lengths is now called controller.initial_lengths",
        "s.yaml:9:3: controller.initial_lengths: spread is now called geometric",
    ]


@pytest.mark.parametrize(
    ("setting", "notices"),
    [
        ("controller.swarm.particles=7", ["swarm.particles is now called"]),
        ("controller.swarm={particles: 7}", ["swarm is now called"]),
        ("controller={swarm: {particles: 7}}", ["swarm is now called"]),
        ("controller.optimizer.particles=7", []),
    ],
)
def test_settings_may_use_old_names(setting, notices):
    spec = parse_spec(HEAD, "s.yaml", [setting])
    assert spec.experiment.controller.optimizer.particles == 7
    assert len(spec.notices) == len(notices)
    for notice, words in zip(spec.notices, notices, strict=True):
        assert notice.startswith(f"--set {setting}: controller.")
        assert words in notice


def test_a_setting_by_its_old_name_reaches_into_the_spec():
    spec = parse_spec(HEAD + NEW, "s.yaml", ["controller.swarm.rounds=3", "controller.model=arc"])
    optimizer = spec.experiment.controller.optimizer
    assert (optimizer.type, optimizer.particles, optimizer.rounds) == ("multistart", 20, 3)
    assert spec.experiment.controller.motion == "arc"


def test_errors_point_at_what_was_written():
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(HEAD + OLD.replace("particles: 20", "particles: -1"), "s.yaml")
    (line,) = caught.value.lines()
    assert line == "s.yaml:7:40: controller.optimizer.particles: -1: must be at least 1"


def test_an_old_and_a_new_name_together_are_refused():
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(HEAD + NEW.replace("plant:", "  swarm: {}\nplant:"), "s.yaml")
    (line,) = caught.value.lines()
    assert line.startswith("s.yaml:11:3: controller.swarm: is now called controller.optimizer, ")


@pytest.mark.parametrize(("name", "problems"), [("sim", set()), ("torn", {"damage"})])
def test_logs_with_old_names_verify(name, problems):
    found = verify(GOLDEN / f"format-1-{name}.mcap")
    assert {problem.field for problem in found.problems} == problems
    assert found.checked == found.steps > 0


def test_the_command_line_tells_what_changed_once(tmp_path):
    (tmp_path / "s.yaml").write_text(HEAD + OLD, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "tetractl", "validate", "--json", tmp_path / "s.yaml"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout)["specs"][0]["ok"]
    notices = done.stderr.splitlines()
    assert len(notices) == 9
    assert all(line.startswith("notice: ") for line in notices)
