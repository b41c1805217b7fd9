"""`--plant emulated`: the emulated lab in virtual time, as a user runs it."""

import re
from unittest import mock

import pytest
from support.cli import tetractl
from support.lab_processes import SMALL as FEW_STEPS
from support.lab_processes import SPEC, flags
from support.paths import EXAMPLES, ROOT
from tetractl_emulator import firmware

from tetractl.core.protocols import Health
from tetractl.log.read.reader import content_digest, read_result, read_trial

pytestmark = pytest.mark.slow

needs_compiler = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")
DISH = EXAMPLES / "tetrahymena_dish.yaml"
LINES = "{type: twist, port: p, robots: [{name: green}, {name: blue}, {name: red}]}"
OF_THE_CONTROLLER = [setting for setting in FEW_STEPS if not setting.startswith("lab")]
SMALL = flags((*OF_THE_CONTROLLER, "controller.deadline=60"))


def run(folder, out, *words, spec=SPEC):
    return tetractl(folder, "run", spec, "--plant", "emulated", "-q", "--out", out, *words)


def digests(folder):
    return [content_digest(path) for path in sorted(folder.glob("*.mcap"))]


@pytest.mark.long
@needs_compiler
def test_a_seed_repeats_in_any_number_of_processes_and_nobody_is_asked(tmp_path):
    for out, jobs in (("one", "1"), ("two", "2")):
        done = run(tmp_path, out, "--trials", "2", "--seed", "2", "--jobs", jobs, *SMALL).ok()
    first = digests(tmp_path / "one")
    second = digests(tmp_path / "two")
    assert first == second
    assert len(set(first)) == 2  # each trial has noise of its own
    log = read_trial(tmp_path / "one" / "trial-000.mcap")
    assert log.start.plant.kind == "emulated"
    assert log.origin.value == "emulated lab"
    assert log.result is not None
    assert all(0.0 < error < 1.0 for error in log.result.verdict.turn_std)
    assert len(log.result.verdict.turn) == 3  # rates that are known, of wheels as in the spec
    again = ("rerun", "one/trial-001.mcap", "--plant", "emulated", "--out", "again")
    done = tetractl(tmp_path, *again).ok()
    assert f"the content digests agree: {first[1]}" in done.stderr
    done = tetractl(tmp_path, "verify", "one").ok()


@needs_compiler
def test_a_spec_of_the_emulated_plant_drives_the_lab_only_where_that_is_asked_for(tmp_path):
    spec = tmp_path / "spec.yaml"
    text = SPEC.read_text().replace("\nlab:\n", "\nlab:\n  type: emulated\n")
    spec.write_text(text)
    done = tetractl(tmp_path, "run", spec, "--plant", "lab", "--yes")
    assert done.returncode == 1
    assert "there is no such port" in done.stderr


@pytest.mark.long
def test_an_emulated_plant_says_so_for_a_camera_that_does_not(tmp_path, monkeypatch):
    """A camera of one's own need not say that it is emulated: the plant knows."""
    silent = "tetractl.lab.cameras.optitrack.camera.OptitrackCamera.check"
    monkeypatch.setattr(silent, lambda camera: Health())
    sets = (*SMALL, *flags((f"lab.actuator={LINES}",)))
    check = ("lab", "check", SPEC, "--plant", "emulated", *sets)
    run_output = run(tmp_path, "out", "--trials", "1", *sets).ok().stdout
    check_output = tetractl(tmp_path, *check).ok().stdout
    assert "three-m3pi-lab, emulated lab: " in run_output
    assert read_result(tmp_path / "out" / "trial-000.mcap").origin.value == "emulated lab"
    assert "emulated: camera, actuator" in check_output
    of_reading = [
        tetractl(tmp_path, *words).ok().stdout
        for words in (("stats", "out", "--full"), ("info", "out"), ("verify", "out"))
    ]
    outputs = [run_output, check_output, *of_reading]
    lab_without_emulated = re.compile(r"(?<![\w-])(?<!emulated )lab\b(?!:)")
    assert [output for output in outputs if lab_without_emulated.search(output)] == []
    words = ("lab", "calibrate", SPEC, "--plant", "emulated", "--robot", "green", *sets)
    done = tetractl(tmp_path, *words).ok()
    assert "emulated: camera, actuator" in (tmp_path / "calibration.yaml").read_text()
    assert "calibration.yaml, of an emulated camera and actuator" in done.stderr


def test_what_cannot_be_emulated_is_one_line(tmp_path):
    done = run(tmp_path, "out", spec=ROOT / "experiments" / "three_m3pi.yaml")
    assert done.returncode == 2
    assert "three_m3pi.yaml: has no lab" in done.stderr
    with mock.patch.object(firmware, "compiler", lambda: None):
        firmware.load.cache_clear()
        with mock.patch.object(firmware, "cache_folder", lambda: tmp_path):
            done = run(tmp_path, "out", *SMALL)
    assert done.returncode == 1
    assert "error: no C compiler found; emulated devices run the compiled firmware" in done.stderr
    lacking = mock.Mock(
        side_effect=ModuleNotFoundError(
            "No module named 'tetractl_microscope'", name="tetractl_microscope"
        )
    )
    with mock.patch("tetractl_emulator.script.EMULATED_CAMERAS.load", lacking):
        done = run(tmp_path, "out", spec=DISH)
    assert done.returncode == 1
    assert "error: emulating cells needs tetractl-microscope, which is not installed" in done.stderr
    assert "hint: pip install ./packages/tetractl-microscope" in done.stderr
