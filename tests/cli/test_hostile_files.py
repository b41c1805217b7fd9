"""Tables, rows, specs and names from anybody: one line, within bounds, at every command."""

import pytest
from support import random_trials
from support.cli import tetractl
from support.mutate import rewrite, stating
from support.running import QUICK

from tetractl.log.format.channels import RUN
from tetractl.log.format.tetractl_pb2 import Fact
from tetractl.log.read.salvage import scan
from tetractl.replay.identification import csv_tracks, passes
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
    monkeypatch.setattr(csv_rows, "CSV_ROWS", 2000)
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
    refused(done, "directions were sent between two frames")


@pytest.mark.parametrize(
    ("fact", "drawn"),
    [
        ("{", False),
        ("[1]", False),
        ("1" * 400, False),
        pytest.param("[1e300, 1, 1]", True, marks=pytest.mark.long),
    ],
)
def test_the_estimates_of_a_log_with_any_fact_are_drawn_or_told(fact, drawn, tmp_path):
    contents = scan(random_trials.write(random_trials.trial(steps=3), tmp_path / "made.mcap"))
    facts = [Fact(key="true_a", value=fact)]
    log = rewrite(contents, tmp_path / "log.mcap", stating(contents, RUN, facts=facts))
    done = tetractl(tmp_path, "plot", log, "--kind", "over-time", "-o", "e.png")
    if drawn:
        assert done.returncode == 0, done
        assert (tmp_path / "e.png").exists()
    else:
        refused(done, "log.mcap", "true_a", code=1)


@pytest.mark.long
def test_what_determines_nothing_is_told(tmp_path):
    """Regression: a singular matrix was a traceback."""
    (tmp_path / "poses.csv").write_text(poses(f"{i / 10},r,{i},0,0\n" for i in range(40)))
    (tmp_path / "commands.csv").write_text("time_s,direction_rad\n0,0\n0.1,0\n3.9,0\n")
    done = tetractl(tmp_path, "identify", "poses.csv", "commands.csv")
    assert done.returncode in (0, 2), done


def test_the_unit_of_identified_values_is_shown_as_a_terminal_may(tmp_path):
    """Regression: a change of the writing direction came to the terminal."""
    value = "{value: 1}"
    fields = ("a", "speed", "heading_bias", "position_noise", "heading_noise", "heading_walk")
    robot = ", ".join(f"{field}: {value}" for field in fields)
    head = f'identified: "1"\norigin: lab\nunit: "\\u202e"\ndead_time: {value}\n'
    (tmp_path / "measured.yaml").write_text(f"{head}robots: {{r: {{{robot}}}}}\n")
    (tmp_path / "spec.yaml").write_text("identified: measured.yaml\n" + QUICK)
    done = tetractl(tmp_path, "validate", "spec.yaml")
    assert done.returncode == 2
    assert "measured.yaml: unit: \\u202e: differs from the spec's, mm" in done.stdout
