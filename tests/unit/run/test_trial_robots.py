"""Tests that a package can add a rule by which each trial finds its robots."""

import pytest
from testkit.marked_robots import MarkedRobots, install

from tetractl.log.read.reader import read_trial
from tetractl.run.logged_trial import run_logged
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.problems import InvalidSpecError

SPEC = """
name: marked
units: {length: um}
arena: {left: 0, bottom: 0, width: 3000, height: 3000}
robots: {marks: [[600, 600], [600, 2000]]}
controller: {type: mpc, time_limit: 1}
"""


def test_a_trial_runs_with_the_robots_that_the_rule_of_a_package_finds(tmp_path, monkeypatch):
    install(monkeypatch)
    spec = parse_spec(SPEC, "marked.yaml")
    middle = {(robot.name, robot.start) for robot in spec.experiment.robots}
    assert middle == {("robot 1", (1500.0, 1500.0)), ("robot 2", (1500.0, 1500.0))}
    assert spec.experiment.must_choose_robots
    assert spec.experiment.stated_robots == MarkedRobots(marks=((600, 600), (600, 2000)))
    run_logged(spec, tmp_path)
    experiment = read_trial(tmp_path / "trial-000.mcap").experiment
    assert [robot.start for robot in experiment.robots] == [(600, 600), (600, 2000)]
    assert not experiment.must_choose_robots
    assert experiment.stated_robots == spec.experiment.stated_robots
    assert Experiment.model_validate(experiment.model_dump()) == experiment


ROBOT = "name: r, start: [600, 600], target: [900, 600], a: 4, speed: 200"


def with_robots(robots):
    return SPEC.replace("{marks: [[600, 600], [600, 2000]]}", robots)


@pytest.mark.parametrize("robots", ["{mark: [600, 600]}", "{}", f"{{{ROBOT}}}"])
def test_a_mapping_without_a_key_of_any_rule_is_refused(robots, monkeypatch):
    install(monkeypatch)
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(with_robots(robots), "a.yaml")
    (line,) = caught.value.lines()
    assert line.startswith("a.yaml:5:9: robots: ")
    assert "must be a list, with each robot after a '-', or a mapping with the key marks" in line


@pytest.mark.parametrize(
    "robots",
    [
        f"[{{{ROBOT}}}]",
        f"\n- {{{ROBOT}}}",
        "{marks: [[600, 600]]}",
        "{marks: [[600, 600]], found: false}",
        "\n  marks: [[600, 600], [600, 2000]]",
    ],
)
def test_a_list_of_robots_and_a_rule_are_read(robots, monkeypatch):
    install(monkeypatch)
    assert parse_spec(with_robots(robots), "a.yaml").experiment.robots
