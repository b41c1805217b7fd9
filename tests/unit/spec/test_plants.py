"""Tests of the plant that is run: a simulation, a lab or an emulated one, and its calibration."""

import pytest
from testkit.paths import ROOT

from tetractl.core.errors import SpecError, UsageError
from tetractl.spec.load import load_spec, parse_contents
from tetractl.spec.plants import (
    adapt_settings,
    apply_calibration,
    convert_lab,
    get_lab,
    is_lab_kind,
    select_plant,
)
from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import InvalidSpecError

LAB = load_spec(ROOT / "experiments/three_m3pi_lab.yaml")
SIM = parse_contents(
    {
        "name": "s",
        "arena": {"left": 0, "bottom": 0, "width": 100, "height": 100},
        "robots": [{"name": "r", "start": [10, 10], "target": [20, 20], "a": 3, "speed": 20}],
        "plant": {"type": "sim", "dead_time": 0.2},
    },
    "s.yaml",
)


@pytest.mark.parametrize("kind", [None, "sim"])
def test_a_simulation_stays_as_it_is(kind):
    assert select_plant(SIM, kind) is SIM
    assert select_plant(LAB, kind) is LAB


def test_a_spec_without_a_lab_cannot_run_in_one():
    with pytest.raises(SpecError, match=r"s\.yaml: this spec has no lab") as caught:
        select_plant(SIM, "lab")
    assert "add a section 'lab:'" in caught.value.hint
    with pytest.raises(SpecError, match="this spec has no lab"):
        get_lab(SIM.experiment, "s.yaml")


def test_in_a_lab_the_plant_is_the_lab_and_nothing_else_changes():
    in_lab = select_plant(LAB, "lab")
    assert in_lab.experiment.plant == LAB.experiment.lab
    assert in_lab.experiment.lab is None
    assert in_lab.experiment.robots == LAB.experiment.robots
    assert in_lab.attached == ()
    assert select_plant(in_lab, "lab").experiment == in_lab.experiment
    assert select_plant(in_lab, None).experiment == in_lab.experiment


def test_a_lab_that_is_simulated_is_kept_for_another_run():
    in_lab = select_plant(LAB, "lab")
    simulated = select_plant(in_lab, "sim").experiment
    assert simulated.plant.type == "sim"
    assert simulated.lab == in_lab.experiment.plant
    assert get_lab(simulated, "s") == get_lab(in_lab.experiment, "s") == LAB.experiment.lab


def test_an_unknown_plant_lists_those_that_are_known():
    with pytest.raises(UsageError, match="--plant moon: there is no such plant") as caught:
        select_plant(LAB, "moon")
    assert caught.value.hint.startswith("the known plants are sim, lab")


def test_only_some_plants_are_labs():
    assert [is_lab_kind(kind) for kind in ("sim", "lab")] == [False, True]


def test_a_lab_is_the_same_lab_unless_it_becomes_another_kind():
    lab = LAB.experiment.lab
    assert convert_lab(None, lab) is lab
    assert convert_lab("lab", lab) is lab


def moved(text, *sets, kind="lab"):
    return adapt_settings(parse_document(text, "s"), sets, kind)


WITH_LAB = "lab: {}\nplant: {}"


def test_settings_of_the_plant_are_those_of_the_lab_that_takes_its_place():
    sets = ("plant.limits.stale=0.2", "robots.0.a=3", "trials.count=plant.x")
    assert moved(WITH_LAB, *sets) == [
        "lab.type=lab", "lab.limits.stale=0.2", "robots.0.a=3", "trials.count=plant.x",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "sets", "kind"),
    [
        (WITH_LAB, ("plant.dead_time=1",), None),
        (WITH_LAB, ("plant.dead_time=1",), "sim"),
        (WITH_LAB, ("robots.0.a=3",), "lab"),
        (WITH_LAB, ("plant=3",), "lab"),
        ("plant: {}", ("plant.limits.stale=1",), "lab"),
        (WITH_LAB, (), "lab"),
    ],
)
def test_other_settings_stay(text, sets, kind):
    assert moved(text, *sets, kind=kind) == list(sets)


# calibrations

IN_LAB = select_plant(LAB, "lab").experiment
NAMES = [robot.name for robot in IN_LAB.robots]


def measured(text):
    return apply_calibration(IN_LAB, f"measured: now\n{text}", "m.yaml")


def test_a_calibration_without_values_changes_nothing():
    assert measured("") == IN_LAB
    assert measured("camera: {}\nactuator: {}\n") == IN_LAB


def test_single_values_replace_those_of_the_named_robot():
    text = "actuator:\n  robots:\n    - {name: red, left: {gain_mm: 7.5}}\n"
    robots = {robot.name: robot for robot in measured(text).plant.actuator.robots}
    before = {robot.name: robot for robot in IN_LAB.plant.actuator.robots}
    assert robots["red"].left.gain_mm == 7.5
    assert robots["red"].right == before["red"].right
    assert robots["red"].left.dead_zone == before["red"].left.dead_zone
    assert robots["green"] == before["green"]
    assert measured(text).plant.camera == IN_LAB.plant.camera


def test_a_value_of_the_section_itself_is_replaced():
    assert measured("camera: {command_port: 1600}\n").plant.camera.command_port == 1600


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("camera: {command_port: -1}", r"m\.yaml:2:24: plant\.camera\.command_port: -1: must be"),
        (
            "camera: {comand_port: 1}",
            r"m\.yaml:2:\d+: plant\.camera\.comand_port: unknown key; did you",
        ),
        ("actuator: {robots: [{name: pink, swap: true}]}", "has no entry 'pink'"),
        ("camera: 5", "must be a mapping"),
        ("lab: {}", "unknown key"),
    ],
)
def test_a_wrong_value_is_reported_at_its_place_in_the_calibration(text, says):
    with pytest.raises(InvalidSpecError, match=says):
        measured(f"{text}\n")


def test_values_that_contradict_each_other_are_refused_with_the_calibration():
    text = "actuator: {robots: [{name: red, index: 0}]}\n"
    with pytest.raises(
        SpecError, match=r"m\.yaml: if this calibration is applied, the field plant\.actuator\.rob"
    ):
        measured(text)


def test_a_calibration_is_read_only_if_it_is_wanted(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(LAB.text)
    (tmp_path / "m.yaml").write_text("measured: now\ncamera: {command_port: 1600}\n")
    loaded = load_spec(path, ["lab.calibration=m.yaml"])
    run = select_plant(loaded, "lab")
    assert run.experiment.plant.camera.command_port == 1600
    assert [name for name, _ in run.attached] == ["m.yaml"]
    without = select_plant(loaded, "lab", with_calibration=False)
    assert without.experiment.plant.camera == LAB.experiment.lab.camera
    assert without.attached == ()
