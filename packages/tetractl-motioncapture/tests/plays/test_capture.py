"""Tests of an emulated motion-capture system: a normal run, and the end of its process."""

import pytest
from testkit.cli import tetractl
from testkit.emulator.silent_labs import flagged_trials
from tetractl_emulator.lab_rehearse import rehearse_day

pytestmark = pytest.mark.slow
RUN = ("run", "capture.yaml", "--plant", "emulated", "--trials", "1")
RUN += ("--set", "controller.time_limit=2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a new spec of motion capture."""
    place = tmp_path_factory.mktemp("capture")
    words = ("--lab", "--camera", "motioncapture", "--robots", "twist")
    tetractl(place, "init", "capture", *words).ok()
    return place


@pytest.mark.long
def test_a_run_is_valid_and_verifies(folder):
    assert "1 of 1 trials valid" in tetractl(folder, *RUN, "--out", "well").ok().stdout
    assert "bit-identical" in tetractl(folder, "verify", "well").ok().stdout


@pytest.mark.long
def test_no_trial_of_a_new_lab_is_flagged(folder):
    assert flagged_trials(folder / "capture.yaml", folder / "silent") == []


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        pytest.param("process_ends, at: 0.5", "the camera is gone", marks=pytest.mark.long),
        pytest.param("no_frames, at: 0.5", "no new camera frame", marks=pytest.mark.long),
        ("process_ends, since: start, at: 0.7", "the camera is gone"),
    ],
)
def test_a_process_that_ends_or_is_silent_is_named_before_and_while_robots_move(
    folder, tmp_path, fault, why
):
    script = f"plant.faults={{about: a test, faults: [{{fault: {fault}}}]}}"
    done = tetractl(folder, *RUN, "--out", tmp_path / "out", "--set", script)
    assert done.returncode == 1 and why in done.stderr


@pytest.mark.long
def test_a_rehearsed_day_of_slow_frames_knows_which_exposure_a_frame_shows(folder):
    """Frames have no number: those that did not come must not be counted (day 13 of this seed)."""
    row = rehearse_day(folder / "capture.yaml", (), 20261128, 13)
    assert row["violations"] == []
