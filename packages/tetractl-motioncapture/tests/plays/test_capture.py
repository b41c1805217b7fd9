"""An emulated motion-capture system: a run in which nothing goes wrong, and its process's end."""

import pytest
from support.cli import tetractl
from tetractl_emulator.lab_rehearse import rehearsed

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
@pytest.mark.parametrize(
    ("fault", "why"), [("process_ends", "the camera is gone"), ("no_frames", "no new camera frame")]
)
def test_robots_stop_when_the_process_ends_or_is_silent(folder, fault, why):
    script = f"plant.faults={{about: a test, faults: [{{fault: {fault}, at: 0.5}}]}}"
    done = tetractl(folder, *RUN, "--out", fault, "--set", script)
    assert done.returncode == 1 and why in done.stderr


def test_a_process_that_ends_before_the_robots_move_is_named(folder):
    script = "plant.faults={about: a test, faults: [{fault: process_ends, since: start, at: 0.7}]}"
    done = tetractl(folder, *RUN, "--out", "before", "--set", script)
    assert done.returncode == 1 and "the camera is gone" in done.stderr


@pytest.mark.long
def test_a_rehearsed_day_of_slow_frames_knows_which_exposure_a_frame_shows(folder):
    """Frames have no number: those that did not come must not be counted (day 13 of this seed)."""
    row = rehearsed(folder / "capture.yaml", (), 20261128, 13)
    assert row["violations"] == []
