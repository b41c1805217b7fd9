"""Tests of what `tetractl lab survey` prints and writes, with cells that a fake camera sees."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from testkit.cli import tetractl
from testkit.labs import fake_lab
from testkit.paths import EXAMPLES
from tetractl_microscope import handedness
from tetractl_microscope.choice import ranked
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.handedness import Handedness

from tetractl.core.poses import Pose
from tetractl.plant.lab_plant import RigSection
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

SPEC = EXAMPLES / "tetrahymena_dish.yaml"
LISTED = EXAMPLES / "tetrahymena_lab.yaml"
EXPERIMENT = select_plant(load_spec(SPEC), "lab").experiment
RIGHT = Handedness(cells=5, mirrored=False, turned=0.02, turned_sd=0.01, explained=0.9)


def cell(number, a, speed=400.0, **more):
    return RobotCandidate(number, Pose(100.0 * number, 50.0, 0.0), a, 0.1, speed, 10.0, **more)


CELLS = [
    cell(1, 3.0),
    cell(2, 4.0, 380.123),
    cell(3, 4.1, free=False),
    cell(4, 5.98765),
    cell(5, 0.1),
]


def proposal(numbers, error):
    cells = [CELLS[number - 1] for number in numbers]
    return SimpleNamespace(numbers=list(numbers), cells=cells, error=error)


@pytest.fixture
def dish(monkeypatch):
    """What the survey sees and predicts; a test may change it."""
    lab = fake_lab(EXPERIMENT.setup, halts=False)
    dish = SimpleNamespace(
        cells=CELLS, turned=RIGHT, choices=[proposal((1, 2, 4), 61.4), proposal((1, 3, 4), 70.0)]
    )

    def predicted(experiment, cells, noise, plans, done):
        dish.plans = plans
        dish.noise = noise
        done(1, 2)
        return dish.choices

    monkeypatch.setattr(RigSection, "rig", lambda *_, **__: lab.plant.rig)
    monkeypatch.setattr(handedness, "watch_turning", lambda *_: (dish.cells, dish.turned))
    monkeypatch.setattr(ranked, "rank_choices", predicted)
    return dish


def survey(folder, *words, yes=True, spec=SPEC):
    return tetractl(folder, "lab", "survey", spec, *words, *(["--yes"] if yes else []))


def test_cells_and_choices_are_printed_in_the_spec_s_unit(dish, tmp_path):
    done = survey(tmp_path).ok()
    lines = done.stdout.splitlines()
    assert lines[0] == ("cell 1 at (100, 50) um: a 3.00 ± 0.20 rad/s, speed 400 ± 20 um/s")
    assert lines[1].endswith("speed 380 ± 20 um/s")
    assert lines[2].endswith("was near the edge, so its turning rate a is unreliable")
    assert lines[4].endswith(", does not respond to the field")
    assert lines[5] == "cells 2 and 3 cannot be distinguished after they meet"
    assert lines[6].startswith("turning: 90 % of the turning of 5 cells is towards the field")
    assert lines[7] == "cells 1, 2, 4: predicted mean total error 61 um"
    assert lines[8].startswith("cells 1, 3, 4: predicted mean total error 70 um; less certain")
    assert len(lines) == 9
    assert "prediction 1 of 2" in done.stderr
    assert "warning" not in done.stderr and "wrote" not in done.stderr


def test_the_json_has_all_that_is_printed(dish, tmp_path):
    printed = json.loads(survey(tmp_path, "--json").ok().stdout)
    assert printed["unit"] == "um"
    assert [c["magnetised"] for c in printed["cells"]] == [True] * 4 + [False]
    assert printed["cells"][1]["speed"] == 380.123
    assert printed["alike"] == [[2, 3]]
    assert printed["choices"] == [
        {"cells": [1, 2, 4], "error": 61.4},
        {"cells": [1, 3, 4], "error": 70.0},
    ]
    assert "towards the field" in printed["turning"]


def test_a_mirrored_image_is_a_warning(dish, tmp_path):
    dish.turned = replace(RIGHT, mirrored=True)
    done = survey(tmp_path)
    assert done.returncode == 0
    assert "warning: cells turn right when the field turns left: the image is" in done.stderr


def test_predictions_use_the_noise_of_the_simulation_and_the_given_number_of_plans(dish, tmp_path):
    survey(tmp_path).ok()
    assert dish.plans == 96
    assert (dish.noise.position_std, dish.noise.heading_std) == (2.0, 0.05)
    survey(tmp_path, "--plans", 7).ok()
    assert dish.plans == 7


def test_the_spec_for_trials_wants_the_best_cells_and_is_otherwise_the_same(dish, tmp_path):
    done = survey(tmp_path, "-o", "dish.yaml", "--set", "robots.seconds=5").ok()
    assert "wrote dish.yaml" in done.stderr
    written = load_spec(tmp_path / "dish.yaml").experiment
    wanted = [(want.a, want.speed) for want in written.chosen.wanted]
    assert wanted == [(3.0, 400.0), (4.0, 380.12), (5.9877, 400.0)]
    assert written.chosen.seconds == 5
    before = load_spec(SPEC, ["robots.seconds=5"]).experiment
    assert written.lab == before.lab and written.controller == before.controller
    again = survey(tmp_path, "-o", "dish.yaml")
    assert again.returncode == 2 and "dish.yaml" in again.stderr


@pytest.mark.parametrize(
    ("cells", "choices", "says"),
    [
        (
            CELLS,
            [proposal((1, 2, 4), math.inf)],
            "plans may last up to 12 s (controller.horizon_max)",
        ),
        (CELLS[3:], [], "only 1 of 2 cells respond to the field, but 3 are needed"),
        (CELLS[1:4], [], "every choice of 3 cells contains two that cannot be distinguished"),
    ],
)
def test_why_no_choice_can_be_steered_is_said_and_no_spec_is_written(
    dish, tmp_path, cells, choices, says
):
    dish.cells = cells
    dish.choices = choices
    done = survey(tmp_path, "-o", "dish.yaml")
    assert done.returncode == 1
    assert f"no choice of these cells can be steered to the targets: {says}" in done.stderr
    assert not (tmp_path / "dish.yaml").exists()


def test_the_field_of_a_real_lab_turns_only_with_consent(dish, tmp_path):
    done = survey(tmp_path, yes=False)
    assert done.returncode == 2 and done.stdout == ""
    assert "--yes" in done.stderr


def test_a_spec_that_lists_its_robots_has_no_cells_to_choose(dish, tmp_path):
    assert not load_spec(LISTED).experiment.must_choose_robots
    done = survey(tmp_path, spec=LISTED)
    assert done.returncode == 2
    assert "robots: {choose: N, ...}" in done.stderr
