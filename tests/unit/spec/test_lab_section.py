import dataclasses
import os
import re

import pytest
from testkit.paths import ROOT

from tetractl.core.errors import SpecError, UsageError
from tetractl.plant.sim_section import SimSection
from tetractl.spec.lab_section import RobotPart, entry, find_unknown_radii, mismatches, too_fast
from tetractl.spec.load import load_spec, parse_contents, parse_spec
from tetractl.spec.loaded_spec import resolved_yaml
from tetractl.spec.plants import apply_calibration, get_lab, select_plant
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
    assert isinstance(select_plant(loaded, None).experiment.plant, SimSection)
    assert isinstance(select_plant(loaded, "sim").experiment.plant, SimSection)
    lab = select_plant(loaded, "lab").experiment
    assert lab.plant == loaded.experiment.lab
    assert lab.lab is None
    back = select_plant(parse_spec(resolved_yaml(lab), "again"), "sim").experiment
    assert back.plant == SimSection()
    assert back.lab == lab.plant


def test_a_calibration_replaces_what_was_measured_and_is_attached(tmp_path):
    (tmp_path / "spec.yaml").write_text(SPEC.read_text())
    (tmp_path / "m.yaml").write_text(MEASURED)
    loaded = load_spec(tmp_path / "spec.yaml", ["lab.calibration=m.yaml"])
    plain = get_lab(loaded.experiment, "spec")
    run = select_plant(loaded, "lab")
    lab = get_lab(run.experiment, "spec")
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
    experiment = select_plant(load_spec(SPEC), "lab").experiment
    with pytest.raises(SpecError, match=message):
        apply_calibration(experiment, MEASURED.replace(before, after), "m")


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
        select_plant(relative, "lab")
    whole = parse_spec(SPEC.read_text(), "spec.yaml", [f"lab.calibration={file}"])
    assert select_plant(whole, "lab").attached == (("m.yaml", MEASURED),)


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
        apply_calibration(select_plant(load_spec(SPEC), "lab").experiment, text, "/etc/secret")
    assert error.value.message == "/etc/secret: this is not a calibration file"


@pytest.mark.parametrize(
    ("written", "read"), [("4.1", "4.1"), ("'4.1'", "4.1"), ("2.11", "2.11"), ("'2.10'", "2.10")]
)
def test_a_protocol_version_needs_no_quotes_where_it_is_a_number(written, read):
    settings = ["lab.camera.transport=unicast", f"lab.camera.version={written}"]
    camera = get_lab(load_spec(SPEC, settings).experiment, "spec").camera
    assert camera.version == read


def test_a_calibration_that_never_ends_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "m.yaml")
    (tmp_path / "spec.yaml").write_text(SPEC.read_text())
    loaded = load_spec(tmp_path / "spec.yaml", ["lab.calibration=m.yaml"])
    with pytest.raises(SpecError, match=r"m.yaml: is not a regular file"):
        select_plant(loaded, "lab")


# the rules of the robots of a device


def setup_of(unit="mm", wheels=True):
    robots = [
        {"name": name, "start": [1, y], "target": [5, y], "a": 3, "speed": speed}
        for name, y, speed in (("one", 1, 2.0), ("two", 5, 3.0))
    ]
    contents = {
        "name": "s",
        "units": {"length": unit},
        "arena": {"left": 0, "bottom": 0, "width": 9, "height": 9},
        "robots": robots,
    }
    if wheels:
        contents["wheels"] = {"radius": 0.1}
    return parse_contents(contents, "s").experiment.setup


@pytest.mark.parametrize(
    ("unit", "speed_max_mm_s", "is_too_fast"),
    [("mm", 3, False), ("mm", 2.9, True), ("cm", 30, False), ("cm", 29, True),
     ("m", 3000, False), ("m", 2999, True)],
)  # fmt: skip
def test_no_robot_is_faster_than_its_wheels_are_driven(unit, speed_max_mm_s, is_too_fast):
    found = list(too_fast(setup_of(unit), speed_max_mm_s))
    assert [loc for loc, _ in found] == [("speed_max_mm_s",)] * is_too_fast
    if found:
        in_mm = {"mm": "3", "cm": "30", "m": "3000"}[unit]
        assert found[0][1] == f"is below the speed of two, which is {in_mm} mm/s"


def test_radii_are_needed_only_if_the_spec_has_none():
    assert list(find_unknown_radii(setup_of(), [None, None])) == []
    found = list(find_unknown_radii(setup_of(wheels=False), [40.0, None]))
    assert [loc for loc, _ in found] == [("robots", 1, "radius_mm")]
    assert list(find_unknown_radii(setup_of(wheels=False), [40.0, 41.0])) == []


class Body(RobotPart):
    """A robot's entry with a number of its own."""

    number: int | None = None


def bodies(*entries):
    return [Body(name=name, number=number) for name, number in entries]


def test_a_device_lists_every_robot_of_the_spec_once_and_no_other():
    good = bodies(("two", 2), ("one", 1))
    assert list(mismatches(good, ["one", "two"], ["number"])) == []
    places = [loc for loc, _ in mismatches(good, ["one", "three"], ["number"])]
    assert places == [("robots",), ("robots", 0, "name")]
    twice = list(mismatches(bodies(("one", 1), ("one", 2)), ["one"], ["number"]))
    assert [loc for loc, _ in twice] == [("robots", 1, "name")]


@pytest.mark.parametrize(
    ("first", "second", "is_refused"), [(1, 2, False), (1, 1, True), (None, None, False)]
)
def test_values_that_must_differ_may_only_both_be_unknown(first, second, is_refused):
    listed = bodies(("one", first), ("two", second))
    found = list(mismatches(listed, ["one", "two"], ["number"]))
    assert [loc for loc, _ in found] == [("robots", 1, "number")] * is_refused
    assert list(mismatches(listed, ["one", "two"])) == []


def test_the_entry_of_a_robot_is_found_by_its_name():
    assert entry(bodies(("one", 1), ("two", 2)), "two").number == 2


def in_lab(*settings):
    return select_plant(load_spec(SPEC, settings), "lab").experiment


@pytest.mark.parametrize(
    ("setting", "is_refused"),
    [("[0, 0]", True), ("[1, 0]", True), ("[0, 0.1]", False), ("[-5, 5]", False)],
)
def test_the_lower_height_comes_first(setting, is_refused):
    settings = [f"lab.limits.height_mm={setting}"]
    if is_refused:
        with pytest.raises(InvalidSpecError, match="must be two heights, with the lower one first"):
            load_spec(SPEC, settings)
    else:
        load_spec(SPEC, settings)


def test_a_lag_of_a_lab_is_for_robots_on_wheels():
    lab = in_lab("lab.lag=0.1").plant
    assert [loc for loc, _ in lab.contradictions(in_lab().setup)] == []
    without = in_lab().setup
    cells = dataclasses.replace(without, wheel_radius=None)
    assert ("lag",) in [loc for loc, _ in lab.contradictions(cells)]
    none = in_lab("lab.lag=null").plant
    assert ("lag",) not in [loc for loc, _ in none.contradictions(cells)]


def test_the_limits_of_a_lab_are_described():
    bounds = in_lab("lab.limits.stale=0.25", "lab.limits.late_steps=7").plant.bounds()
    assert bounds["all robots stop"] == "0.25 s after the last camera frame"
    assert "7 late control steps" in bounds["the trial aborts"]
    assert "motion and drift checks" not in bounds
    assert in_lab("lab.limits.observe=true").plant.bounds()["motion and drift checks"] == (
        "only report"
    )


def test_a_device_that_cannot_be_calibrated_says_so():
    actuator = in_lab().plant.actuator.model_copy()
    without = type("A", (type(actuator),), {"calibration": ""}).model_construct(**dict(actuator))
    with pytest.raises(UsageError, match="cannot be calibrated by moving robots"):
        without.calibrate(None, None, None, (), 45, print)
