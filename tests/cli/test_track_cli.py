"""`tetractl track`: the cells of a synthetic film, through the command line."""

import csv
import json

import pytest
from mcap.reader import make_reader
from support.cli import tetractl
from support.dish_films import film
from support.needs_opencv import cv2


@pytest.fixture(scope="module")
def dish(tmp_path_factory):
    """A folder with a synthetic film and its field."""
    folder = tmp_path_factory.mktemp("dish")
    made = film(seed=41, side=384, cells=3, crossings=False)
    writer = cv2.VideoWriter(
        str(folder / "dish.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (384, 384)
    )
    for picture in made.pictures():
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    rows = "".join(f"{t},{direction}\n" for t, direction in made.turns)
    (folder / "field.csv").write_text(f"time_s,direction_rad\n{rows}")
    return folder


def test_tables_a_log_and_a_film_are_written(dish):
    words = ("dish.avi", "--field", "field.csv", "--scale", "2.3", "-o", "tracks")
    done = tetractl(dish, "track", *words)
    assert done.returncode == 0, done.stderr
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
    done = tetractl(dish, "track", "dish.avi", "--json")
    assert done.returncode == 0
    found = json.loads(done.stdout)
    assert found["scale_guessed"] is True and found["pictures"] == 120
    speeds = [cell["speed_um_s"] for cell in found["cells"] if cell["speed_um_s"]]
    assert speeds and all(s["ci95"][0] < s["value"] < s["ci95"][1] for s in speeds)
