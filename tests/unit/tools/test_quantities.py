"""Tests of distinguishing directions in degrees from directions that count turns."""

from pathlib import Path

import numpy as np
import pytest

from tetractl.core.errors import UsageError
from tetractl.tools.table.csv_rows import CsvRow
from tetractl.tools.table.quantities import (
    METRES,
    SECONDS,
    NumberColumn,
    create_order_error,
    find_column,
    find_factor,
    find_time,
    read_boolean,
    refuse_degrees,
    split_header,
)

RANDOM = np.random.default_rng(3).uniform(-np.pi, np.pi, 200)
COUNTED_ON = {
    "a field that reverses": 6.07 + np.pi * np.arange(4),  # half turns, rounded up and down
    "a field that rotates": 1.3 * np.arange(100),
    "random directions, unwrapped": np.unwrap(RANDOM),
    "random directions around a later turn": 40 * np.pi + RANDOM,
    "a count that begins again": np.tile(0.7 * np.arange(60), 3),
    "small steps, far on": 300 + 0.05 * np.arange(50),
}
IN_DEGREES = {
    "random": np.degrees(RANDOM),
    "a field that reverses": np.tile([0.0, 180.0], 20),
    "a field that rotates, from 0 to 360": np.arange(0, 3600, 5) % 360.0,
    "a field that rotates, from -180 to 180": np.arange(0, 3600, 5) % 360.0 - 180,
    "quarter turns, each held": np.repeat([0.0, 90.0, 180.0, 270.0], 30),
    "one direction": np.array([90.0]),
}


def refuse(angles):
    column = NumberColumn("direction_rad")
    refuse_degrees(Path("field.csv"), column, range(2, len(angles) + 2), angles)


@pytest.mark.parametrize("name", COUNTED_ON)
def test_directions_that_count_turns_are_right(name):
    """Regression: the rotating field of a reproduced paper was taken for degrees."""
    refuse(COUNTED_ON[name])


@pytest.mark.parametrize("name", IN_DEGREES)
def test_directions_in_degrees_are_refused(name):
    with pytest.raises(UsageError, match=r"is more than a whole turn, which is 6.283 rad"):
        refuse(IN_DEGREES[name])


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("w [°/s]", "deg_s"),
        ("w (degrees/second)", "deg_s"),
        ("w [rad/s]", "rad_s"),
        ("w_deg_s", "deg_s"),
        ("w_deg/s", "deg_s"),
        ("w/deg", "deg"),
        ("w [mm/sec]", "mm_s"),
        ("w [µm]", "um"),
        ("w [turns/s]", "turns_s"),  # no unit that is known
        ("w", ""),
    ],
)
def test_a_unit_may_be_spelled_in_parts(header, unit):
    """Regression: "column w [°/s] is in °_s"."""
    assert split_header(header) == ("w", unit)


ROW = CsvRow(7, {"x_mm": "1.5", "bad": "x", "none": "", "valid": "no", "big": "2e9"})
FILE = Path("t.csv")


@pytest.mark.parametrize("text", ["", "nan", "NaN", "NA", "n/a", "#N/A", "null", "None", "-"])
def test_an_entry_without_a_number_is_unknown_or_refused(text):
    row = CsvRow(3, {"x": text})
    assert np.isnan(NumberColumn("x").read_optional(FILE, row))
    with pytest.raises(UsageError, match=r"t\.csv, line 3: x: this is not a number"):
        NumberColumn("x").number(FILE, row)


def test_a_number_is_converted_by_the_factor_of_its_column():
    assert NumberColumn("x_mm").number(FILE, ROW) == 1.5
    assert NumberColumn("x_mm", 1e-3).read_optional(FILE, ROW) == pytest.approx(0.0015)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("lost", "if nothing was measured, leave the entry empty"),
        ("12:30", "write numbers like 1234.5"),
        ("3 mm", "write numbers like 1234.5"),
        ("1,5", "a decimal comma needs semicolons"),
        ("inf", "if nothing was measured"),
        ("2e9", "write numbers like"),
        ("-2e9", "if nothing was measured"),
    ],
)
def test_what_is_no_number_is_refused_with_what_helps(text, hint):
    with pytest.raises(UsageError) as caught:
        NumberColumn("x").number(FILE, CsvRow(3, {"x": text}))
    assert f"t.csv, line 3: x: {text!r} is not a number of at most 1e+09" in caught.value.message
    assert caught.value.hint.startswith(hint)


@pytest.mark.parametrize("value", [1e9, -1e9, 0.0])
def test_a_number_may_be_as_large_as_the_limit(value):
    assert NumberColumn("x").number(FILE, CsvRow(1, {"x": repr(value)})) == value


def test_a_column_is_found_by_its_name_in_a_known_unit():
    headers = ["x_um", "y", "time_ms", "x_m"]
    column = find_column(FILE, headers, ("x",), METRES)
    assert (column.key, column.factor) == ("x_um", 1e-6)
    assert find_column(FILE, headers, ("z",), METRES) is None
    time = find_time(FILE, headers)
    assert (time.key, time.factor) == ("time_ms", 1e-3)
    assert time.number(FILE, CsvRow(1, {"time_ms": "1764000000000000000"})) > 1e9
    assert find_time(FILE, ["x"]) is None
    both = find_column(FILE, ["a", "b_s", "a_s"], ("a",), SECONDS)
    assert both.key == "a_s"  # the one with a unit counts


@pytest.mark.parametrize(
    ("header", "says"),
    [("x_km", None), ("x", "column x states no unit"), ("x_s", "column x_s is in s")],
)
def test_a_column_in_another_unit_is_refused_with_the_units_that_are_known(header, says):
    if says is None:
        assert find_column(FILE, [header], ("x",), METRES) is None  # of another quantity
        return
    with pytest.raises(UsageError, match=says) as caught:
        find_column(FILE, [header], ("x",), METRES)
    assert caught.value.hint == "name it x_um or x_mm"


@pytest.mark.parametrize(
    ("unit", "metres"), [("mm", 1e-3), (" MM ", 1e-3), ("micron", 1e-6), ("meter", 1.0)]
)
def test_a_unit_in_any_spelling_has_its_factor(unit, metres):
    assert find_factor(unit, METRES) == metres
    assert find_factor("furlong", METRES) is None
    assert find_factor("seconds", METRES) is None


@pytest.mark.parametrize(
    ("text", "value"),
    [("true", True), ("TRUE", True), ("1", True), ("yes", True), ("", True), ("false", False),
     ("0", False), ("No", False)],
)  # fmt: skip
def test_truth_is_written_in_several_ways(text, value):
    assert read_boolean(FILE, CsvRow(1, {"valid": text}), "valid") is value


def test_a_table_without_the_column_is_true_and_another_word_is_refused():
    assert read_boolean(FILE, CsvRow(1, {}), "valid") is True
    with pytest.raises(UsageError, match=r"line 4: valid: maybe is neither true nor false"):
        read_boolean(FILE, CsvRow(4, {"valid": "maybe"}), "valid")


def test_times_that_fall_are_told_what_to_do():
    error = create_order_error(FILE, ROW, "; or number them")
    assert error.message == "t.csv, line 7: the time is earlier than in the line before"
    assert error.hint == "sort the rows by time; or number them"


def test_directions_within_a_turn_or_in_a_column_of_degrees_are_right():
    refuse(np.array([0.0, 6.28, -6.28]))
    degrees = NumberColumn("direction_deg", np.pi / 180)
    refuse_degrees(FILE, degrees, [2], np.array([90.0]))


def test_a_direction_in_degrees_is_named_with_its_line_and_what_to_rename():
    with pytest.raises(UsageError) as caught:
        refuse_degrees(FILE, NumberColumn("u_rad"), [2, 5, 9], np.array([1.0, 90.0, 180.0]))
    assert caught.value.message.startswith("t.csv, line 5: u_rad: 90 is more than a whole turn")
    assert caught.value.hint.endswith("or rename the column to u_deg")
