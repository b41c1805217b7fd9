"""Tests that the benchmarks which print tables of the docs run, at their smallest size."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import mrclam
import pytest

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
SMALLEST = [
    ("disturbed", "--trials", "1", "--part", "hurting", "--only", "none of these"),
    ("unmodelled", "--trials", "1", "--world", "base", "anywhere"),
    pytest.param(("many_robots", "--trials", "1"), marks=pytest.mark.release),
    ("solver", "--quick", "--only", "a,b"),
]


@pytest.mark.parametrize("words", SMALLEST, ids=" ".join)
def test_a_benchmark_prints_its_table(words, monkeypatch, capsys):
    """Regression: three of these had followed no change of the controller's arguments."""
    name, *arguments = words
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    import_module(name).main()  # in this process, which loads once what is compiled
    assert capsys.readouterr().out.count("\n|") >= 3


def test_recordings_of_robots_that_drive_are_read(tmp_path):
    """Two robots as in a set of MRCLAM: they turn to and fro, 0.1 s after they are sent it."""
    for robot in (1, 2):
        sent = [f"{k / 20} 0.1 {-0.2 if (k + 2) // 20 % 2 == 0 else 0.2}" for k in range(120)]
        lines = [f"{k / 50} {k / 500} 0 {0.2 * abs(k / 50 % 2 - 1)}" for k in range(300)]
        (tmp_path / f"Robot{robot}_Odometry.dat").write_text("\n".join(["# t v w", *sent]))
        (tmp_path / f"Robot{robot}_Groundtruth.dat").write_text("\n".join(["# t x y", *lines]))
    script = Path(__file__).parents[1] / "mrclam.py"
    done = subprocess.run([sys.executable, script, tmp_path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "MRCLAM, 2 runs of real robots" in done.stdout and "turning lag s" in done.stdout
    lost = subprocess.run([sys.executable, script, tmp_path / "no"], capture_output=True, text=True)
    assert lost.returncode == 1 and "error: " in lost.stderr


def test_a_run_of_mrclam_is_read_from_its_first_command_on(tmp_path):
    (tmp_path / "Robot1_Groundtruth.dat").write_text("9.5 0 0 0\n10.5 1 0 0\n")
    (tmp_path / "Robot1_Odometry.dat").write_text("10 0.1 0\n10 0.1 0\n11 0.2 0.3\n")
    poses, sent = mrclam.read_from_first_command(tmp_path, 1)
    assert poses[:, 0].tolist() == [-0.5, 0.5]
    assert sent.tolist() == [[0, 0.1, 0], [1, 0.2, 0.3]]
