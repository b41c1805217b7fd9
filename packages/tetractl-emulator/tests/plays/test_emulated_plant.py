"""Tests of `--plant emulated`, the emulated lab in virtual time, started as a user would."""

import contextlib
import json
import re
from unittest import mock

import numpy as np
import pytest
from testkit.cli import tetractl
from testkit.emulator.lab_processes import SMALL as FEW_STEPS
from testkit.emulator.lab_processes import SPEC, flags
from testkit.paths import EXAMPLES, ROOT
from tetractl_emulator import firmware

from tetractl.core.commands import Steer, Stop
from tetractl.core.protocols import Health, LabSupervision
from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

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
    spec.write_text(text.replace("/dev/ttyUSB0", str(tmp_path / "radio")))
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
    assert "three_m3pi.yaml: this spec has no lab" in done.stderr
    with mock.patch.object(firmware, "compiler", lambda: None):
        firmware.load.cache_clear()
        with mock.patch.object(firmware, "cache_folder", lambda: tmp_path):
            done = run(tmp_path, "out", *SMALL)
    assert done.returncode == 1
    assert "error: no C compiler was found; emulated devices need one" in done.stderr
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


@needs_compiler
def test_a_lab_of_multicast_cameras_is_checked_without_a_port_or_an_address(tmp_path):
    done = tetractl(tmp_path, "lab", "check", SPEC, "--plant", "emulated", "--json").ok()
    printed = json.loads(done.stdout)
    assert printed["ready"]
    assert all(robot["answers"] for robot in printed["robots"])


@pytest.mark.long
@needs_compiler
def test_late_steps_between_punctual_ones_do_not_end_a_trial(tmp_path):
    script = tmp_path / "busy.yaml"
    busy = "{fault: busy, seconds: 0.07, every: 2}"
    script.write_text(f"about: every second plan is late\nfaults: [{busy}]\n")
    few = flags(("controller.time_limit=1.5", "controller.deadline=60", f"plant.faults={script}"))
    run(tmp_path, "busy", "--trials", "1", *few).ok()
    log = read_trial(tmp_path / "busy" / "trial-000.mcap")
    waits_ns = [step.command.sent_ns - step.observation.received_ns for step in log.steps]
    late = [wait_ns for wait_ns in waits_ns if wait_ns > 50_000_000]
    assert len(late) > 5  # as would end it in a row


def test_a_log_is_not_run_again_with_files_of_the_present_folder(tmp_path):
    """Regression: the calibration and the script of faults that were read belonged to others."""
    (tmp_path / "spec").mkdir()
    spec = tmp_path / "spec" / "spec.yaml"
    text = SPEC.read_text()
    spec.write_text(text.replace("\nlab:\n", "\nlab:\n  calibration: calibration.yaml\n"))
    tetractl(tmp_path, "run", spec, "--trials", "1", "-q", "--out", "one", *SMALL).ok()
    swapped = "measured: 2026-01-01\nactuator: {robots: [{name: green, swap: true}]}\n"
    (tmp_path / "calibration.yaml").write_text(swapped)
    (tmp_path / "faults.yaml").write_text("about: of another lab\nfaults: []\n")
    words = ("rerun", "one/trial-000.mcap", "--plant", "emulated", "--dry-run")
    done = tetractl(tmp_path, *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        "error: lab.calibration: calibration.yaml: this path is relative to the folder"
        in done.stderr
    )
    without = flags(("lab.calibration=null",))
    tetractl(tmp_path, *words, *without).ok()
    script = flags(("lab.type=emulated", "lab.faults=faults.yaml"))
    done = tetractl(tmp_path, *words, *without, *script)
    assert (done.returncode, done.stdout) == (2, "")
    assert "error: lab.faults: faults.yaml: this path is relative to the folder" in done.stderr


@needs_compiler
def test_a_drive_that_a_stop_follows_within_the_same_step_of_the_clock_is_recorded(tmp_path):
    """Regression: a full disk stopped robots as they set off again, and a rehearsal saw them driven
    after the end of the run, which it took the rest before for.
    """
    spec = select_plant(load_spec(SPEC), "emulated").experiment
    section = spec.plant.model_copy(update={"record": str(tmp_path)})
    of_trial = np.random.SeedSequence(1, spawn_key=(0,))
    plant = section.build(spec.setup, section.clock(), of_trial, LabSupervision())
    with contextlib.closing(plant):
        plant.open()
        plant.observe()
        plant.send(Steer(0.0))
        plant.send(Stop())
    lines = (tmp_path / "truth-000.jsonl").read_text().splitlines()
    events = [json.loads(line) for line in lines]
    states = [event["state"] for event in events if event["event"] == "guard"]
    assert states == ["preflight", "run", "ready"]
