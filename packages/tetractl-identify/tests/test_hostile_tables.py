"""Tests that broken or huge tables are refused with one line, within limits of time and memory."""

import os

import pytest
from testkit.cli import tetractl
from tetractl_identify import csv_tracks, passes

from tetractl.tools.table import csv_rows

pytestmark = pytest.mark.slow


def refused(done, *words, code=2):
    assert done.returncode == code, done
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    assert all(word in line for word in words), line
    assert done.stdout == ""


def poses(rows):
    return "time_s,robot,x_mm,y_mm,heading_rad\n" + "".join(rows)


COMMANDS = "time_s,direction_rad\n0,0\n1,1\n2,0\n"


BIG = {
    "robots": (poses(f"{i},r{i},0,0,0\n" for i in range(1200)), "more than 1000 robots"),
    "poses": (poses(f"{i},r{i % 60},0,0,0\n" for i in range(600)), "60 robots at 600 times"),
    "rows": (poses("0,r,0,0,0\n" for _ in range(2500)), "2000 rows"),
    "a row": ("time_s," * 20_000 + "\n", "65536 characters in a row"),
    "an open quote": (
        poses(['0,r,"0,0,0\n'] * 2),
        "x_mm: '0,0,0' is not a number of",
    ),
    "an infinite time": (
        poses(["0,r,0,0,0\n", "inf,r,0,0,0\n"]),
        "'inf' is not a number of at most 1e+19",
    ),
}


@pytest.mark.parametrize("name", BIG)
def test_a_table_is_read_within_bounds(name, tmp_path, monkeypatch):
    """Regression: 20,000 rows of as many robots took 9.5 GB."""
    monkeypatch.setattr(csv_rows, "CSV_ROWS_MAX", 2000)
    monkeypatch.setattr(csv_tracks, "POSES_MAX", 30_000)
    text, why = BIG[name]
    (tmp_path / "poses.csv").write_text(text)
    (tmp_path / "commands.csv").write_text(COMMANDS)
    refused(tetractl(tmp_path, "identify", "poses.csv", "commands.csv"), "poses.csv", why)


def test_directions_between_two_frames_are_bounded(tmp_path, monkeypatch):
    """Each takes time in every pass of the filter."""
    monkeypatch.setattr(passes, "DIRECTIONS_MAX", 50)
    (tmp_path / "poses.csv").write_text(poses(f"{i / 10},r,{i},0,0\n" for i in range(60)))
    sent = "".join(f"{i / 1000},{i % 2}\n" for i in range(100))
    (tmp_path / "commands.csv").write_text(f"time_s,direction_rad\n{sent}5,0\n")
    done = tetractl(tmp_path, "identify", "poses.csv", "commands.csv")
    refused(
        done, "directions were sent between two successive frames, too many for an identification"
    )


@pytest.mark.long
def test_what_determines_nothing_is_told(tmp_path):
    """Regression: a singular matrix was a traceback."""
    (tmp_path / "poses.csv").write_text(poses(f"{i / 10},r,{i},0,0\n" for i in range(40)))
    (tmp_path / "commands.csv").write_text("time_s,direction_rad\n0,0\n0.1,0\n3.9,0\n")
    done = tetractl(tmp_path, "identify", "poses.csv", "commands.csv")
    assert done.returncode in (0, 2), done


@pytest.mark.parametrize("kind", ["missing", "fifo"])
def test_a_file_that_is_missing_or_no_regular_one_is_bad_usage(tmp_path, kind):
    if kind == "fifo":
        os.mkfifo(tmp_path / "x")
    done = tetractl(tmp_path, "identify", "x")
    assert done.returncode == 2
    assert done.stderr.startswith("error: x: ")
    assert ("not a regular file" in done.stderr) == (kind == "fifo")
