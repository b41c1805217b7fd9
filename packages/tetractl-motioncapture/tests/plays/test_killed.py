"""Tests of a run in real time whose camera process is killed.

The process is real, but a fake library in it shows robots. The robots are emulated, and what the
library shows moves with them.
"""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from testkit.cli import tetractl
from testkit.running import child_of

from tetractl.core.clock import SECOND, MonotonicClock, wait_for
from tetractl.core.commands import Stop
from tetractl.log.read.reader import read_trial

pytestmark = [pytest.mark.slow, pytest.mark.system]
BEGUN = 60_000  # bytes of a log in which robots drive
LIBRARY = """
import time

class Body:
    rotation = type("Quaternion", (), {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0})

    def __init__(self, y):
        self.position = 0.3, y, 0.0

class Capture:
    rigidBodies = {"green": Body(0.4), "blue": Body(0.8), "red": Body(1.2)}

    def waitForNextFrame(self):
        time.sleep(0.01)

def connect(system, options):
    return Capture()
"""
RUN = ("run", "capture.yaml", "--plant", "emulated", "--trials", "1", "--yes", "--quiet")
HALF = ("--set", "plant.real=camera", "--set", "plant.record=true_events")
LONG = ("--set", "controller.deadline=60", "--set", "controller.time_limit=60")
# steps and commands that a busy host delays end no run
LATE = ("--set", "lab.limits.late_steps=100000", "--set", "lab.limits.wheel_error=1")


def test_robots_stop_when_the_process_is_killed(tmp_path, monkeypatch):
    tetractl(tmp_path, "init", "capture", "--lab", "--camera", "motioncapture", "--robots", "twist")
    (tmp_path / "motioncapture.py").write_text(LIBRARY)
    path = filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    command = str(Path(sys.executable).with_name("tetractl"))
    words = [command, *RUN, *HALF, *LONG, *LATE, "--out", "logs"]
    run = subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    record = tmp_path / "true_events" / "truth-000.jsonl"

    def moves():
        parts = (tmp_path / "logs").glob("trial-000.mcap*")
        return run.poll() is not None or any(part.stat().st_size > BEGUN for part in parts)

    has_moved = wait_for(MonotonicClock(), moves, 120)
    is_running = run.poll() is None
    assert has_moved and is_running, run.communicate()
    bridge = child_of(run.pid, "tetractl_motioncapture.bridge")
    assert bridge is not None, run.communicate()
    os.kill(bridge, signal.SIGKILL)
    _, said = run.communicate(timeout=120)
    assert run.returncode == 1 and "the process that reads the camera has stopped: Killed" in said
    trial = read_trial(tmp_path / "logs" / "trial-000.mcap")
    driven = [command.sent_ns for command in trial.commands if command.action != Stop()]
    assert max(driven) - trial.received_ns[-1] < 0.15 * SECOND  # stale, and a tick of a busy host
    events = map(json.loads, record.read_text().splitlines())
    robots = {e["name"]: e["moving"] for e in events if e["event"] == "robot"}
    assert robots == dict.fromkeys(("green", "blue", "red"), False)
