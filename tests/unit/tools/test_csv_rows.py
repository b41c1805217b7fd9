"""Tables in the forms in which programs write them, and which of their lines name the columns."""

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.errors import UsageError
from tetractl.tools.table.csv_rows import (
    has_decimal_comma,
    read_column_names,
    read_csv,
    split_entries,
)

NAMES = ("time_s", "x_mm", "robot")
ROWS = [("0.0", "1.5", "green"), ("0.2", "-2.25", "blue"), ("0.4", "", "red")]


def table(path):
    return [tuple(row.cells.values()) for row in read_csv(path)]


def written(path, text, encoding="utf-8"):
    path.write_text(text, encoding=encoding, newline="")
    return path


@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_table_is_read_as_it_was_written(tmp_path, separator, end, encoding):
    path = tmp_path / "t.csv"
    with path.open("w", encoding=encoding, newline="") as file:
        csv.writer(file, delimiter=separator, lineterminator=end).writerows([NAMES, *ROWS])
    assert read_column_names(path) == NAMES
    assert table(path) == ROWS
    assert [row.line for row in read_csv(path)] == [2, 3, 4]


def test_latin_1_and_characters_that_look_the_same_are_read(tmp_path):
    assert read_column_names(written(tmp_path / "t.csv", "Länge,x\n1,2\n", "cp1252")) == (
        "Länge",
        "x",
    )
    assert read_column_names(written(tmp_path / "t.csv", "\uff58,y\n1,2\n")) == ("x", "y")


@pytest.mark.parametrize("lines", ["", "made by a camera\n", "made by a camera\nwith 3 robots\n"])
def test_the_header_that_numpy_writes_is_the_comment_just_above_the_numbers(tmp_path, lines):
    path = tmp_path / "t.csv"
    values = np.array([[0.0, 1.5], [0.2, -2.25]])
    np.savetxt(path, values, delimiter=",", header=f"{lines}time_s,x_mm")
    assert read_column_names(path) == ("time_s", "x_mm")
    assert np.array(table(path), dtype=float).tolist() == values.tolist()


@pytest.mark.parametrize("above", ["# a\n# b,c\n", "\n\n", "# a\n\n", "sep=,\n", "Tracks\n", ""])
def test_what_stands_above_names_is_no_header(tmp_path, above):
    path = written(tmp_path / "t.csv", f"{above}time_s,x_mm\n0,1\n1,2\n")
    assert read_column_names(path) == ("time_s", "x_mm")
    assert table(path) == [("0", "1"), ("1", "2")]


def test_a_separator_that_is_stated_is_used_for_every_line(tmp_path):
    path = written(tmp_path / "t.csv", "sep=;\na,b;c\n1,5;2\n")
    assert read_column_names(path) == ("a,b", "c")
    assert table(path) == [("1.5", "2")]


def test_blanks_separate_if_nothing_else_does(tmp_path):
    path = written(tmp_path / "t.csv", "time_s  x_mm\n 0  1\n 1  2\n")
    assert table(path) == [("0", "1"), ("1", "2")]


@given(st.decimals(allow_nan=False, allow_infinity=False, places=3))
def test_a_decimal_comma_is_read_unless_commas_separate(number):
    text = f"{number:f}".replace(".", ",")
    assert has_decimal_comma(text)
    assert split_entries(f"{text};a", ";") == [f"{number:f}", "a"]
    assert len(split_entries(f"{text},a", ",")) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n3,4\n", "no header"),
        ("# 1,2\n3,4\n", "no header"),
        ("a,a\n1,2\n", "the same name, a"),
        ("a,b\n1,2,3\n", "line 2: this line has 3 entries, but the header has 2"),
        ("a,b\n1,2\na,b\n3,4\n", "line 3: the header occurs a second time"),
        ("a,b\n1,\0\n", "line 2: .* null"),
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        table(written(tmp_path / "t.csv", text))


def test_rows_may_be_shorter_than_the_header_or_empty_or_end_with_separators(tmp_path):
    path = written(tmp_path / "t.csv", "a,b,\n\n1,2,\n,,\n3\n")
    assert table(path) == [("1", "2"), ("3", "")]


@pytest.mark.parametrize("start", [b"\x1f\x8b", b"PK\x03\x04"])
def test_a_compressed_file_is_refused(tmp_path, start):
    path = tmp_path / "t.csv"
    path.write_bytes(start + b"a,b\n1,2\n")
    with pytest.raises(UsageError, match="compressed"):
        table(path)
