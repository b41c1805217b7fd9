"""Emulated cubes: a run in which nothing goes wrong, and what stops one, in virtual time."""

import json

import pytest
import yaml
from support.cli import tetractl
from support.virtual_lab import virtual_lab
from tetractl_emulator.fault_rows import SIGHT
from tetractl_emulator.rehearsal import day
from tetractl_toio.camera import ToioCamera
from tetractl_toio.emulated.cube import CubeProgram
from tetractl_toio.messages import (
    Characteristic,
    encode_motor,
    encode_notify,
    encode_reading,
    pack,
)

from tetractl.core.clock import MILLISECOND, SECOND, VirtualClock
from tetractl.experiment.load import load_spec
from tetractl.lab.actuators.wheel_commands import Status
from tetractl.log.read.reader import read_trial

pytestmark = pytest.mark.slow
NAMES = ("green", "blue", "red")
FEW = ("--set", "controller.time_limit=2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a new spec of three cubes."""
    place = tmp_path_factory.mktemp("cubes")
    tetractl(place, "init", "cubes", "--lab", "--robots", "toio").ok()
    return place


def run(folder, out, *words):
    return tetractl(folder, "run", "cubes.yaml", "--plant", "emulated", "--out", out, *FEW, *words)


def faults(*rows):
    listed = ", ".join(f"{{{row}}}" for row in rows)
    return ("--set", f"plant.faults={{about: a test, faults: [{listed}]}}")


@pytest.mark.long
def test_a_run_reads_the_mat_and_verifies(folder):
    done = run(folder, "well", "--trials", "2", "--set", "plant.record=truth").ok()
    assert "2 of 2 trials valid" in done.stdout
    tetractl(folder, "verify", "well").ok()
    trial = read_trial(folder / "well" / "trial-000.mcap")
    assert trial.origin.value == "emulated lab"
    turned = trial.mocap[:, :, :2] / 1.36  # whole units of the mat
    assert abs(turned - turned.round()).max() < 1e-6
    assert len(set(trial.exposed_ns[-1].tolist())) > 1, "each cube has a time of its own"
    lines = (folder / "truth" / "truth-000.jsonl").read_text().splitlines()
    events = [json.loads(line) for line in lines]
    assert any(event["event"] == "command" and any(event["drives"]) for event in events)


def test_cubes_that_are_carried_read_no_mat(folder):
    with virtual_lab(None, spec=folder / "cubes.yaml") as lab:
        mat = lab.emulation.camera

        def readings():
            for cube in mat.cubes:
                cube.program.asked = True
            lab.clock.sleep_until(lab.clock.now() + SECOND // 20)
            return [*mat.last]

        assert None not in readings()
        mat.acting.carried = True
        assert readings() == [None] * len(NAMES)
        mat.acting.carried = False
        assert None not in readings()


@pytest.mark.long
@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("fault: untracked, robot: blue, at: 0.5", "blue is not tracked"),
        ("fault: no_frames, at: 0.5", "no new camera frame"),
        ("fault: unplug, at: 0.5", "is gone"),
        ("fault: 'off', robot: red, at: 0.5", "red is not tracked"),
        ("fault: wheel_stuck, robot: green, wheel: both, at: 0.2", "green "),
    ],
)
def test_a_fault_stops_the_cubes(folder, tmp_path, row, why):
    done = run(folder, tmp_path / "out", "--trials", "1", *faults(row))
    assert done.returncode == 1, done.stderr
    trial = read_trial(tmp_path / "out" / "trial-000.mcap")
    assert trial.result is not None and why in trial.result.reason, trial.result


def rehearse(folder, out, monkeypatch, fault):
    """Rehearse one day with a fault, which breaks nothing; return the day's record."""
    monkeypatch.setattr(day, "plan_of_day", lambda *_: day.DayPlan(1, {}, [fault]))
    words = ("lab", "rehearse", "cubes.yaml", "--days", "1", "--out", out)
    done = tetractl(folder, *words).ok()
    assert done.stdout.endswith("1 day, 0 violations\n")
    return json.loads((out / "record-000000.json").read_text())["record"]


@pytest.mark.long
def test_cubes_that_are_silent_from_the_start_refuse_a_run_for_a_recorded_fault(
    folder, tmp_path, monkeypatch
):
    """Regression: no report, no exposure, so the fault had no begin in the record; and no row of a
    rehearsal's table had the reason."""
    silent = {"kind": "frames lost", "right": SIGHT, "fault": "no_frames"}
    silent |= {"since": "start", "at": 0.0}
    record = rehearse(folder, tmp_path / "days", monkeypatch, silent)
    assert record["reason"] == "no message came from green, blue, red"


def test_cubes_that_report_at_one_instant_have_times_of_their_own_all_the_same(folder):
    """Regression: one that was refused got the instant for its old pose."""
    experiment = load_spec(folder / "cubes.yaml").experiment
    camera = ToioCamera(experiment.lab.camera, experiment.setup, VirtualClock())
    for i in range(3):
        camera._heard(i, Characteristic.ID, encode_reading(None), 9 * MILLISECOND)
    assert len(camera.frames()[0].exposed_ns) == 3


def test_a_cube_whose_command_has_ended_is_silent():
    """Regression: an observer took it for one that had heard a stop."""
    cube = CubeProgram()
    assert cube.status(0) == Status.SILENT
    cube.push(pack(Characteristic.MOTOR, encode_motor(50, 50, 250)), 10)
    assert (cube.status(259), cube.status(260)) == (Status.RUNNING, Status.SILENT)
    cube.push(pack(Characteristic.MOTOR, encode_motor(0, 0, 250)), 300)
    assert cube.status(310) == Status(0)


@pytest.mark.parametrize(
    ("setting", "field"),
    [
        ("lab.actuator.robots.0.cube=toio-Xxx", "lab.actuator.robots.0.cube: toio-Xxx: is not gre"),
        ("robots.2.speed=500", "lab.actuator.speed_max_mm_s: is below the speed of red"),
    ],
)
def test_a_robot_that_is_two_cubes_or_too_fast_is_an_error_of_its_field(folder, setting, field):
    answer = tetractl(folder, "validate", "cubes.yaml", "--set", setting)
    assert answer.returncode == 2
    assert field in answer.stdout


@pytest.mark.long
def test_cubes_are_calibrated_by_what_they_read_of_the_mat(folder, tmp_path):
    out = tmp_path / "calibration.yaml"
    odd = "emulation: {actuator: {robots: [{name: blue, left_gain: 0.9, right_gain: 1.1}]}}"
    words = ("--plant", "emulated", "--robot", "blue", "-o", out)
    odd = ("--set", f"plant.faults={{about: odd gains, {odd}}}")
    tetractl(folder, "lab", "calibrate", "cubes.yaml", *words, *odd).ok()
    (blue,) = yaml.safe_load(out.read_text())["actuator"]["robots"]
    assert blue["left_gain"] == pytest.approx(0.9, rel=0.04)
    assert blue["right_gain"] == pytest.approx(1.1, rel=0.04)
    assert blue["radius_mm"] == pytest.approx(13.3, rel=0.04)
    run(folder, tmp_path / "out", "--trials", "1", "--set", f"lab.calibration={out}").ok()


def test_a_cube_obeys_until_its_command_ends_and_ignores_what_it_should():
    cube = CubeProgram()
    cube.push(pack(Characteristic.MOTOR, encode_motor(20, -7, 250)), 1000)
    assert (cube.wheels(1000), cube.wheels(1249), cube.wheels(1250)) == ((20, 0), (20, 0), (0, 0))
    cube.push(pack(Characteristic.MOTOR, encode_motor(20, 20, 250)), 2000)
    cube.push(pack(Characteristic.MOTOR, b"\x02\x01\x01\x14\x01\x01\x14\x19"), 2010)
    assert cube.wheels(2100) == (20, 20)
    cube.set_battery(4400)
    cube.push(pack(Characteristic.BATTERY), 0)
    cube.push(pack(Characteristic.CONFIGURATION, encode_notify(10)), 0)
    answers = cube.take_reply(0)
    assert answers.startswith(pack(Characteristic.BATTERY, b"\x00"))
    assert answers.endswith(pack(Characteristic.CONFIGURATION, b"\x98\x00\x00"))
    assert cube.notifies and cube.take_reply(0) == b""
