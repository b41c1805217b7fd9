"""Tests of tetractl without Unix: simulations, tables and reports work, the rest says why not."""

import subprocess
import sys

import pytest
from testkit import without_unix
from testkit.cli import PATIENCE_S

pytestmark = [pytest.mark.slow, pytest.mark.long]


def on_windows(folder, *commands):
    command = [sys.executable, without_unix.__file__, *commands]
    done = subprocess.run(
        command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=PATIENCE_S,
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    return done


def test_simulations_tables_and_reports_need_no_unix(tmp_path):
    """Regression: `init first; run first.yaml` ended in a traceback without fcntl."""
    done = on_windows(
        tmp_path,
        "init first",
        "run first.yaml --trials 1 --set controller.time_limit=0.5 --out logs",
        "stats logs",
        "report logs -o report.html",
        "export logs -o tables",
        "replay logs/trial-000.mcap",
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    "command",
    [
        "lab check shelf.yaml",
        "lab emulate shelf.yaml",
        "run shelf.yaml --plant emulated --trials 1",
    ],
)
def test_a_lab_without_unix_is_one_line(command, tmp_path):
    done = on_windows(tmp_path, "init shelf --lab", command)
    assert (tmp_path / "shelf.yaml").exists()
    assert done.returncode == 2
    assert (
        "error: this command does not run on Windows, because Python has no module '" in done.stderr
    )
