"""`tetractl track`: the cells of a synthetic film, through the command line."""

import csv
import json

import numpy as np
import pytest
from mcap.reader import make_reader
from support.cli import tetractl
from support.dish_films import film
from support.film_containers import UM_PX, folder, stack
from support.needs_opencv import cv2, video


@pytest.fixture(scope="module")
def dish(tmp_path_factory):
    """A folder with a synthetic film and its field."""
    folder = tmp_path_factory.mktemp("dish")
    made = film(seed=41, side=384, cells=3, crossings=False)
    video(folder / "dish.avi", made.pictures())
    rows = "".join(f"{t},{direction}\n" for t, direction in made.turns)
    (folder / "field.csv").write_text(f"time_s,direction_rad\n{rows}")
    return folder


def test_tables_a_log_and_a_film_are_written(dish):
    words = ("dish.avi", "--field", "field.csv", "--scale", "2.3", "-o", "tracks")
    done = tetractl(dish, "track", *words).ok()
    assert "magnet" in done.stdout and "wrote tracks" in done.stdout
    out = dish / "tracks"
    assert sorted(p.name for p in out.iterdir()) == [
        "cells.csv",
        "overlay.mp4",
        "poses.csv",
        "track.mcap",
    ]
    with (out / "cells.csv").open() as stream:
        cells = list(csv.DictReader(stream))
    assert any(cell["magnetised"] == "true" for cell in cells)
    with (out / "track.mcap").open("rb") as stream:
        reader = make_reader(stream)
        topics = {channel.topic for channel in reader.get_summary().channels.values()}
        assert {"/tf", "/picture", f"/crops/cell {cells[0]['cell']}"} <= topics
        assert [a.name for a in reader.iter_attachments()] == ["background.png"]
    shown = cv2.VideoCapture(str(out / "overlay.mp4"))
    assert shown.get(cv2.CAP_PROP_FRAME_COUNT) == 120
    again = tetractl(dish, "track", *words)
    assert again.returncode == 2 and "exists already" in again.stderr


def test_json_has_intervals_and_says_when_the_scale_is_guessed(dish):
    done = tetractl(dish, "track", "dish.avi", "--json").ok()
    found = json.loads(done.stdout)
    assert found["scale_guessed"] is True and found["pictures"] == 120
    speeds = [cell["speed_um_s"] for cell in found["cells"] if cell["speed_um_s"]]
    assert speeds and all(s["ci95"][0] < s["value"] < s["ci95"][1] for s in speeds)


@pytest.mark.slow
def test_a_film_without_a_rate_or_without_cells_says_what_is_wrong(tmp_path):
    stack(tmp_path / "still.tif", np.full((20, 64, 80), 700, np.uint16))
    without = tetractl(tmp_path, "track", "still.tif", "--scale", "2.3")
    assert without.returncode == 2
    assert without.stderr == "error: still.tif: states no rate\nhint: give --rate HZ\n"
    still = tetractl(tmp_path, "track", "still.tif", "--scale", "2.3", "--rate", "30")
    assert still.returncode == 1
    assert still.stderr == (
        "still.tif: no cell swims in this film: 20 pictures read, 0.667 s, contrast 0 grey levels, "
        "2.3 um/px\n"
    )


@pytest.mark.slow
def test_times_of_a_folder_are_those_of_the_table(tmp_path):
    made = film(seed=41, side=256, cells=3, crossings=False, seconds=2.0)
    path = folder(tmp_path / "film", np.array(list(made.pictures())))
    (path / "times.csv").write_text("time_s\n" + "".join(f"{7 + t:.6f}\n" for t in made.times))
    done = tetractl(tmp_path, "track", "film", "--scale", UM_PX, "--json")
    assert min(cell["since_s"] for cell in json.loads(done.stdout)["cells"]) >= 7
