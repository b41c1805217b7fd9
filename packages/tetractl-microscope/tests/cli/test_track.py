"""Tests of what `tetractl track` refuses, prints and writes."""

import csv
import json
import math

import numpy as np
import pytest
from testkit.cli import tetractl

pytestmark = pytest.mark.slow

HZ = 25.0
UM_PX = 2.0
OPTIONS = ("--scale", UM_PX, "--rate", HZ)
A = (2.5, 3.5, 4.5, 3.0)
SPEED_UM_S = 300.0


@pytest.fixture(scope="module")
def dish(tmp_path_factory):
    """A folder with tracks of cells, the field that turned them, and its mirror image."""
    folder = tmp_path_factory.mktemp("dish")
    changes = np.arange(0.0, 14.0, 1.5)
    angles = np.random.default_rng(6).uniform(-3.0, 3.0, len(changes))
    for name, sign in (("field", 1), ("clockwise", -1)):
        rows = "".join(f"{t},{sign * u}\n" for t, u in zip(changes, angles, strict=True))
        (folder / f"{name}.csv").write_text(f"time_s,direction_rad\n{rows}")
    heading = np.arange(len(A), dtype=float)
    place = np.full(len(A), 500.0 + 500.0j)
    lines = []
    for k in range(round(14 * HZ)):
        lines += [
            f"{cell},{k},{-xy.imag / UM_PX},{xy.real / UM_PX}\n" for cell, xy in enumerate(place, 1)
        ]
        for _ in range(20):
            t = len(lines) / len(A) / HZ
            u = angles[np.searchsorted(changes, t, side="right") - 1]
            heading = heading + np.multiply(A, np.sin(u - heading)) / (20 * HZ)
            place = place + SPEED_UM_S * np.exp(1j * heading) / (20 * HZ)
    (folder / "tracks.csv").write_text("particle,frame,y,x\n" + "".join(lines))
    return folder


def track(folder, *words):
    return tetractl(folder, "track", "tracks.csv", *OPTIONS, *words)


def cells_of(done):
    return json.loads(done.ok().stdout)["cells"]


def test_with_a_field_each_cell_has_its_response_and_no_warning(dish):
    done = track(dish, "--field", "field.csv", "--json")
    assert [cell["cell"] for cell in cells_of(done)] == [1, 2, 3, 4]
    for cell, a in zip(cells_of(done), A, strict=True):
        assert cell["a_rad_s"]["value"] == pytest.approx(a, rel=0.1)
        assert cell["magnetised"] is True
    assert "warning" not in done.stderr


def test_directions_that_run_clockwise_are_found_or_given(dish):
    wrong = track(dish, "--field", "clockwise.csv", "--json")
    assert wrong.returncode == 2
    assert "tracks.csv: cells turn right when the directions in clockwise.csv" in wrong.stderr
    right = track(dish, "--field", "clockwise.csv", "--y-down", "--json")
    usual = track(dish, "--field", "field.csv", "--json")
    assert json.loads(right.stdout)["cells"] == json.loads(usual.stdout)["cells"]


def test_a_field_of_other_times_is_refused_before_any_fit(dish):
    rows = (dish / "field.csv").read_text().splitlines()[1:]
    moved = "".join(f"{float(t) + 100},{u}\n" for t, u in (row.split(",") for row in rows))
    (dish / "late.csv").write_text("time_s,direction_rad\n" + moved)
    done = track(dish, "--field", "late.csv")
    assert done.returncode == 2 and done.stdout == ""
    assert "no time in this file is within the times of tracks.csv" in done.stderr


def test_the_side_of_clockwise_directions_needs_directions(dish):
    done = track(dish, "--y-down")
    assert (done.returncode, done.stderr) == (2, "error: --y-down needs --field\n")


@pytest.mark.parametrize("name", ["dish.avi", "dish.TIF", "a.b.mp4"])
def test_a_video_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b"RIFF")
    done = tetractl(tmp_path, "track", name, *OPTIONS)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {name}: the file is a video")


def test_the_organism_is_found_by_speed_or_given(dish):
    found = track(dish, "--json")
    assert json.loads(found.stdout)["organism"] == "tetrahymena"
    given = track(dish, "--organism", "paramecium", "--json")
    assert json.loads(given.stdout)["organism"] == "paramecium"
    unknown = track(dish, "--organism", "amoeba")
    assert unknown.returncode == 2 and "no organism named 'amoeba'" in unknown.stderr


def test_tables_are_printed_and_the_cells_are_written(dish):
    done = track(dish, "-o", "cells").ok()
    assert "Cells, with 95 % intervals" in done.stdout
    assert "Means over cells" in done.stdout
    assert "wrote cells: cells.csv" in done.stderr
    with (dish / "cells" / "cells.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["cell"] for row in rows] == ["1", "2", "3", "4"]
    for row in rows:
        low, high = float(row["speed_low_um_s"]), float(row["speed_high_um_s"])
        assert low < float(row["speed_um_s"]) < high
        assert float(row["speed_um_s"]) == pytest.approx(SPEED_UM_S, rel=0.05)
        assert row["a_rad_s"] == ""
    again = track(dish, "-o", "cells")
    assert again.returncode == 2 and "cells" in again.stderr
    assert "Cells, with" not in again.stdout


def test_a_dish_that_drifts_gets_speeds_but_no_response(tmp_path):
    lines = [
        f"{cell},{k},{20 * cell + 0.2 * math.sin(7 * k * cell)},{k * 1.5}\n"
        for cell in range(1, 10)
        for k in range(100)
    ]
    (tmp_path / "tracks.csv").write_text("particle,frame,y,x\n" + "".join(lines))
    (tmp_path / "field.csv").write_text("time_s,direction_rad\n0,0\n1,1.5\n2,3\n3,-1.5\n")
    done = track(tmp_path, "--field", "field.csv", "--json")
    assert "all cells move together" in done.stderr
    cells = cells_of(done)
    assert len(cells) == 9
    assert all(cell["a_rad_s"] is None and cell["magnetised"] is None for cell in cells)
    assert all(cell["speed_um_s"] is not None for cell in cells)
