"""Tests of `tetractl track` with tracks from other programs, in pixels and image numbers."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from testkit.cli import tetractl

from tetractl.core.errors import AbortError

pytestmark = pytest.mark.slow

RATE_HZ = 30.0
UM_PX = 2.0
SPEED = 300.0
A = (2.0, 4.0)


@pytest.fixture(scope="module")
def dish(tmp_path_factory):
    """A folder with the field and rows of cell, picture, y and x [pixels, y downwards]."""
    folder = tmp_path_factory.mktemp("dish")
    rows = []
    random = np.random.default_rng(3)
    turns = np.column_stack([np.arange(0, 20, 1.5), random.uniform(-3, 3, 14)])
    lines = "".join(f"{t},{u}\n" for t, u in turns)
    (folder / "field.csv").write_text(f"time_s,direction_rad\n{lines}")
    for cell, a in enumerate((*A, 3.0)):
        state = np.array([500.0, 400.0, 0.3 * cell])
        for k in range(round((20 if cell < len(A) else 1) * RATE_HZ)):  # the last one is brief
            rows.append((cell + 7, k, 600 - state[1] / UM_PX, state[0] / UM_PX))
            u = turns[np.searchsorted(turns[:, 0], k / RATE_HZ, side="right") - 1, 1]
            rate = [SPEED * np.cos(state[2]), SPEED * np.sin(state[2]), a * np.sin(u - state[2])]
            state = state + np.array(rate) / RATE_HZ
    return folder, np.array(rows)


def written(folder, name, header, table):
    np.savetxt(folder / name, table, delimiter=",", header=header, comments="")
    return name


def test_tracks_of_others_are_identified(dish):
    folder, rows = dish
    name = written(folder, "theirs.csv", "ID,T,Y,X", rows)
    words = ("track", name, "--field", "field.csv", "--scale", UM_PX, "--rate", RATE_HZ, "--json")
    done = tetractl(folder, *words).ok()
    printed = json.loads(done.stdout)["cells"]
    assert [cell["cell"] for cell in printed] == [7, 8]
    assert "seen for less than 2 s: cell 9" in done.stderr
    for cell, a in zip(printed, A, strict=True):
        assert cell["a_rad_s"]["value"] == pytest.approx(a, rel=0.02)
        assert cell["a_rad_s"]["ci95"][0] < a < cell["a_rad_s"]["ci95"][1]
        assert cell["speed_um_s"]["value"] == pytest.approx(SPEED, rel=0.02)
    assert "does not fit" not in done.stdout


def test_a_film_is_refused_and_the_way_to_its_tracks_is_named(tmp_path):
    (tmp_path / "dish.avi").write_bytes(b"RIFF")
    done = tetractl(tmp_path, "track", "dish.avi", "--scale", 2)
    assert done.returncode == 2
    assert done.stderr == (
        "error: dish.avi: the file is a video, but this command needs tracks\n"
        "hint: track the cells with trackpy or TrackMate, and give the table that it writes\n"
    )


def test_particles_that_drift_in_a_flow_get_no_a(dish):
    """Regression: an a of each, and the warning that all move together."""
    folder, _ = dish
    random = np.random.default_rng(4)
    rows = []
    for particle in range(8):
        steps = random.normal((0.0, 0.5), 0.2, (200, 2))
        for k, (y, x) in enumerate(300 + np.cumsum(steps, axis=0)):
            rows.append((particle, k, y, x))
    name = written(folder, "drifting.csv", "particle,frame,y,x", np.array(rows))
    words = ("track", name, "--field", "field.csv", "--scale", UM_PX, "--rate", RATE_HZ)
    done = tetractl(folder, *words).ok()
    assert "all cells move together" in done.stderr
    assert "a [rad/s]" not in done.stdout


@pytest.mark.parametrize(
    ("header", "options", "says"),
    [
        ("particle,frame,y,x", (), "its tracks do not state"),
        ("particle,frame,y,z", (), "columns of the tracks are missing: x"),
        ("particle,frame,y,x", ("--scale", 2), "its tracks do not state"),
    ],
)
def test_what_is_missing_is_one_line(dish, header, options, says):
    folder, rows = dish
    name = written(folder, "bad.csv", header, rows)
    done = tetractl(folder, "track", name, "--field", "field.csv", *options)
    assert done.returncode == 2 and says in done.stderr
    assert len(done.stderr.splitlines()) == 2
    (folder / "no.geff").mkdir(exist_ok=True)
    graph = tetractl(folder, "track", "no.geff", "--field", "field.csv")
    assert graph.returncode in (2, AbortError.exit) and "geff" in graph.stderr.lower()
    assert tetractl(folder, "track", "bad.csv", "--scale", 2).returncode == 2


def test_without_a_field_tracks_have_speeds_and_no_a(dish):
    """Regression: "tracks need --field", so that speeds of trackpy's links could not be had."""
    folder, rows = dish
    name = written(folder, "theirs.csv", "particle,frame,y,x", rows)
    words = ("track", name, "--scale", UM_PX, "--rate", RATE_HZ)
    done = tetractl(folder, *words, "-o", "cells", "--json").ok()
    for cell in json.loads(done.stdout)["cells"]:
        assert cell["a_rad_s"] is None
        assert cell["speed_um_s"]["value"] == pytest.approx(SPEED, rel=0.03)
        assert cell["vsl_um_s"] > 0
    assert (folder / "cells" / "cells.csv").read_text().startswith("cell,since_s")


def test_rare_pictures_show_no_turning_but_ways(dish):
    """Regression: "robot cell 0 drives in only 0 intervals": give more logs."""
    folder, rows = dish
    rare = rows[rows[:, 1] % 15 == 0]
    rare[:, 1] /= 15
    name = written(folder, "rare.csv", "particle,frame,y,x", rare)
    words = ("track", name, "--scale", UM_PX, "--rate", RATE_HZ / 15)
    refused = tetractl(folder, *words, "--field", "field.csv")
    assert refused.returncode == 2
    assert "images are 0.5 s apart, which is too long, because a heading" in refused.stderr
    assert "film at 7 images/s or more" in refused.stderr
    done = tetractl(folder, *words, "--json").ok()
    assert [cell["speed_um_s"] for cell in json.loads(done.stdout)["cells"]] == [None, None]


@pytest.mark.long
def test_a_reader_that_ends_early_is_no_fault_of_a_plugin(dish):
    """Regression: "plug-in command 'track' raised SystemExit: 1"."""
    folder, rows = dish
    name = written(folder, "theirs.csv", "particle,frame,y,x", rows[rows[:, 0] == 7])
    reading, writing = os.pipe()
    os.close(reading)
    program = (sys.executable, "-m", "tetractl")
    words = ("track", name, "--scale", f"{UM_PX}", "--rate", f"{RATE_HZ}")
    for more in ((), ("--json",)):
        done = subprocess.run(
            [*program, *words, *more], cwd=folder, stdout=writing, stderr=subprocess.PIPE, text=True
        )
        assert (done.returncode, done.stderr) == (0, "")
    os.close(writing)
