"""A package can bring a rule by which each trial finds its robots."""

import pytest
from support.marked_robots import MarkedRobots, install

from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import SpecError, parse_spec
from tetractl.log.read.reader import read_trial
from tetractl.run.spec_trial import run_logged

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
    assert spec.experiment.open
    assert spec.experiment.asked == MarkedRobots(marks=((600, 600), (600, 2000)))
    run_logged(spec, tmp_path)
    experiment = read_trial(tmp_path / "trial-000.mcap").experiment
    assert [robot.start for robot in experiment.robots] == [(600, 600), (600, 2000)]
    assert not experiment.open
    assert experiment.asked == spec.experiment.asked
    assert Experiment.model_validate(experiment.model_dump()) == experiment


def test_a_mapping_without_a_key_of_any_rule_is_read_as_the_first(monkeypatch):
    install(monkeypatch)
    with pytest.raises(SpecError, match=r"robots\.marks: is missing"):
        parse_spec(SPEC.replace("marks: [[600, 600], [600, 2000]]", "mark: [600, 600]"), "a.yaml")
