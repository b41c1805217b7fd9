"""Tests of `robots: {choose: N, ...}`, which chooses robots among the cells of a dish."""

import re

import numpy as np
import pytest
from testkit.paths import EXAMPLES
from tetractl_microscope.choice.section import Choice, require_choice

from tetractl.core.errors import SpecError
from tetractl.log.read.reader import read_trial
from tetractl.run.logged_trial import run_logged
from tetractl.spec.experiment import find_packages
from tetractl.spec.load import load_spec, parse_spec

SPEC = """
name: three
units: {length: um}
arena: {left: 0, bottom: 0, width: 3000, height: 3000}
controller: {type: mpc, time_limit: 1}
robots: {choose: 3, ring: {center: [1500, 1500], radius: 500}, a: 4, speed: 420}
"""
ROUND = "obstacles: [{type: circle, center: [1500, 1500], radius: 100}]\n"


def test_a_choice_has_stand_ins_in_the_middle_until_a_trial_has_found_its_robots():
    experiment = parse_spec(SPEC, "three.yaml").experiment
    assert [robot.name for robot in experiment.robots] == ["cell 1", "cell 2", "cell 3"]
    assert {robot.start for robot in experiment.robots} == {(1500.0, 1500.0)}
    assert experiment.robots[0].target == (2000.0, 1500.0)
    assert experiment.must_choose_robots
    assert require_choice(experiment) == experiment.stated_robots


def test_a_simulated_trial_chooses_among_cells_drawn_from_its_seed(tmp_path):
    spec = parse_spec(SPEC, "three.yaml")
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        run_logged(spec, tmp_path / name)
    first = read_trial(tmp_path / "one" / "trial-000.mcap")
    again = read_trial(tmp_path / "two" / "trial-000.mcap")
    assert first.experiment == again.experiment
    assert not first.experiment.must_choose_robots
    assert first.experiment.stated_robots == spec.experiment.stated_robots
    a = np.array([robot.a for robot in first.experiment.robots])
    assert (np.diff(a) < 0).all()
    assert find_packages(first.experiment).keys() == {"tetractl-microscope"}


@pytest.mark.parametrize(
    ("robots", "line"),
    [
        (
            "{choose: 3, a: 4, speed: 420}",
            "robots.targets: give either targets or a ring, and only one of them",
        ),
        (
            "{ring: {center: [1, 1], radius: 5}, a: 4, speed: 4}",
            "robots: .* with the key choose",
        ),
        (
            "{choose: 2, targets: [[9, 9]], a: 4, speed: 4}",
            "must be at least 2, so that there is one",
        ),
        ("{choose: 1, targets: [[9, 9]], a: -4, speed: 4}", "robots.a: -4: must be greater than 0"),
    ],
)
def test_a_choice_that_is_wrong_is_one_line(robots, line):
    text = re.sub("robots: .*", f"robots: {robots}", SPEC)
    with pytest.raises(SpecError, match=line):
        parse_spec(text, "three.yaml")


def test_only_a_cell_among_others_can_be_replaced():
    experiment = parse_spec(SPEC + "on_lost: replace\n", "three.yaml").experiment
    assert experiment.setup.loss.replaces_lost
    with pytest.raises(SpecError, match="on_lost"):
        parse_spec(SPEC + ROUND + "on_lost: replace\n", "three.yaml")


def test_the_dish_of_the_examples_asks_for_a_choice():
    assert isinstance(load_spec(EXAMPLES / "tetrahymena_dish.yaml").experiment.chosen, Choice)
