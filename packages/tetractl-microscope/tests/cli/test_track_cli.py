"""`tetractl track`: the cells of a synthetic film, through the command line."""

import csv
import json
from importlib.util import find_spec

import numpy as np
import pytest
from mcap.reader import make_reader
from support.cli import tetractl
from support.dish_films import film
from support.film_containers import UM_PX, folder, stack
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
def test_tables_a_log_and_a_film_are_written(tracks):
    out, printed = tracks
    assert "magnet" in printed and "wrote found" in printed
    assert sorted(p.name for p in out.iterdir()) == [
        "cells.csv",
        "cells.png",
        "overlay.mp4",
        "poses.csv",
        "track.mcap",
        "tracks.csv",
        *(["tracks.geff"] if find_spec("geff") else []),
    ]
    with (out / "cells.csv").open() as stream:
        cells = list(csv.DictReader(stream))
    assert any(cell["magnetised"] == "true" for cell in cells)
    assert all(0 < float(cell["lin"]) <= 1 for cell in cells)
    with (out / "track.mcap").open("rb") as stream:
        reader = make_reader(stream)
        topics = {channel.topic for channel in reader.get_summary().channels.values()}
        assert topics == {"/tf", "/picture"}
        assert [a.name for a in reader.iter_attachments()] == ["track.json", "background.png"]
    overlay = cv2.VideoCapture(str(out / "overlay.mp4"))
    assert overlay.get(cv2.CAP_PROP_FRAME_COUNT) == 120
    again = tetractl(out.parent, "track", "dish.avi", "-o", "found")
    assert again.returncode == 2 and "exists already" in again.stderr


@pytest.mark.long
def test_the_log_is_read_back_as_it_was_printed(tracks):
    out, printed = tracks
    for path in (".", "track.mcap"):
        again = tetractl(out, "track", path).ok().stdout
        assert again.startswith("Cells, with 95 % intervals")
        assert printed.startswith(again)
    record = json.loads(tetractl(out, "track", ".", "--json").ok().stdout)
    assert record["film"] == "dish.avi"
    assert len(record["cells"]) >= 3
    refused = tetractl(out, "track", ".", "--scale", "2")
    assert refused.returncode == 2 and "was analysed already" in refused.stderr


@pytest.mark.long
def test_all_figures_are_drawn_of_the_log(tracks, tmp_path):
    out, _ = tracks
    tetractl(out, "track", ".", "-o", tmp_path / "again").ok()
    drawn = {path.stem for path in (tmp_path / "again").glob("*.png")}
    assert {"cells", "paths", "speeds", "turning", "msd"} <= drawn
    for_print = cv2.imread(str(tmp_path / "again" / "cells.png"))
    for_screen = cv2.imread(str(out / "cells.png"))
    assert len(for_print) == pytest.approx(1.5 * len(for_screen), abs=2)  # more dots for print
    assert (tmp_path / "again" / "cells.csv").read_text() == (out / "cells.csv").read_text()


@pytest.mark.parametrize(
    "words",
    [
        ("verify",), ("replay",), ("recover",), ("identify",), ("open",), ("rerun",),
        ("export", "-o", "x.csv", "--table", "poses"), ("plot", "--kind", "trajectory"),
        ("stats",), ("plot",), ("report",), ("info",), ("plot", "--kind", "video"),
    ],
)  # fmt: skip
def test_what_needs_a_trial_says_so_of_a_film(tracks, words):
    done = tetractl(tracks[0], words[0], "track.mcap", *words[1:])
    assert done.returncode == 2
    assert "hint: " in done.stderr and "damaged" not in done.stderr
    assert len(done.stderr.splitlines()) == 2


def test_a_log_that_is_cut_short_says_what_is_lost(tracks, tmp_path):
    log = (tracks[0] / "track.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(log[: len(log) * 9 // 10])
    (tmp_path / "stub.mcap").write_bytes(log[:300])
    cut = tetractl(tmp_path, "track", "cut.mcap")
    assert cut.returncode == 1 and "breaks off" in cut.stderr
    stub = tetractl(tmp_path, "track", "stub.mcap")
    assert stub.returncode == 1 and "cells of the film cannot be read" in stub.stderr


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
def test_speeds_have_intervals_in_json_unless_the_scale_is_guessed(dish):
    done = tetractl(dish, "track", "dish.avi", "--scale", UM_PX, "--json").ok()
    printed = json.loads(done.stdout)
    speeds = [cell["speed_um_s"] for cell in printed["cells"] if cell["speed_um_s"]]
    assert speeds and all(s["ci95"][0] < s["value"] < s["ci95"][1] for s in speeds)
    done = tetractl(dish, "track", "dish.avi", "-o", "guessed", "--json").ok()
    printed = json.loads(done.stdout)
    assert printed["scale_guessed"] is True and printed["pictures"] == 120
    speeds = [cell["speed_um_s"] for cell in printed["cells"] if cell["speed_um_s"]]
    assert speeds and all(isinstance(speed, float) for speed in speeds)
    again = tetractl(dish, "track", "guessed").ok()
    assert "none: the scale is a guess" in again.stdout


@pytest.mark.long
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


@pytest.mark.long
def test_times_of_a_folder_are_those_of_the_table(tmp_path):
    synthetic = film(seed=41, side=256, cells=3, crossings=False, seconds=2.0)
    pictures = np.array(list(synthetic.pictures()))
    path = folder(tmp_path / "film", pictures)
    (path / "times.csv").write_text("time_s\n" + "".join(f"{7 + t:.6f}\n" for t in synthetic.times))
    done = tetractl(tmp_path, "track", "film", "--scale", UM_PX, "--json")
    assert min(cell["since_s"] for cell in json.loads(done.stdout)["cells"]) >= 7
