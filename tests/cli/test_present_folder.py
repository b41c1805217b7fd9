"""Tests that no process runs modules that lie next to a spec, and that no work is lost."""

import subprocess
import sys
from pathlib import Path

import pytest
from testkit.cli import PATIENCE_S, tetractl

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
