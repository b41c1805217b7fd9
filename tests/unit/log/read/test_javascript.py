"""Tests that the official JavaScript reader, used by Foxglove and Lichtblick, reads our logs."""

import base64
import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from testkit.paths import ROOT
from testkit.random_trials import trial, write

from tetractl.log.format.packed_columns import unpack_columns

pytestmark = pytest.mark.system  # installs packages
SOURCE = ROOT / "tests" / "js"
INSTALL = (
    *("npm", "install", "--ignore-scripts", "--no-package-lock", "--no-audit", "--no-fund"),
    *("--fetch-retries=0", "--fetch-timeout=20000"),
)


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """tests/js with its packages, in a folder of its own."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("js") / "js"
    shutil.copytree(SOURCE, folder, ignore=shutil.ignore_patterns("node_modules"))
    try:
        subprocess.run(INSTALL, cwd=folder, capture_output=True, timeout=90, check=True)
    except subprocess.SubprocessError as error:
        pytest.skip(f"npm cannot install @mcap/core: {error}")
    return folder / "read.mjs"


@pytest.fixture(scope="module")
def random_trial():
    """A trial whose first frame lacks robot 1."""
    random_trial = trial(steps=12)
    samples, _ = random_trial.rounds[0]
    observation = samples[0].observation
    x = observation.poses.x.copy()
    x[1] = np.nan
    valid = observation.valid.copy()
    valid[1] = False
    lost = replace(observation, poses=replace(observation.poses, x=x), valid=valid)
    samples[0] = replace(samples[0], observation=lost)
    return random_trial


@pytest.fixture(scope="module")
def log(random_trial, tmp_path_factory):
    return write(random_trial, tmp_path_factory.mktemp("log") / "trial.mcap")


@pytest.fixture(scope="module")
def decoded(reader, log):
    """What the JavaScript reader prints of the log."""
    done = subprocess.run(["node", reader, log], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_a_control_step_decodes_to_the_values_written(decoded, random_trial):
    step = random_trial.steps[0]
    message = decoded["channels"]["/controller/step"]
    assert (message["type"], message["count"]) == (".tetractl.ControllerStep", 12)
    first = message["first"]
    assert first["signals"] == step.plan.signals.tolist()
    assert first["command"]["direction"] == step.command.direction
    assert [item["history"] for item in first["searches"]] == [
        search.history.tolist() for search in step.plan.searches
    ]
    start_unix_ns = random_trial.start.start_unix_ns
    assert int(message["logTime"]) == start_unix_ns + step.command.sent_ns
    assert int(message["publishTime"]) == start_unix_ns + step.observation.sampled_ns


def test_camera_frames_unpack_to_the_poses_measured(decoded, random_trial):
    frames = decoded["channels"]["/frames"]["first"]
    numbers = unpack_columns(base64.b64decode(frames["poses"]), 3 * 3, "<f8")  # 3 of each robot
    measured = random_trial.samples[0].observation.poses.x
    assert np.array_equal(numbers[0, ::3], measured, equal_nan=True)


def test_a_flipped_byte_is_refused(reader, log, tmp_path):
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 0xFF
    spoilt = tmp_path / "spoilt.mcap"
    spoilt.write_bytes(data)
    assert subprocess.run(["node", reader, spoilt], capture_output=True).returncode != 0
