"""Modules that lie next to a spec are not run, by any process; nor is work lost with the
process that starts workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.cli import PATIENCE_S, tetractl
from support.running import child_of

pytestmark = [pytest.mark.slow, pytest.mark.long]

NAMES = (
    "base64", "ctypes", "json", "multiprocessing", "numpy", "pickle", "pkgutil", "selectors",
    "signal", "socket", "struct", "threading", "typing", "yaml",
)  # fmt: skip
CONSOLE = [str(Path(sys.executable).with_name("tetractl"))]
MODULE = [sys.executable, "-m", "tetractl"]
RUN = ("run", "first.yaml", "--trials", "2", "--jobs", "2", "--quiet", "--out", "logs")
SHORT = ("--set", "controller.time_limit=0.5")


@pytest.mark.parametrize("command", [CONSOLE, MODULE], ids=["console script", "python -m"])
def test_modules_in_the_present_folder_are_not_run(command, tmp_path):
    """Regression: a json.py next to the spec was run by `python -m tetractl` and by workers."""
    tetractl(tmp_path, "init", "first").ok()
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text("open('was-run', 'w')\nraise SystemExit(9)\n")
    done = subprocess.run(
        [*command, *RUN, *SHORT],
        cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "logs").glob("*.mcap"))) == 2
    assert not (tmp_path / "was-run").exists()


@pytest.mark.system
def test_a_run_whose_fork_server_is_killed_does_its_work(tmp_path):
    """Regression: it said "interrupted" with exit code 130, and ran nothing."""
    tetractl(tmp_path, "init", "first").ok()
    run = subprocess.Popen(
        [*CONSOLE, *RUN, *SHORT], cwd=tmp_path, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    until = time.monotonic() + PATIENCE_S
    server = None
    while server is None:
        assert run.poll() is None
        assert time.monotonic() < until
        server = child_of(run.pid, "multiprocessing.forkserver")
    os.kill(server, signal.SIGKILL)
    _, said = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 0, said
    assert len(list((tmp_path / "logs").glob("trial-00[01].mcap"))) == 2
