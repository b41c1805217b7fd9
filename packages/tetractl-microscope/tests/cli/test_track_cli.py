"""`tetractl track`: the cells of a synthetic film, through the command line."""

import csv
import json
from importlib.util import find_spec

import numpy as np
import pytest
from support.cli import tetractl
from support.dish_films import film
from support.film_containers import UM_PX, stack
from support.needs_opencv import cv2, video

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dish(tmp_path_factory):
    """A folder with a synthetic film and its field."""
    folder = tmp_path_factory.mktemp("dish")
    synthetic = film(seed=41, side=384, cells=3, crossings=False)
    video(folder / "dish.avi", synthetic.pictures())
    rows = "".join(f"{t},{direction}\n" for t, direction in synthetic.turns)
    (folder / "field.csv").write_text(f"time_s,direction_rad\n{rows}")
    return folder


@pytest.fixture(scope="module")
def tracks(dish):
    """The results of the film, and what was printed."""
    words = ("--field", "field.csv", "--scale", "2.3", "-o", "found")
    return dish / "found", tetractl(dish, "track", "dish.avi", *words).ok().stdout


@pytest.mark.long
def test_tables_figures_and_a_film_are_written(tracks):
    out, printed = tracks
    assert "magnet" in printed and "wrote found" in printed
    assert sorted(p.name for p in out.iterdir()) == [
        "cells.csv",
        "cells.json",
        "cells.png",
        "overlay.mp4",
        "poses.csv",
        "tracks.csv",
        *(["tracks.geff"] if find_spec("geff") else []),
    ]
    with (out / "cells.csv").open() as stream:
        cells = list(csv.DictReader(stream))
    assert any(cell["magnetised"] == "true" for cell in cells)
    assert all(float(cell["vsl_um_s"]) > 0 for cell in cells)
    record = json.loads((out / "cells.json").read_text())
    assert record["film"] == "dish.avi" and record["tetractl"]
    assert [cell["cell"] for cell in record["cells"]] == [int(cell["cell"]) for cell in cells]
    overlay = cv2.VideoCapture(str(out / "overlay.mp4"))
    assert overlay.get(cv2.CAP_PROP_FRAME_COUNT) == 120
    again = tetractl(out.parent, "track", "dish.avi", "-o", "found")
    assert again.returncode == 2 and "exists already" in again.stderr


def test_tracks_are_read_by_geff_as_they_are_in_the_table(tracks):
    core_io = pytest.importorskip("geff.core_io", reason="geff is not installed")
    from geff.validate.data import ValidationConfig

    graph = core_io.read_to_memory(
        tracks[0] / "tracks.geff", data_validation=ValidationConfig(graph=True)
    )
    with (tracks[0] / "tracks.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    nodes = {name: prop["values"] for name, prop in graph["node_props"].items()}
    assert set(nodes) == {"t", "y", "x", "cell", "heading", "axis", "sure"}
    for name, column in {"t": "t", "y": "y", "x": "x", "cell": "id"}.items():
        assert nodes[name].tolist() == [float(row[column]) for row in rows]
    t, y, x = graph["metadata"].axes
    assert (t.scale, y.scale) == pytest.approx((1 / 30, 2.3)) and x.scaled_unit == "micrometer"
    first, second = graph["edge_ids"].astype(int).T
    assert (nodes["cell"][first] == nodes["cell"][second]).all()
    cells = set(nodes["cell"])
    assert len(first) == len(rows) - len(cells)
    ahead = (nodes["x"][second] - nodes["x"][first]) * np.cos(nodes["heading"][first])
    ahead += (nodes["y"][second] - nodes["y"][first]) * np.sin(nodes["heading"][first])
    assert np.mean(ahead > 0) > 0.9


def test_tracks_are_read_by_pandas_as_trackpy_and_napari_have_them(tracks):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    table = pandas.read_csv(tracks[0] / "tracks.csv")
    assert list(table.columns[:4]) == ["id", "t", "y", "x"]  # napari's
    assert {"particle", "frame", "x", "y"} <= set(table.columns)  # trackpy's
    assert table["sure"].dtype == bool and table["found"].dtype == bool
    assert table.id.dtype.kind == table.frame.dtype.kind == "i"
    assert not table.duplicated(["particle", "frame"]).any()
    poses = pandas.read_csv(tracks[0] / "poses.csv")
    assert (poses.cell == table.id).all() and (poses.picture == table.t).all()
    assert table.x.to_numpy() == pytest.approx(poses.x_um.to_numpy() / 2.3 - 0.5)
    assert table.y.to_numpy() == pytest.approx(383.5 - poses.y_um.to_numpy() / 2.3)


@pytest.mark.long
def test_speeds_have_intervals_in_json(dish):
    done = tetractl(dish, "track", "dish.avi", "--scale", UM_PX, "--json").ok()
    printed = json.loads(done.stdout)
    speeds = [cell["speed_um_s"] for cell in printed["cells"] if cell["speed_um_s"]]
    assert speeds and all(s["ci95"][0] < s["value"] < s["ci95"][1] for s in speeds)


@pytest.mark.long
def test_a_film_without_a_rate_or_without_cells_says_what_is_wrong(tmp_path):
    stack(tmp_path / "still.tif", np.full((20, 64, 80), 700, np.uint16))
    unscaled = tetractl(tmp_path, "track", "still.tif", "--rate", "30")
    assert unscaled.returncode == 2
    assert unscaled.stderr == (
        "error: still.tif: states no scale\nhint: give --scale UM_PER_PIXEL\n"
    )
    without = tetractl(tmp_path, "track", "still.tif", "--scale", "2.3")
    assert without.returncode == 2
    assert without.stderr == "error: still.tif: states no rate\nhint: give --rate HZ\n"
    still = tetractl(tmp_path, "track", "still.tif", "--scale", "2.3", "--rate", "30")
    assert still.returncode == 1
    assert still.stderr == (
        "still.tif: no cell swims in this film: 20 pictures read, 0.667 s, contrast 0 grey levels, "
        "2.3 um/px\n"
    )
