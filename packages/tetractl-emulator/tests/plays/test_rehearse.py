"""Tests of `tetractl lab rehearse` with a fixed seed, and with a planted defect."""

import json

import pytest
from testkit.cli import tetractl
from testkit.emulator.lab_processes import APRILTAG, SMALL, SPEC, flags
from testkit.emulator.virtual_lab import virtual_lab
from testkit.paths import EXAMPLES
from tetractl_emulator.fault_rows import CAMERA_REASONS, SEEN_REASONS
from tetractl_emulator.lab_rehearse import rehearse_day
from tetractl_emulator.rehearsal import day_plan

from tetractl.lab.guard import Guard

pytestmark = pytest.mark.slow

FEW = flags((*SMALL, "controller.time_limit=3"))
DISH = flags(  # a smaller dish, coarser pictures, and few cells
    (
        "lab.camera.um_px=4.5",
        "arena.width=2100",
        "arena.height=2100",
        "robots={choose: 2, targets: [[800, 800], [1300, 1300]], a: 4, speed: 420, seconds: 4}",
        "controller.time_limit=6",
        "controller.accept_error=40",
    )
)


def rehearse(folder, *words):
    return tetractl(folder, "lab", "rehearse", SPEC, "--out", "days", *words, *FEW)


def plan_days(monkeypatch, *faults, seed=1):
    """Let each day have these faults."""
    monkeypatch.setattr(
        day_plan, "plan_of_day", lambda *_: day_plan.DayPlan(seed, {}, list(faults))
    )


def rows(folder):
    """The records of the days that a folder holds, by their numbers."""
    texts = [file.read_text() for file in (folder / "days").glob("record-*.json")]
    records = [json.loads(text)["record"] for text in texts]
    return {record["day"]: record for record in records}


def digests(folder):
    return {day: record["digest"] for day, record in rows(folder).items()}


@pytest.mark.long
def test_days_repeat_to_the_bit_with_other_jobs_and_go_on_where_they_stopped(tmp_path):
    (tmp_path / "two").mkdir()
    done = rehearse(tmp_path, "--days", "1").ok()
    assert done.stdout.endswith("1 day, 0 violations\n")
    rehearse(tmp_path, "--days", "2").ok()
    rehearse(tmp_path / "two", "--days", "2", "--jobs", "2").ok()
    assert digests(tmp_path) == digests(tmp_path / "two")
    assert "| fault | met |" in done.stdout


@pytest.mark.long
def test_what_no_fault_causes_and_days_of_another_seed_are_refused(tmp_path):
    """Regression: each day of a spec that no trial can start was a violation."""
    done = rehearse(tmp_path, "--days", "3", "--set", "lab.limits.latency=0.001")
    assert done.returncode == 1
    assert "on arrival" in done.stderr
    assert "day" not in done.stdout
    (tmp_path / "days").mkdir()
    (tmp_path / "days" / "record-000000.json").write_text('{"of": "another spec", "record": {}}')
    again = rehearse(tmp_path, "--days", "1")
    assert again.returncode == 2


def test_a_lab_with_a_real_device_is_not_rehearsed(tmp_path):
    """Regression: the trial before the days drove the real robots, without a question."""
    half = flags(("lab.type=emulated", "lab.real=actuator"))
    with virtual_lab(tmp_path, spec=SPEC, ahead_s=0.5) as lab:
        words = ("--days", "1", *flags(lab.settings), *half)
        done = rehearse(tmp_path, *words)
        events = lab.events("run")
    assert events == []
    assert done.returncode == 2
    assert "a device of this lab is real" in done.stderr


@pytest.mark.long
def test_robots_that_take_lines_are_rehearsed_too(tmp_path):
    robots = "robots: [{name: green}, {name: blue}, {name: red}]"
    lines = f"lab.actuator={{type: twist, port: radio, {robots}}}"
    done = rehearse(tmp_path, "--first", "1", "--days", "1", "--set", lines).ok()
    assert done.stdout.endswith("1 day, 0 violations\n")
    assert rows(tmp_path)[1]["ended"] != "refused"


@pytest.mark.long
def test_a_day_of_cells_is_observed(monkeypatch):
    """Without pictures the trial ends for that reason; any other reason would be a violation."""
    pytest.importorskip("cv2")
    lost = {"kind": "no pictures", "right": SEEN_REASONS, "fault": "no_frames", "at": 6.3}
    plan_days(monkeypatch, lost)
    of_day = EXAMPLES / "tetrahymena_dish.yaml", DISH[1::2], 1, 0
    row = rehearse_day(*of_day)
    assert row["violations"] == []
    assert row["reason"].startswith("no new camera frame")


@pytest.mark.system
def test_days_of_pictures_break_nothing(tmp_path):
    pytest.importorskip("cv2")
    words = (SPEC, *flags((*APRILTAG, "controller.time_limit=3")))
    done = tetractl(tmp_path, "lab", "rehearse", *words, "--days", "1", "--out", "days").ok()
    assert done.stdout.endswith("1 day, 0 violations\n")


@pytest.mark.long
def test_a_planted_defect_is_found_and_its_day_written_and_kept(tmp_path, monkeypatch):
    """No robot is lost, and no run ends, since a robot is not tracked.

    By two jobs; what a day is does not depend on their number, as the test of digests says.

    Regression: a violation was forgotten by the same command again.
    """
    doubled = {"kind": "packets doubled", "right": "$.", "fault": "doubled_packets", "at": 0.2}
    untracked = {"kind": "untracked", "right": CAMERA_REASONS, "fault": "untracked"}
    plan_days(monkeypatch, doubled, untracked | {"robot": "green", "at": 0.6}, seed=5)
    monkeypatch.setattr(Guard, "_check_tracking", lambda self: None)
    done = rehearse(tmp_path, "--days", "2", "--jobs", "2")
    assert done.returncode == 1
    assert "1 of 2, about " in done.stderr  # a line for each day, in a pipe
    assert "driven blind: " in done.stderr
    assert done.stdout.endswith("2 days, 2 violations\n")
    script = (tmp_path / "days" / "seed-1-day-0.yaml").read_text()
    assert "untracked" in script
    assert "doubled_packets" in script
    again = rehearse(tmp_path, "--days", "1")
    assert again.stdout.endswith("1 day, 1 violation\n")


@pytest.mark.long
def test_a_run_that_keeps_memory_is_found(tmp_path, monkeypatch):
    plan_days(monkeypatch, seed=5)
    gathered = []
    check_frame = Guard.check_frame

    def keep(watch, frame):
        gathered.append([object() for _ in range(200)])
        return check_frame(watch, frame)

    monkeypatch.setattr(Guard, "check_frame", keep)
    done = rehearse(tmp_path, "--days", "2")  # the first may load modules
    assert "left behind" in done.stderr
    assert "blocks of memory" in done.stderr


@pytest.mark.long
def test_a_server_silent_from_the_start_refuses_a_run_for_its_reason(tmp_path, monkeypatch):
    """Regression: no row of the table had the reason."""
    silent = {"kind": "server silent", "fault": "no_server", "right": CAMERA_REASONS}
    silent |= {"since": "start", "at": 0.0, "for": 2.778}
    plan_days(monkeypatch, silent)
    done = rehearse(tmp_path, "--days", "1").ok()
    assert done.stdout.endswith("1 day, 0 violations\n")
    assert rows(tmp_path)[0]["reason"].startswith("no camera server answers at")


@pytest.mark.long
def test_a_day_of_streamed_cells_is_observed(tmp_path, monkeypatch):
    """A pose to which no cell can have swum ends the trial."""
    pytest.importorskip("tetractl_microscope")
    jump = {"fault": "jump", "right": CAMERA_REASONS, "robot": "first", "by": [0.6, 0.0], "at": 2.0}
    plan_days(monkeypatch, {"kind": "pose jumps", **jump})
    words = "lab", "rehearse", EXAMPLES / "tetrahymena_lab.yaml", "--days", "1"
    done = tetractl(tmp_path, *words, "--out", "days").ok()
    assert done.stdout.endswith("1 day, 0 violations\n")
    assert rows(tmp_path)[0]["reason"].startswith("first is not tracked: its pose jumped")
