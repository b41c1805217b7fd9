import pytest
from support.paths import ROOT

from tetractl.core.errors import SpecError
from tetractl.experiment.lab import LabSpec
from tetractl.experiment.load import load_spec, parse_spec, resolved_yaml
from tetractl.experiment.plant import SimSpec
from tetractl.experiment.plants import (
    Calibration,
    RobotCalibration,
    calibration_yaml,
    lab_of,
    on_plant,
    parse_calibration,
)
from tetractl.experiment.yaml.problems import InvalidSpecError

EXPERIMENTS = ROOT / "experiments"
SPEC = EXPERIMENTS / "three_m3pi_lab.yaml"


def calibration():
    robot = load_spec(SPEC).experiment.lab.robots[1]
    measured = RobotCalibration(
        name="blue",
        heading_offset=0.25,
        radius_mm=41.5,
        left=robot.left.model_copy(update={"gain_mm": 7.0, "dead_zone": 9}),
        right=robot.right.model_copy(update={"invert": True}),
        swap=True,
    )
    return Calibration(measured="2026-01-01T00:00:00Z", robots=(measured,))


def test_the_plant_is_chosen_by_kind():
    loaded = load_spec(SPEC)
    assert isinstance(on_plant(loaded, None).experiment.plant, SimSpec)
    assert isinstance(on_plant(loaded, "sim").experiment.plant, SimSpec)
    lab = on_plant(loaded, "lab").experiment
    assert lab.plant == loaded.experiment.lab
    assert lab.lab is None
    back = on_plant(parse_spec(resolved_yaml(lab), "again"), "sim").experiment
    assert (back.plant, back.lab) == (SimSpec(), lab.plant)


def test_a_resolved_lab_experiment_loads_as_itself():
    lab = on_plant(load_spec(SPEC), "lab").experiment
    assert parse_spec(resolved_yaml(lab), "again").experiment == lab


def test_a_spec_without_a_lab_has_none():
    loaded = load_spec(EXPERIMENTS / "three_m3pi.yaml")
    with pytest.raises(SpecError, match="has no lab"):
        on_plant(loaded, "lab")


def test_a_calibration_replaces_what_was_measured_and_is_attached(tmp_path):
    (tmp_path / "spec.yaml").write_text(SPEC.read_text())
    (tmp_path / "m.yaml").write_text(calibration_yaml(calibration()))
    loaded = load_spec(tmp_path / "spec.yaml", ["lab.calibration=m.yaml"])
    plain = lab_of(loaded.experiment, "spec")
    run = on_plant(loaded, "lab")
    assert isinstance(run.experiment.plant, LabSpec)
    green, blue, _ = run.experiment.plant.robots
    assert green == plain.robots[0]
    assert (blue.heading_offset, blue.radius_mm, blue.swap) == (0.25, 41.5, True)
    assert (blue.left.gain_mm, blue.right.invert) == (7.0, True)
    assert (blue.body, blue.index) == ("blue", 1)
    assert run.attached == (("m.yaml", calibration_yaml(calibration())),)


def test_a_calibration_round_trips_and_tells_what_is_wrong():
    text = calibration_yaml(calibration())
    assert parse_calibration(text, "m") == calibration()
    with pytest.raises(InvalidSpecError, match=r"m:\d+:\d+: robots.0.radius_mm: -1"):
        parse_calibration(text.replace("41.5", "-1"), "m")


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (["wheels=null"], "lab: needs the robots' wheels"),
        (["lab.robots.red.name=rod"], "lab.robots: has no red"),
        (["lab.robots.red.name=rod"], "lab.robots.2.name: rod: is no robot of the spec"),
        (["lab.robots.2.body=green"], "lab.robots.2.body: green: is that of green; must differ"),
        (["lab.robots.2.index=0"], "lab.robots.2.index: 0: is that of green; must differ"),
        (["lab.mocap.version=4.1"], "lab.mocap.version: must be text; put it in quotes"),
        (["lab.mocap.version='4.1'"], "lab.mocap.version: '4.1': can only be asked for in unicast"),
        (["lab.mocap.server=256.1.1.1"], "lab.mocap.server: must be IPv4, such as"),
        (["lab.protocol.type=slave"], "lab.protocol.accept_no_watchdog: is missing"),
        (
            ["lab.protocol={type: slave, accept_no_watchdog: true}"],
            "lab.robots.1.address: is missing; the slave protocol addresses each robot",
        ),
        (
            ["lab.protocol={type: slave, accept_no_watchdog: false}"],
            "lab.protocol.accept_no_watchdog: must be one of True",
        ),
        (
            ["lab.protocol={type: slave, accept_no_watchdog: true}", "lab.radio.mode=transparent"],
            "lab.radio.mode: transparent: cannot address one robot",
        ),
        (["lab.robots.0.limit=9", "lab.robots.0.left.dead_zone=9"], "must be below its limit, 9"),
    ],
)
def test_labs_that_cannot_be_are_refused(settings, line):
    with pytest.raises(InvalidSpecError) as caught:
        load_spec(SPEC, settings)
    text = str(caught.value)
    for part in line.split(": "):
        assert part in text
