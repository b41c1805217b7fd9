"""The official JavaScript reader, which Foxglove and Lichtblick are built on, reads our logs."""

import base64
import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from support.paths import ROOT
from support.random_trials import trial, write

from tetractl.log.format.packed_columns import unpack_columns
from tetractl.log.read.salvage import scan

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


def test_our_messages_decode_to_the_values_written(reader, tmp_path):
    made = trial(steps=12)
    samples, _ = made.rounds[0]
    seen = samples[0].observation
    x, valid = seen.poses.x.copy(), seen.valid.copy()
    x[1], valid[1] = np.nan, False
    seen = replace(seen, poses=replace(seen.poses, x=x), valid=valid)
    samples[0] = replace(samples[0], observation=seen)
    log, step = write(made, tmp_path / "trial.mcap"), made.steps[0]
    done = subprocess.run(["node", reader, log], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    message = found["channels"]["/controller/step"]
    assert (message["type"], message["count"]) == (".tetractl.ControllerStep", 12)
    first = message["first"]
    assert first["signals"] == step.plan.signals.tolist()
    assert first["command"]["direction"] == step.command.direction
    assert [item["history"] for item in first["searches"]] == [
        search.history.tolist() for search in step.plan.searches
    ]
    assert int(message["logTime"]) == made.start.start_unix_ns + step.command.sent_ns
    assert int(message["publishTime"]) == made.start.start_unix_ns + step.observation.sampled_ns
    x = made.samples[0].observation.poses.x.tolist()
    frame = found["channels"]["/frames"]["first"]
    poses = unpack_columns(base64.b64decode(frame["poses"]), 9, "<f8")
    assert np.array_equal(poses[0, ::3], x, equal_nan=True)
    shown = [item["child_frame_id"] for item in found["channels"]["/tf"]["first"]["transforms"]]
    assert set(shown) == {"robot/robot 0", "robot/robot 1", "robot/robot 2"}
    counts = {topic: channel["count"] for topic, channel in found["channels"].items()}
    assert counts == {topic: len(all_) for topic, all_ in scan(log).by_topic.items()}
    assert found["attachments"]["spec.yaml"] == made.start.spec_text
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 0xFF
    spoilt = tmp_path / "spoilt.mcap"
    spoilt.write_bytes(data)
    assert subprocess.run(["node", reader, spoilt], capture_output=True).returncode != 0
