"""Tests of tracks in other forms of a file format; each form must give the same poses."""

import numpy as np
import pytest
from tetractl_microscope.tracks.foreign_tracks import COUNTED_FROM_ONE, read_spot_tracks

from tetractl.core.errors import UsageError

HZ = 25.0
UM = 2.0
SPOT_ROWS = [
    (float(cell), float(k), 40.0 + 3 * k, 100.0 * cell + 5 * k) for cell in (1, 2) for k in range(6)
]
COLUMNS = np.array(SPOT_ROWS).T
NUMBER, K, Y, X = COLUMNS
POSES = sorted(zip(K / HZ, UM * X, -UM * Y, strict=True))
FRAME = {"unit": "frame", "scale": 1 / HZ, "scaled_unit": "second"}
PIXEL = {"unit": "pixel", "scale": UM, "scaled_unit": "micrometer"}
TIME = {"type": "time", **FRAME}
SPACE = {"type": "space", **PIXEL}


def poses(path, um=None, hz=None, said=None):
    tracks = read_spot_tracks(path, um, hz, [] if said is None else said)
    assert len(tracks) == 2
    return sorted(tuple(row) for track in tracks for row in track.rows.tolist())


USUAL_AXES = {"t": TIME, "y": SPACE, "x": SPACE}
USUAL_VALUES = {"t": K, "y": Y, "x": X}


def graph(path, axes=USUAL_AXES, values=USUAL_VALUES):
    """Write a graph with axes of such names and contents; `values` has the values of each."""
    core_io = pytest.importorskip("geff.core_io", reason="geff is not installed")
    from geff import GeffMetadata
    from geff_spec import Axis

    ids = np.arange(len(K), dtype=np.uint64)
    about = GeffMetadata(
        directed=True,
        axes=[Axis(name=name, **contents) for name, contents in axes.items()] or None,
        node_props_metadata={},
        edge_props_metadata={},
    )
    nodes = {name: {"values": column, "missing": None} for name, column in values.items()}
    pairs = np.column_stack([ids[:-1], ids[1:]])
    are_of_one_track = np.diff(NUMBER) == 0
    edges = pairs[are_of_one_track]
    core_io.write_arrays(path, ids, nodes, edges, {}, about)
    return path


def placed(path, header, *columns):
    """Write a table of spots with a header of commas."""
    table = np.column_stack(columns)
    np.savetxt(path, table, delimiter=",", header=header, comments="", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("axes", "values"),
    [
        (USUAL_AXES | {"y": SPACE | {"scale": 4.0}}, USUAL_VALUES | {"y": Y / 2}),
        ({"t": FRAME, "y": PIXEL, "x": PIXEL}, USUAL_VALUES),
        ({"Frame": FRAME, "X": PIXEL, "Y": PIXEL}, {"Frame": K, "X": X, "Y": Y}),
        ({"t": TIME, "row": SPACE, "col": SPACE}, {"t": K, "row": Y, "col": X}),
        (
            {"time": TIME, "POSITION_Y": SPACE, "POSITION_X": SPACE},
            {"time": K, "POSITION_Y": Y, "POSITION_X": X},
        ),
    ],
    ids=["pixels twice as high as wide", "no types", "other names", "row and column", "TrackMate"],
)
def test_each_axis_of_a_graph_has_its_own_scale_whether_or_not_it_has_a_type(
    axes, values, tmp_path
):
    """Regression: y had the scale of x, and axes without a type had none; and a graph whose axis of
    type "time" is named "time" was no graph of t, x, y."""
    assert np.allclose(poses(graph(tmp_path / "tracks.geff", axes, values)), POSES)


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ({"a": {}, "b": {}, "c": {}}, "no axis has a type; the names of the axes are a, b, c"),
        ({"y": SPACE, "x": SPACE}, "no axis has the type time; the names of the axes are y, x"),
    ],
)
def test_a_graph_that_lacks_an_axis_is_told_which_it_has(axes, says, tmp_path):
    """Regression: "no axis has a type", though two have."""
    values = dict(zip(axes, (Y, X, K), strict=False))
    with pytest.raises(UsageError, match=says):
        poses(graph(tmp_path / "tracks.geff", axes, values), UM, HZ)


@pytest.mark.parametrize(
    ("header", "times"), [("time_s", K / HZ), ("t (ms)", 1000 * K / HZ), ("Timestamp_us", 4e4 * K)]
)
@pytest.mark.parametrize("frames", [True, False])
def test_times_with_a_unit_are_taken_and_no_numbers_of_pictures(header, times, frames, tmp_path):
    """Regression: a column time_s next to frame was left out, and a was 1.3 times the true one."""
    uneven = np.where(K > 3, K + 5, K)
    columns = {"particle": NUMBER, "frame": uneven, header: times, "y": Y, "x": X}
    if not frames:
        del columns["frame"]
    path = placed(tmp_path / "tracks.csv", ",".join(columns), *columns.values())
    said = []
    assert np.allclose(poses(path, UM, said=said), POSES) and not said
    if not frames:
        with pytest.raises(
            UsageError, match="it states times, so the option --rate must be left out"
        ):
            poses(path, UM, HZ)
        return
    poses(path, UM, HZ, said)
    assert said == [
        f"warning: {path}: --rate 25 replaces the times in the file, which differ by up to 0.2 s"
    ]


@pytest.mark.parametrize(("first", "late"), [(0, 0), (1, 0), (7, 7)])
def test_a_count_from_1_begins_at_time_0_and_is_said(first, late, tmp_path):
    """Regression: all poses were one picture late, and a was 3.88 of 4."""
    path = placed(tmp_path / "a.csv", "particle,frame,y,x", NUMBER, K + first, Y, X)
    said = []
    expected = [(seconds + late / HZ, x, y) for seconds, x, y in POSES]
    assert np.allclose(poses(path, UM, HZ, said), expected)
    assert [COUNTED_FROM_ONE in line for line in said] == [True] * (first == 1)


SPOTS = """\
LABEL,TRACK_ID,POSITION_X,POSITION_Y,POSITION_T,FRAME
Label,Track ID,X,Y,T,Frame
,,({um}),({um}),({s}),
"""


@pytest.mark.parametrize(
    ("um", "s", "factor", "written"),
    [
        ("micron", "sec", 1.0, "{:g}"),
        ("micron", "sec", 1.0, "{:.1f}"),
        ("inch", "s", 25400, "{:g}"),
    ],
    ids=["as TrackMate", "frames as pandas writes them", "inches"],
)
def test_spots_of_trackmate(um, s, factor, written, tmp_path):
    """Regression: with frames such as 3.0 the table "has no spot of a track"."""
    rows = "".join(
        f"ID,{cell:g},{UM * x / factor!r},{UM * y / factor!r},{k / HZ!r},{written.format(k)}\n"
        for cell, k, y, x in SPOT_ROWS
    )
    (tmp_path / "spots.csv").write_text(SPOTS.format(um=um, s=s) + rows)
    assert np.allclose(poses(tmp_path / "spots.csv"), POSES)


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("Nr,TID,PID,x [um],y [um],t [sec]", (K, NUMBER, K, UM * X, UM * Y, K / HZ)),
        ("Nr,TID,PID,x [mm],y [mm],t [ms]", (K, NUMBER, K, X / 500, Y / 500, 1000 * K / HZ)),
        ("Nr,TID,PID,x [pixel],y [pixel],t [sec]", (K, NUMBER, K, X, Y, K / HZ)),
        ("Nr,TID,PID,x [pixel],y [pixel],t [frame]", (K, NUMBER, K, X, Y, K)),
        ("Index,Track n°,Slice n°,X,Y,Distance,Velocity", (K, NUMBER, K + 1, X, Y, K, K)),
        ("Position X,Position Y,Position Z,Time,TrackID,ID", (X, Y, K, K + 1, NUMBER, K)),
        ("Position X,Position Y,Time,TrackID,ID", (X, Y, K + 1, 1e9 + NUMBER, K)),
        (
            "\n Position \n ============ \nPosition X,Position Y,Time,TrackID,",
            (X, Y, K + 1, 1e9 + NUMBER),
        ),
        ("%% Trajectories\nTrajectory,Frame,x,y", (NUMBER, K, X, Y)),
        ("TRACK_ID,POSITION_X,POSITION_Y,FRAME", (NUMBER, X, Y, K)),
        ("ID,t,x,y,z,parent,root,state,generation,dummy", (NUMBER, K, X, Y, *[K] * 6)),
        ("y,x,mass,size,ecc,frame,particle", (Y, X, K, K, K, K, NUMBER)),
        ("trajectory,frame,x_px,y_px", (NUMBER, K, X, Y)),
        ("track_id;t;y;x".replace(";", ","), (NUMBER, K, Y, X)),
        ("id,t,y,x,frame,particle,sure,found", (NUMBER, K, Y, X, K, NUMBER, K, K)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_tables_of_other_programs_are_read_by_their_own_columns(header, columns, tmp_path):
    """Regression: MTrackJ's were "neither poses nor commands", and the second number of Imaris "not
    a number of at most 1e+09"."""
    path = placed(tmp_path / "a.csv", header, *columns)
    has_length = "[um]" in header or "[mm]" in header
    has_time = "[sec]" in header or "[ms]" in header
    read = poses(path, None if has_length else UM, None if has_time else HZ)
    assert np.allclose(read, POSES)


def test_a_cell_need_not_be_found_in_the_first_picture(tmp_path):
    """Regression: "x: not a number", and the hint to leave the entry empty."""
    is_found = K > 0
    places = [np.where(is_found, column, np.nan) for column in (X, Y)]
    path = placed(tmp_path / "a.csv", "particle,frame,x,y", NUMBER, K, *places)
    assert np.allclose(poses(path, UM, HZ), [row for row in POSES if row[0] > 0])


def test_a_track_at_two_places_at_once_is_refused_and_a_row_twice_is_not(tmp_path):
    twice = np.column_stack([NUMBER, K, Y, X])
    path = placed(tmp_path / "a.csv", "particle,frame,y,x", np.vstack([twice, twice[:3]]))
    assert np.allclose(poses(path, UM, HZ), POSES)
    moved = np.add(twice[:3], (0, 0, 1, 0))
    path = placed(tmp_path / "b.csv", "particle,frame,y,x", np.vstack([twice, moved]))
    with pytest.raises(UsageError, match="cell 1 has two different places at 0 s"):
        poses(path, UM, HZ)


def test_a_track_at_two_places_at_a_unix_time_is_refused_with_that_time(tmp_path):
    """Regression: "at 1.764e+09 s", by which no row is found."""
    rows = np.column_stack([NUMBER, 1_764_000_003 + K // 2, Y, X])
    path = placed(tmp_path / "a.csv", "particle,time_s,y,x", rows)
    with pytest.raises(UsageError, match="two different places at 1764000003 s"):
        poses(path, UM)


@pytest.mark.parametrize(("step", "is_said"), [(40, True), (10, True), (9, False), (1, False)])
def test_numbers_of_pictures_that_may_be_milliseconds_are_said(step, is_said, tmp_path):
    path = placed(tmp_path / "a.csv", "particle,t,y,x", NUMBER, step * K, Y, X)
    said = []
    poses(path, UM, HZ, said)
    assert any("if they are milliseconds, name the column t_ms" in line for line in said) == is_said


@pytest.mark.parametrize("within", ["geff", None], ids=["under geff", "bare"])
def test_a_graph_older_than_the_first_release_is_refused_with_a_remedy(within, tmp_path):
    """Regression: "No geff key found", or seven errors of validation, cut off."""
    zarr = pytest.importorskip("zarr", reason="geff is not installed")
    path = graph(tmp_path / "old.geff")
    group = zarr.open_group(path)
    about = {"geff_version": "0.1.1", "directed": True, "position_prop": "position"}
    del group.attrs["geff"]
    group.attrs.update(about if within is None else {within: about})
    with pytest.raises(UsageError, match=r"old\.geff: cannot be read as a GEFF graph") as error:
        poses(path, UM, HZ)
    assert "as CSV" in str(error.value.hint)


def test_a_table_that_is_not_there_is_named(tmp_path):
    """Regression: "plug-in camera ... raised FileNotFoundError"."""
    with pytest.raises(UsageError, match=r"a\.csv: no such file"):
        poses(tmp_path / "a.csv", UM, HZ)


def test_a_graph_without_edges_has_no_tracks(tmp_path, monkeypatch):
    """Regression: each spot was a robot, and none "is seen for 2 s"."""
    monkeypatch.setitem(globals(), "NUMBER", K)  # no two spots follow one another
    with pytest.raises(UsageError, match="has no edges"):
        poses(graph(tmp_path / "a.geff"))


def test_options_do_not_scale_numbers_that_have_a_unit(tmp_path):
    """Regression: --scale multiplied micrometres, and --rate divided seconds."""
    rows = "".join(
        f"ID,{cell:g},{UM * x!r},{UM * y!r},{k / HZ!r},{k:g}\n" for cell, k, y, x in SPOT_ROWS
    )
    path = tmp_path / "spots.csv"
    path.write_text(SPOTS.format(um="micron", s="sec") + rows)
    with pytest.raises(UsageError, match="places in a unit of length, so the option --scale"):
        poses(path, UM)
    said = []
    faster = poses(path, None, 2 * HZ, said)
    assert np.allclose([t for t, _, _ in faster], [t / 2 for t, _, _ in POSES])
    assert "--rate 50 replaces the times" in said[0]
    seconds = USUAL_AXES | {"t": {"type": "time", "unit": "second"}}
    with pytest.raises(UsageError, match="it states times, so the option --rate"):
        poses(graph(tmp_path / "g.geff", seconds, USUAL_VALUES | {"t": K / HZ}), None, HZ)


@pytest.mark.parametrize(
    ("header", "columns", "says"),
    [
        ("number,frame,y,x", COLUMNS, "are missing: particle, track_id or id"),
        ("particle,picture,y,x", COLUMNS, "are missing: frame, t or time_s"),
        ("particle,frame,y,z", COLUMNS, "are missing: x; the file's columns are"),
        ("particle,frame,row,col", COLUMNS, "are missing: x; y"),
        ("particle,frame,y,x", (NUMBER, K - 3, Y, X), "frame: -3 is below 0"),
        (
            "track_id,t,y,x",
            (NUMBER, K / HZ, Y, X),
            r"column t: 0\.04 is not a whole number, .*\n.*name the column t_s",
        ),
    ],
)
def test_a_table_without_a_column_or_numbers_of_pictures_is_refused(
    header, columns, says, tmp_path
):
    """Regression: the hint named the columns of `identify`; tracks were seconds before the field,
    and a was wrong; fractions were divided by the rate, and no robot was "seen for 2 s"."""
    with pytest.raises(UsageError, match=says):
        poses(placed(tmp_path / "a.csv", header, *columns), UM, HZ)


def test_a_broken_graph_is_one_line_without_an_address_of_a_library(tmp_path):
    """Regression: pydantic's text named its web page."""
    zarr = pytest.importorskip("zarr", reason="geff is not installed")
    path = graph(tmp_path / "tracks.geff")
    group = zarr.open_group(path)
    group.attrs.update({"geff": group.attrs["geff"] | {"directed": "perhaps"}})
    with pytest.raises(
        UsageError, match="cannot be read as a GEFF graph with t, x and y: "
    ) as error:
        poses(path)
    assert "http" not in error.value.message and "directed" in error.value.message
    assert "\n" not in error.value.message


def test_a_count_from_1_begins_at_time_0_if_a_rate_replaces_the_times(tmp_path):
    path = tmp_path / "tracks.csv"
    table = np.column_stack([NUMBER, K + 1, Y, X, K / HZ])
    np.savetxt(path, table, delimiter=",", header="particle,frame,y,x,time_s", comments="")
    assert np.allclose(poses(path, UM, HZ), POSES)


@pytest.mark.parametrize(
    ("header", "missing"),
    [
        ("number,frame,y,x", "particle, track_id or id"),
        ("particle,picture,y,x", "frame, t or time_s"),
        ("particle,frame,y,z", "x"),
        ("particle,frame,row,col", "x; y"),
    ],
)
def test_a_missing_column_is_named(header, missing, tmp_path):
    """Regression: the hint named the columns of `identify`."""
    path = placed(tmp_path / "a.csv", header, NUMBER, K, Y, X)
    with pytest.raises(UsageError, match=f"are missing: {missing}; the file's columns are"):
        poses(path, UM, HZ)


def test_a_table_without_rows_is_named(tmp_path):
    (tmp_path / "a.csv").write_text("particle,frame,y,x\n")
    with pytest.raises(UsageError, match=r"a\.csv: the file has no rows"):
        poses(tmp_path / "a.csv", UM, HZ)
