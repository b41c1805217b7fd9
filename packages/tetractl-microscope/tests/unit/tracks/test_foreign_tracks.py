"""Tests of reading tables and graphs of tracks: units, what is missing, and what is one track."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.tracks.foreign_tracks import _find_axes, _find_axis_step, read_spot_tracks

from tetractl.core.errors import UsageError

HEADER = "particle,frame,y,x\n"
MICROMETRES = {"um": 1.0, "mm": 1e3, "micrometer": 1.0}


def read(folder, text, um=None, hz=None, said=None):
    path = folder / "tracks.csv"
    path.write_text(text)
    return read_spot_tracks(path, um, hz, [] if said is None else said)


@pytest.mark.parametrize(
    ("um", "hz", "missing"),
    [
        (None, None, "a unit of length and the time of an image"),
        (2.0, None, "the time of an image"),
        (None, 25.0, "a unit of length"),
    ],
)
def test_what_a_table_and_the_options_do_not_state_is_named(tmp_path, um, hz, missing):
    with pytest.raises(UsageError) as error:
        read(tmp_path, HEADER + "1,0,5,6\n1,1,6,7\n", um, hz)
    assert error.value.message.endswith(f"its tracks do not state {missing}")


@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 50)), min_size=1, unique=True),
    st.floats(0.1, 20.0),
    st.floats(0.5, 500.0),
)
def test_pixels_and_image_numbers_become_micrometres_upwards_and_seconds(
    tmp_path_factory, spots, um, hz
):
    """Each track has its own spots, in the order of time, whatever the order of the rows."""
    lines = "".join(f"{n},{k},{7 * k + n},{3 * k - n}\n" for n, k in spots)
    tracks = read(tmp_path_factory.mktemp("tracks"), HEADER + lines, um, hz)
    assert [track.number for track in tracks] == sorted({n for n, _ in spots})
    from_one = min(k for _, k in spots) == 1
    for track in tracks:
        frames = sorted(k for n, k in spots if n == track.number)
        expected = [
            ((k - from_one) / hz, um * (3 * k - track.number), -um * (7 * k + track.number))
            for k in frames
        ]
        assert track.rows == pytest.approx(np.array(expected), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("header", "factor_x", "factor_y"),
    [
        ("particle,time_s,y_um,x_um", 1.0, 1.0),
        ("particle,time_s,y_mm,x_mm", 1e3, 1e3),
        ("particle,time_s,y_um,x_mm", 1e3, 1.0),
        ("particle,time_s,y_mm,x_um", 1.0, 1e3),
    ],
)
def test_each_axis_has_the_unit_of_its_column(tmp_path, header, factor_x, factor_y):
    (track,) = read(tmp_path, f"{header}\n1,0,2,3\n1,0.5,4,7\n")
    expected = [(0, 3 * factor_x, -2 * factor_y), (0.5, 7 * factor_x, -4 * factor_y)]
    assert track.rows == pytest.approx(np.array(expected))


@pytest.mark.parametrize(
    ("stated", "differ"),
    [
        ([0.0, 0.04, 0.08], None),
        ([100.0, 100.04, 100.08], None),  # another origin of time is no difference
        ([-5.0, -4.96, -4.92], None),
        ([0.0, 0.04, 0.099], None),  # less than half an image
        ([0.0, 0.04, 0.101], "0.021 s"),
        ([7.0, 7.08, 7.16], "0.08 s"),
        ([7.0, 7.02, 7.04], "0.04 s"),
    ],
)
def test_a_rate_that_contradicts_the_times_of_the_table_is_reported(tmp_path, stated, differ):
    lines = "".join(f"1,{k},{t!r},5,{6 + k}\n" for k, t in enumerate(stated))
    said = []
    (track,) = read(tmp_path, "particle,frame,time_s,y,x\n" + lines, 2.0, 25.0, said)
    assert track.rows[:, 0] == pytest.approx([0.0, 0.04, 0.08])
    assert len(said) == (differ is not None)
    assert all(line.endswith(f"differ by up to {differ}") for line in said)


@pytest.mark.parametrize(
    ("frames", "begins", "remarks"),
    [
        ((0, 1, 2), 0.0, 0),
        ((1, 2, 3), 0.0, 1),
        ((2, 3, 4), 2.0, 0),  # nothing was found in the first images
        ((1, 0, 2), 0.0, 0),
    ],
)
def test_only_a_table_that_begins_with_image_1_counts_from_1(tmp_path, frames, begins, remarks):
    said = []
    lines = "".join(f"3,{k},{k},{k}\n" for k in frames)
    (track,) = read(tmp_path, HEADER + lines, 1.0, 1.0, said)
    assert track.rows[0, 0] == begins
    assert len(said) == remarks


@pytest.mark.parametrize(("step", "remarks"), [(1, 0), (9, 0), (10, 1), (40, 1)])
def test_image_numbers_in_large_steps_may_be_milliseconds(tmp_path, step, remarks):
    said = []
    lines = "".join(f"1,{5 + step * k},{k},{k}\n" for k in range(4))
    read(tmp_path, HEADER + lines, 1.0, 1.0, said)
    assert len(said) == remarks
    assert all(f"in steps of {step}" in line and "frame_ms" in line for line in said)


def test_spots_of_no_track_and_spots_that_were_not_found_are_left_out(tmp_path):
    text = HEADER + "1,0,5,6\n,0,1,1\n1,1,,7\n1,2,6,\n1,3,8,9\n"
    (track,) = read(tmp_path, text, 1.0, 1.0)
    assert track.rows.tolist() == [[0.0, 6.0, -5.0], [3.0, 9.0, -8.0]]


@pytest.mark.parametrize("rows", [",0,5,6\n,1,5,6\n", "1,0,,\n1,1,,\n"])
def test_a_table_whose_spots_are_of_no_track_is_refused(tmp_path, rows):
    with pytest.raises(UsageError, match="no point that belongs to a track"):
        read(tmp_path, HEADER + rows, 1.0, 1.0)


@pytest.mark.parametrize(
    ("second", "refused"),
    [("1,2,5,6", False), ("1,2,5,7", True), ("1,2,4,6", True), ("2,2,5,7", False)],
)
def test_a_cell_cannot_be_at_two_places_at_once(tmp_path, second, refused):
    text = HEADER + f"1,0,5,6\n1,2,5,6\n{second}\n"
    if not refused:
        assert len(read(tmp_path, text, 1.0, 2.0)[0].rows) == 2
        return
    with pytest.raises(UsageError, match="cell 1 has two different places at 1 s"):
        read(tmp_path, text, 1.0, 2.0)


# Axes of graphs, without the library that reads them.


def axis(name, kind=None, unit="", scale=None, scaled_unit=""):
    return SimpleNamespace(name=name, type=kind, unit=unit, scale=scale, scaled_unit=scaled_unit)


def names(axes, properties=()):
    return [found.name for found in _find_axes(axes, properties)]


@pytest.mark.parametrize(
    ("axes", "found"),
    [
        ([("t", "time"), ("y", "space"), ("x", "space")], ["t", "x", "y"]),
        ([("t", "time"), ("x", "space"), ("y", "space")], ["t", "x", "y"]),
        ([("T", "time"), ("POSITION_X", "space"), ("POSITION_Y", "space")], None),
        ([("t", "time"), ("row", "space"), ("col", "space")], ["t", "col", "row"]),
        ([("t", "time"), ("z", "space"), ("row", "space"), ("col", "space")], ["t", "col", "row"]),
        ([("t", "time"), ("z", "space"), ("x", "space"), ("y", "space")], ["t", "x", "y"]),
        ([("x", "space"), ("y", "space"), ("z", "space"), ("t", "time")], ["t", "x", "y"]),
        ([("t", "time"), ("X", "space"), ("slice", "space")], ["t", "slice", "X"]),
        ([("y", None), ("x", None), ("frame", None)], ["frame", "x", "y"]),
        ([("time", None), ("frame", None), ("x", None), ("y", None)], ["time", "x", "y"]),
        ([("t", "time"), ("x", "space"), ("y", None)], ["t", "x", "y"]),
    ],
)
def test_the_axes_of_a_graph_are_found_by_type_and_then_by_name(axes, found):
    found = found or ["T", "POSITION_X", "POSITION_Y"]
    assert names([axis(*a) for a in axes]) == found


def test_a_graph_without_axes_is_read_by_the_names_of_its_properties():
    assert names([], ["score", "Y", "T", "X"]) == ["T", "X", "Y"]


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ([("a", None), ("b", None)], "no axis has a type; the names of the axes are a, b"),
        ([("t", "time"), ("a", "space")], "no two axes have the type space"),
        ([("a", "space"), ("b", "space")], "no axis has the type time"),
    ],
)
def test_a_graph_without_time_x_and_y_says_what_it_lacks(axes, says):
    with pytest.raises(ValueError, match=says):
        names([axis(*a) for a in axes])


@pytest.mark.parametrize(
    ("unit", "scale", "scaled_unit", "size", "counted"),
    [
        ("um", None, "", 1.0, False),
        ("mm", None, "", 1e3, False),
        ("pixel", 2.5, "um", 2.5, True),  # an option may replace it
        ("pixel", 2.5, "mm", 2500.0, True),
        ("pixel", None, "um", None, True),
        ("pixel", 2.5, "", None, True),
        ("", None, None, None, True),
        ("um", 3.0, "parsec", 1.0, False),
    ],
)
def test_an_axis_has_a_size_if_its_unit_or_its_scale_is_known(
    unit, scale, scaled_unit, size, counted
):
    step = _find_axis_step(axis("x", unit=unit, scale=scale, scaled_unit=scaled_unit), MICROMETRES)
    assert (step.size, step.counted) == (size, counted)


def graph(folder, ids, edges):
    """Read a graph with one node in each image, in um and s."""
    core_io = pytest.importorskip("geff.core_io", reason="geff is not installed")
    from geff import GeffMetadata
    from geff_spec import Axis

    axes = [
        Axis(name="t", type="time", unit="second"),
        Axis(name="y", type="space", unit="millimeter"),
        Axis(name="x", type="space", unit="micrometer"),
    ]
    about = GeffMetadata(directed=True, axes=axes, node_props_metadata={}, edge_props_metadata={})
    values = {"t": np.arange(len(ids)) / 4.0, "y": np.arange(len(ids)) + 1.0, "x": 5.0 + ids}
    nodes = {name: {"values": column, "missing": None} for name, column in values.items()}
    path = folder / "tracks.geff"
    core_io.write_arrays(path, ids.astype(np.uint64), nodes, edges.astype(np.uint64), {}, about)
    return read_spot_tracks(path, None, None, [])


def test_a_track_of_a_graph_ends_where_a_cell_divides(tmp_path):
    """Nodes are not in the order of their ids; 3 divides into 8 and 9."""
    ids = np.array([5, 3, 8, 9, 7])
    edges = np.array([(5, 3), (3, 8), (3, 9), (9, 7)])
    tracks = graph(tmp_path, ids, edges)
    assert sorted(tuple(track.rows[:, 1] - 5) for track in tracks) == [(5, 3), (8,), (9, 7)]
    (first,) = [track for track in tracks if len(track.rows) == 2 and track.rows[0, 0] == 0]
    assert first.rows == pytest.approx(np.array([(0, 10, -1000), (0.25, 8, -2000)]))
