"""Tests of the strict schema of fault scripts; every shipped script must be valid."""

import pytest
from testkit.emulator.lab_processes import camera_of, emulated
from testkit.emulator.scripts import load_script
from testkit.paths import SCRIPTS
from testkit.schema_errors import without_words
from tetractl_emulator.script import DeviceClasses, Script, parse_script

from tetractl.core.errors import AbortError, SpecError

FOLDER = SCRIPTS
SCRIPTS = sorted(FOLDER.rglob("*.yaml"))


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_shipped_scripts_are_valid_and_say_what_they_expect(path):
    script = load_script(path, camera_of(path))
    assert script.expect is not None
    named = {name for fault in script.faults for name in fault.names()}
    assert named <= {"green", "blue", "red"}


def test_every_fault_has_a_script():
    used = {fault.fault for path in FOLDER.glob("*.yaml") for fault in load_script(path).faults}
    assert used == set(DeviceClasses.of_types("optitrack", "m3pi-xbee").faults) - {"mark"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("faults: [{fault: nan, robot: green, speed: 3}]", "speed: unknown key"),
        ("faults: [{fault: nam, robot: green}]", "the field fault must be one of no_server"),
        ("faults: [{fault: {a: 1}, at: 1}]", "the field fault must be one of"),
        ("faults: [{fault: [radio], at: 1}]", "the field fault must be one of"),
        ("faults: [{fault: 1, at: 1}]", "the field fault must be one of"),
        ("faults: [{fault: null, at: 1}]", "the field fault must be one of"),
        ("faults: [{fault: nan}]", "faults.0.robot: is missing"),
        ("faults: [{fault: unplug, robot: green}]", "robot: unknown key"),
        ("faults: [{fault: unplug, at: -1}]", "must be at least 0"),
        ("faults: [{fault: unplug, at: .inf}]", "finite"),
        ("faults: [{fault: unplug, since: tomorrow}]", "'start', 'client', 'run' or 'stop'"),
        ("faults: [{fault: jump, robot: green, by: [1]}]", "is missing"),
        ("faults: 3", "must be a list"),
        ("faults: [{fault: picture, by: 250}]", "must be a list of 2 numbers"),
        ("faults: [{fault: jump, robot: green, by: 250}]", "must be a list of 2 numbers"),
        ("expect: 3", "must be a mapping"),
        ("emulation: {camera: {version: 2.10}}", "if 2.10 is meant, put it in quotes"),
        ("emulation: {camera: {version: '2.4'}}", "must match"),
        ("emulation: {version: '4.1'}", "version: unknown key"),
        ("emulation: {actuator: {version: '4.1'}}", "version: unknown key; known here: "),
        ("faults: [{fault: unplug, at: 1, at: 2}]", "given twice"),
        ("emulation: !!python/object:os.system {}", "line|tag"),
    ],
)
def test_a_wrong_script_is_refused_with_its_place(text, message):
    with pytest.raises(SpecError, match=message) as caught:
        parse_script("about: x\n" + text, "script.yaml")
    assert str(caught.value).startswith("script.yaml:2:")


def test_a_script_for_another_spec_is_refused(tmp_path):
    with pytest.raises(SpecError, match="names pink, which is not a robot"):
        emulated(tmp_path, script="faults: [{fault: off, robot: pink}]")


def test_every_error_that_a_script_can_cause_has_words():
    assert without_words(Script) == set()


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        ("cv2", AbortError),
        ("tetractl_microscope", AbortError),
        ("tetractl_microscope.coils.driver", AbortError),
        ("tetractl_of_somebody_else", ModuleNotFoundError),
    ],
)
def test_only_the_microscopes_software_is_named_as_missing(monkeypatch, missing, expected):
    def load(name):
        raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)

    monkeypatch.setattr("tetractl_emulator.script.EMULATED_CAMERAS.load", load)
    with pytest.raises(expected) as error:
        DeviceClasses.of_types("apriltag", "m3pi-xbee")
    if expected is AbortError:
        assert "emulating apriltag needs tetractl-microscope" in str(error.value)


@pytest.mark.parametrize("types", [("camera", "m3pi-xbee"), ("optitrack", "wings")])
def test_a_type_that_cannot_be_emulated_comes_with_those_that_can(types):
    with pytest.raises(SpecError, match="cannot be emulated") as error:
        DeviceClasses.of_types(*types)
    assert ("optitrack" if types[0] == "camera" else "m3pi-xbee") in error.value.hint
