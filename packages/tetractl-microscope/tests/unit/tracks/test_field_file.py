"""Tests of reading the field over time from a CSV file, and of its warnings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.tracks.field_file import (
    STRENGTH_MAX,
    describe_clock_mismatches,
    describe_wrong_directions,
    no_field,
    read_field,
)

from tetractl.core.errors import UsageError


def field_of(tmp_path, text, **options):
    path = tmp_path / "field.csv"
    path.write_text(text)
    return read_field(path, **options)


def test_a_file_is_read_in_seconds_and_radians_with_strength_1(tmp_path):
    field = field_of(tmp_path, "time_s,direction_rad\n0,0.5\n1.5,-2\n1.5,3\n4,0\n")
    assert field.times.tolist() == [0.0, 1.5, 1.5, 4.0]
    assert field.angles.tolist() == [0.5, -2.0, 3.0, 0.0]
    assert np.abs(field.fields) == pytest.approx(np.ones(4))


def test_other_units_are_converted(tmp_path):
    field = field_of(tmp_path, "direction_deg,time_ms\n90,0\n-180,2500\n")
    assert field.times == pytest.approx([0.0, 2.5])
    assert field.angles == pytest.approx([math.pi / 2, -math.pi])


def test_strengths_are_relative_and_an_empty_one_is_the_reference_field(tmp_path):
    rows = f"0,0,2\n1,0,\n2,0,0\n3,0,-0.5\n4,0,{STRENGTH_MAX:g}\n5,0,-{STRENGTH_MAX:g}\n"
    field = field_of(tmp_path, f"time_s,direction_rad,strength\n{rows}")
    assert field.fields.real.tolist() == [2.0, 1.0, 0.0, -0.5, STRENGTH_MAX, -STRENGTH_MAX]


def test_directions_of_a_clockwise_file_are_reversed_and_nothing_else(tmp_path):
    text = "time_s,direction_rad,strength\n0,0.5,1\n2,-1.5,0.3\n"
    usual = field_of(tmp_path, text)
    clockwise = field_of(tmp_path, text, upside_down=True)
    assert clockwise.angles.tolist() == (-usual.angles).tolist()
    assert clockwise.times.tolist() == usual.times.tolist()
    assert clockwise.fields == pytest.approx(usual.fields.conj())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,angle_rad\n0,1\n", "the column direction_rad is missing; the columns are time_s"),
        ("seconds,direction_rad\n0,1\n", "the column time_s is missing; the columns are seconds"),
        ("x,y\n0,1\n", "the column time_s is missing; the columns are x, y"),
        ("time_s,direction_rad\n", "no rows below its header"),
        ("time_s,direction_rad\n0,1\n2,1\n1,1\n", "line 4: the time is earlier"),
        ("time_s,direction_rad\n1,1\n0.5,1\n2,1\n", "line 3: the time is earlier"),
        ("time_s,direction_rad,strength\n0,0,1\n1,1,100.5\n", "line 3: strength: 100.5 is too"),
        ("time_s,direction_rad,strength\n0,0,-101\n", "line 2: strength: -101 is too large"),
        ("time_s,direction_rad\n0,0\n1,90\n2,180\n", "line 3"),  # degrees
        ("time_s,direction_rad\n0,one\n", "line 2"),
    ],
)
def test_a_file_that_cannot_be_read_is_one_line_with_its_place(tmp_path, text, says):
    with pytest.raises(UsageError) as error:
        field_of(tmp_path, text)
    first, *_ = str(error.value).splitlines()
    assert "field.csv" in first and says in first


def test_no_field_lasts_from_start_to_end():
    assert no_field(1.5, 4.0) == ((2.5, 0.0, 0.0),)


def remarks(tmp_path, times, begin, end):
    rows = "".join(f"{time},{0.1 * k}\n" for k, time in enumerate(times))
    field = field_of(tmp_path, f"time_s,direction_rad\n{rows}")
    return describe_clock_mismatches(field, "field.csv", "tracks.csv", begin, end)


@given(st.floats(0.0, 1e5), st.floats(5.0, 300.0), st.integers(2, 30))
def test_a_field_from_the_first_image_on_gets_no_remark(tmp_path_factory, begin, lasts_s, count):
    times = begin + np.linspace(0.0, lasts_s, count, endpoint=False)
    folder = tmp_path_factory.mktemp("field")
    assert remarks(folder, times, begin, begin + lasts_s) == ()


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ([11.0, 15.0], None),  # it covers nine tenths
        ([11.5, 15.0], "warning: field.csv covers only 8.5 s of the 10 s of tracks.csv"),
        ([2.0, 5.0, 9.0], "warning: only 0 of the 3 times of field.csv are within the 10 s"),
        ([5.0], None),  # the last direction has no end
    ],
)
def test_a_field_that_hardly_overlaps_with_the_tracks_gets_a_warning(tmp_path, times, says):
    lines = remarks(tmp_path, times, 10.0, 20.0)
    assert len(lines) == (says is not None)
    assert all(line.startswith(says) for line in lines)


def test_a_field_that_begins_after_the_tracks_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"field.csv, 20 to 30 s: no time in this file"):
        remarks(tmp_path, [20.0, 30.0], 10.0, 20.0)


@pytest.mark.parametrize("cells", [0, 2])
def test_too_few_cells_show_no_side(tmp_path, cells):
    field = field_of(tmp_path, "time_s,direction_rad\n0,1\n3,2\n")
    times = np.arange(0, 9, 0.1)
    paths = [np.column_stack([times, 10 * times, 3 * times**2]) for _ in range(cells)]
    assert describe_wrong_directions(field, paths) == ()
