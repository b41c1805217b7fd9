import os
import re

import pytest
from testkit.paths import ROOT

from tetractl.core.errors import SpecError
from tetractl.plant.sim_section import SimSection
from tetractl.spec.load import load_spec, parse_spec
from tetractl.spec.loaded_spec import resolved_yaml
from tetractl.spec.plants import calibrated, lab_of, on_plant
from tetractl.spec.yaml.problems import InvalidSpecError

EXPERIMENTS = ROOT / "experiments"
SPEC = EXPERIMENTS / "three_m3pi_lab.yaml"


MEASURED = """
measured: 2026-01-01T00:00:00Z
camera: {robots: [{name: blue, heading_offset: 0.25}]}
actuator:
  robots:
    - {name: blue, radius_mm: 41.5, left: {gain_mm: 7.0, dead_zone: 9}, right: {invert: true},
       swap: true}
"""


def test_the_plant_is_chosen_by_kind():
    loaded = load_spec(SPEC)
    assert isinstance(on_plant(loaded, None).experiment.plant, SimSection)
    assert isinstance(on_plant(loaded, "sim").experiment.plant, SimSection)
    lab = on_plant(loaded, "lab").experiment
    assert lab.plant == loaded.experiment.lab
    assert lab.lab is None
    back = on_plant(parse_spec(resolved_yaml(lab), "again"), "sim").experiment
    assert back.plant == SimSection()
    assert back.lab == lab.plant


def test_a_calibration_replaces_what_was_measured_and_is_attached(tmp_path):
    (tmp_path / "spec.yaml").write_text(SPEC.read_text())
    (tmp_path / "m.yaml").write_text(MEASURED)
    loaded = load_spec(tmp_path / "spec.yaml", ["lab.calibration=m.yaml"])
    plain = lab_of(loaded.experiment, "spec")
    run = on_plant(loaded, "lab")
    lab = lab_of(run.experiment, "spec")
    green, blue, _ = lab.actuator.robots
    assert green == plain.actuator.robots[0]
    assert blue.radius_mm == 41.5
    assert blue.swap is True
    assert blue.left.gain_mm == 7.0
    assert blue.left.dead_zone == 9
    assert blue.right.invert is True
    assert blue.index == 1
    assert [lab.camera.heading_offset(name) for name in ("green", "blue")] == [0.0, 0.25]
    assert run.attached == (("m.yaml", MEASURED),)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("41.5", "-1", r"m:6:\d+: plant.actuator.robots.1.radius_mm: -1: must be greater than 0"),
        ("swap", "swop", r"m:7:\d+: plant.actuator.robots.1.swop: .*did you mean 'swap'"),
        ("name: blue", "name: pink", r"m:3:\d+: plant.camera.robots: has no entry 'pink'; .* blue"),
        ("dead_zone: 9", "dead_zone: 60}, limit: 50, x: {", "unknown key"),
        ("measured: 2026", "meshured: 2026", "m: this is not a calibration file"),
        (
            "camera:",
            "robots: []\ncamera:",
            r"m:3:1: robots: unknown key; known here: measured, emulated, camera, actuator",
        ),
    ],
)
def test_a_wrong_calibration_is_refused_with_its_place(before, after, message):
    experiment = on_plant(load_spec(SPEC), "lab").experiment
    with pytest.raises(SpecError, match=message):
        calibrated(experiment, MEASURED.replace(before, after), "m")


LABS = """
wheels=null
  lab.actuator.robots.0.radius_mm: is missing; add it, or add 'wheels:
lab.camera.robots.red.name=rod
  lab.camera.robots: has no entry for red
lab.camera.robots.red.name=rod
  robots.2.name: rod: is not a robot of the spec
lab.actuator.robots.red.name=rod
  lab.actuator.robots: has no entry for red
lab.camera.robots.2.body=green
  robots.2.body: green: is also the value of green; the values must differ
lab.actuator.robots.2.index=0
  robots.2.index: 0: is also the value of green; the values must differ
lab.camera.version=2
  lab.camera.version: 2: must be major.minor, such as 4.1
lab.camera.version=2.10
  camera.version: 2.10: must be at least 2.5; if 2.10 is
lab.camera.version='4.1'
  camera.version: '4.1': can be requested only in unicast
lab.camera.version=4.1
  camera.version: 4.1: can be requested only in unicast
lab.camera.server=256.1.1.1
  lab.camera.server: must be IPv4, such as
lab.camera.type=kinect
  lab.camera.type: must be one of optitrack
lab.actuator.type=m3pi
  did you mean 'm3pi-xbee'?
lab.type=sim
  lab.type: must be one of lab
lab.actuator.robots.0.limit=9 lab.actuator.robots.0.left.dead_zone=9
  must be below the robot's limit of 9
"""


@pytest.mark.parametrize(("settings", "line"), re.findall(r"(.*)\n  (.*)\n", LABS))
def test_labs_that_cannot_be_are_refused(settings, line):
    with pytest.raises(InvalidSpecError) as caught:
        load_spec(SPEC, settings.split())
    text = caught.value.message
    for part in line.split(": "):
        assert part in text


def test_a_spec_without_a_folder_names_its_calibration_by_the_whole_path(tmp_path, monkeypatch):
    """Regression: `rerun LOG --plant lab` drove robots by a file with that name in the present
    folder, of other robots perhaps: a log does not know the folder of its spec."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "m.yaml"
    file.write_text(MEASURED)
    relative = parse_spec(SPEC.read_text(), "spec.yaml", ["lab.calibration=m.yaml"])
    with pytest.raises(
        SpecError,
        match=r"^lab.calibration: m.yaml: this path is relative to the folder of the spec",
    ):
        on_plant(relative, "lab")
    whole = parse_spec(SPEC.read_text(), "spec.yaml", [f"lab.calibration={file}"])
    assert on_plant(whole, "lab").attached == (("m.yaml", MEASURED),)


@pytest.mark.parametrize(
    "text",
    [
        "root:x:0:0::/:/bin/sh\n",
        "[secret]\nkey = hunter2\n",
        "- hunter2\n",
        "hunter2: {",
        "",
        "a: b\n",
    ],
)
def test_no_line_of_a_file_that_is_no_calibration_is_shown(text):
    """Regression: a spec could name any readable file, and its lines were printed."""
    with pytest.raises(SpecError) as error:
        calibrated(on_plant(load_spec(SPEC), "lab").experiment, text, "/etc/secret")
    assert error.value.message == "/etc/secret: this is not a calibration file"


@pytest.mark.parametrize(
    ("written", "read"), [("4.1", "4.1"), ("'4.1'", "4.1"), ("2.11", "2.11"), ("'2.10'", "2.10")]
)
def test_a_protocol_version_needs_no_quotes_where_it_is_a_number(written, read):
    settings = ["lab.camera.transport=unicast", f"lab.camera.version={written}"]
    camera = lab_of(load_spec(SPEC, settings).experiment, "spec").camera
    assert camera.version == read


def test_a_calibration_that_never_ends_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "m.yaml")
    (tmp_path / "spec.yaml").write_text(SPEC.read_text())
    loaded = load_spec(tmp_path / "spec.yaml", ["lab.calibration=m.yaml"])
    with pytest.raises(SpecError, match=r"m.yaml: is not a regular file"):
        on_plant(loaded, "lab")
