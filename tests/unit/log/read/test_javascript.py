"""The official JavaScript reader, which Foxglove and Lichtblick are built on, reads our logs."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from support.paths import ROOT
from support.random_trials import trial, write

from tetractl.log.read.reader import content_digest

pytestmark = pytest.mark.slow  # installs packages
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
        done = subprocess.run(INSTALL, cwd=folder, capture_output=True, text=True, timeout=90)
    except subprocess.TimeoutExpired:
        pytest.skip("npm cannot install @mcap/core: it takes too long")
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.startswith("npm error")]
        pytest.skip(f"npm cannot install @mcap/core: {' '.join(errors[:2])}")
    return folder / "read.mjs"


@pytest.fixture(scope="module")
def made():
    made = trial(steps=12)
    made.samples[0].observation.poses.x[1] = np.nan
    made.samples[0].observation.valid[1] = False
    return made


@pytest.fixture(scope="module")
def log(made, tmp_path_factory):
    return write(made, tmp_path_factory.mktemp("log") / "trial.mcap")


def test_our_messages_decode_to_the_values_written(reader, made, log, tmp_path):
    done = subprocess.run(["node", reader, log], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    step = made.steps[0]
    message = found["channels"]["/controller/step"]
    assert (message["type"], message["count"]) == (".tetractl.ControllerStep", 12)
    first = message["first"]
    assert first["signals"] == step.plan.signals.tolist()
    assert first["generator"] == str(step.plan.generator)
    assert first["command"]["direction"] == step.command.direction
    assert first["observation"]["x"] == step.observation.poses.x.tolist()
    assert [item["history"] for item in first["searches"]] == [
        search.history.tolist() for search in step.plan.searches
    ]
    assert first["path_heading"] == step.plan.path[..., 2].ravel().tolist()
    assert int(message["logTime"]) == made.start.start_unix_ns + step.command.sent_ns
    assert int(message["publishTime"]) == made.start.start_unix_ns + step.observation.sampled_ns
    x = made.samples[0].observation.poses.x.tolist()
    frame = found["channels"]["/frames"]["first"]
    assert frame["x"][:3] == [x[0], None, x[2]]  # null is how JSON.stringify writes NaN
    assert frame["valid"][:3] == [True, False, True]
    shown = [item["child_frame_id"] for item in found["channels"]["/tf"]["first"]["transforms"]]
    assert set(shown) == {"robot/robot 0", "robot/robot 1", "robot/robot 2"}
    counts = {topic: channel["count"] for topic, channel in found["channels"].items()}
    steps = len(made.steps)
    assert counts.pop("/log") >= 2
    assert counts == {
        "/frames": 2,
        "/tf": 2,
        "/controller/step": steps,
        "/commands": steps + 1,
        "/scene/static": 1,
        "/scene/plan": steps,
        "/host/timing": steps,
        "/controller/estimate": sum(step.plan.estimate is not None for step in made.steps),
        "/run": 2,
        **dict.fromkeys(("/host/machine", "/host/end", "/result", "/digests"), 1),
    }
    assert found["attachments"]["spec.yaml"] == made.start.spec_text
    assert found["channels"]["/digests"]["first"]["content"] == content_digest(log)
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 0xFF
    spoilt = tmp_path / "spoilt.mcap"
    spoilt.write_bytes(data)
    done = subprocess.run(["node", reader, spoilt], capture_output=True, text=True, check=False)
    assert done.returncode != 0
