"""Tests with an emulated tracker and emulated robots of a ROS 2 graph, in virtual time."""

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from testkit.cli import tetractl
from testkit.emulator.silent_labs import flagged_trials

pytestmark = pytest.mark.slow
RUN = ("run", "graph.yaml", "--plant", "emulated", "--trials", "1")
RUN += ("--set", "controller.time_limit=2")
KINDS = ("NamedPoseArray", "PoseStamped", "Odometry")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a new spec of a ROS 2 lab."""
    place = tmp_path_factory.mktemp("graph")
    tetractl(place, "init", "graph", "--lab", "--camera", "ros2", "--robots", "ros2").ok()
    return place


@pytest.mark.long
def test_a_run_is_valid_and_verifies(folder):
    assert "1 of 1 trials valid" in tetractl(folder, *RUN, "--out", "well").ok().stdout
    assert "bit-identical" in tetractl(folder, "verify", "well").ok().stdout


@pytest.mark.long
def test_no_trial_of_a_new_lab_is_flagged(folder):
    assert flagged_trials(folder / "graph.yaml", folder / "silent") == []


@pytest.mark.long
@pytest.mark.parametrize("message", KINDS)
def test_every_kind_of_poses_drives_a_trial(folder, message):
    topic = "null" if message == "NamedPoseArray" else "/{body}/p"
    kind = ("--set", f"lab.camera.message={message}", "--set", f"lab.camera.topic={topic}")
    done = tetractl(folder, *RUN, *kind, "--out", f"out-{message}").ok()
    assert "1 of 1 trials valid" in done.stdout
    flags = [line for line in done.stdout.splitlines() if line.startswith("flagged")]
    assert flags in ([], ["flagged: trial-000: did not end in 2 s"])


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("no_frames, at: 0.5", "no new camera frame"),
        pytest.param("freeze, at: 0.5", "camera frame", marks=pytest.mark.long),
        pytest.param("untracked, robot: green, at: 0.5", "green", marks=pytest.mark.long),
        pytest.param("off, robot: blue, at: 0.5", "blue", marks=pytest.mark.long),
    ],
)
def test_what_goes_wrong_is_named(folder, tmp_path, fault, why):
    script = f"plant.faults={{about: a test, faults: [{{fault: {fault}}}]}}"
    done = tetractl(folder, *RUN, "--out", tmp_path / "out", "--set", script)
    assert done.returncode == 1 and why in done.stderr
