"""Tests of a table and its writers, which give people and programs the same cells."""

import csv
import io
import json
import math
import re

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress
from testkit.paths import ROOT

from tetractl.core.errors import UsageError
from tetractl.tools.table.csv_rows import read_csv
from tetractl.tools.table.table import Column, Table, create_decimal_format
from tetractl.tools.table.table_files import (
    flatten,
    format_csv,
    format_csv_entry,
    format_json,
    open_table_files,
)
from tetractl.tools.table.terminal_table import (
    DEFAULT_WIDTH,
    TEXT_FORMATS,
    format_html,
    open_console,
    print_tables,
)

TABLE = Table(
    "Speeds",
    (
        Column("robot", ["green", "=1+1"]),
        Column("speed", np.array([180.25, math.nan]), "mm/s", create_decimal_format(1)),
        Column("moved", [True, None]),
        Column("note", ["a | b", "<b>"], words=True),
    ),
    "measured",
)


def printed(*tables, **console):
    """What a console shows of tables."""
    out = io.StringIO()
    print_tables(tables, Console(file=out, **console))
    return out.getvalue()


def csv_rows(table):
    """The rows of a table's CSV text as another program reads them, the names of columns first."""
    return list(csv.reader(io.StringIO(format_csv(table))))


def test_a_reader_sees_formats_units_and_what_is_not_known():
    assert TABLE.header == ["robot", "speed [mm/s]", "moved", "note"]
    assert list(TABLE.rows) == [("green", "180.2", "True", "a | b"), ("=1+1", "-", "-", "<b>")]
    written = [write([TABLE]) for write in TEXT_FORMATS.values()]
    for text in (printed(TABLE), *written):
        assert "180.2" in text
        assert "mm/s" in text or r"mm/\allowbreak{}s" in text
        assert "measured" in text
    assert r"| a \| b |" in TEXT_FORMATS["markdown"]([TABLE])


def test_a_data_file_has_the_values_and_the_unit_in_the_name():
    import pandas  # slow to import

    assert csv_rows(TABLE) == [
        ["robot", "speed_mm_s", "moved", "note"],
        ["green", "180.25", "true", "a | b"],
        ["'=1+1", "", "", "<b>"],
    ]
    assert pandas.DataFrame(TABLE.as_dict()).speed_mm_s.tolist()[0] == 180.25


def test_numbers_have_all_their_digits_and_unknown_ones_no_cell():
    numbers = [0.1, 1e-5, -0.0, 1e300, 5e-324, math.inf, math.nan, None, 2**64 - 1, True]
    words = ["a", 'say "no", twice', "=1", "null", "Infinity", "NaN", "x],[y", "ü", None, 1.5]
    places = list(range(10))
    columns = (Column("n", numbers), Column("i", places), Column("w", words))
    _, *lines = format_csv(Table("", columns)).splitlines()
    assert [line.split(",", 2) for line in lines] == [
        ["0.1", "0", "a"],
        ["0.00001", "1", '"say ""no"", twice"'],
        ["-0.0", "2", "'=1"],
        ["1e+300", "3", "null"],
        ["5e-324", "4", "Infinity"],
        ["inf", "5", "NaN"],
        ["", "6", '"x],[y"'],
        ["", "7", "ü"],
        ["18446744073709551615", "8", ""],
        ["true", "9", "1.5"],
    ]


def test_a_file_grows_by_the_rows_of_one_table_after_another(tmp_path):
    import pandas  # slow to import

    path = tmp_path / "speeds.csv"
    with open_table_files({"speeds": path}) as add:
        add("speeds", TABLE, "a.mcap")
        add("speeds", TABLE, "b.mcap")
        assert not path.exists()
    assert pandas.read_csv(path).speed_mm_s.isna().tolist() == [False, True] * 2
    assert [row.cells["note"] for row in read_csv(path)] == ["a | b", "<b>"] * 2


@pytest.mark.parametrize("folder", [".", "new", "new/inner"])
def test_other_columns_are_refused_and_leave_no_file(tmp_path, folder):
    path = tmp_path / folder / "speeds.csv"
    reason = r"b\.mcap: the columns of the table speeds differ from those of earlier logs: other"
    with pytest.raises(UsageError, match=reason), open_table_files({"speeds": path}) as add:
        add("speeds", TABLE, "a.mcap")
        add("speeds", TABLE.with_first(other=1), "b.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("Take 7\nof June\ntime_s,x_mm\n0,1\n", ["time_s", "x_mm"]),
        ("x_mm\n1\n2\n", ["x_mm"]),
        ("time_s x_mm\n0,1 1,5\n0,2 1,6\n", ["time_s", "x_mm"]),
        ("x_mm;\n1,5;\n", ["x_mm"]),
        ("# Take 7\ntime_s,x_mm\n0,1\n", ["time_s", "x_mm"]),
        ("word\nred\nblue\n", ["word"]),
    ],
)
def test_titles_above_a_header_are_left_out(tmp_path, text, columns):
    """Regression: "has 2 entries, the header has 1", of files of Imaris and of MOSAIC."""
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert list(next(read_csv(path)).cells) == columns


def test_a_narrow_terminal_drops_columns_and_never_breaks_a_number_or_a_unit():
    names = ("mean", "std", "median", "longest")
    columns = (
        Column("robot", ["green", "blue"]),
        *(Column(name, [1234.5678, 2.0], "mm", create_decimal_format(4)) for name in names),
    )
    narrow = {"force_terminal": True, "width": 40, "color_system": None}
    lines = printed(Table("Errors", columns), **narrow).splitlines()
    assert lines[1].split() == ["robot", "mean", "[mm]", "longest", "[mm]"]
    assert "1234.5678" in lines[3]
    assert "too narrow for: std [mm], median [mm]" in lines
    assert max(map(len, lines)) <= 40


def test_html_escapes_and_links_cells_of_the_first_column():
    text = format_html([TABLE], {"green": "#trial-1"})
    assert '<a href="#trial-1">green</a>' in text
    assert "&lt;b&gt;" in text and "<b>" not in text
    trials = format_html(
        [Table("", (Column("pair", ["a - b"]), Column("trials", ["20 and 20"], words=True)))]
    )
    assert '<td class="short">20 and 20</td>' in trials


def test_json_is_plain_and_strict():
    text = format_json({"a": np.array([1.0, math.inf]), "b": (np.int64(2), math.nan)})
    assert json.loads(text) == {"a": [1.0, None], "b": [2, None]}


def test_no_other_module_writes_tables():
    """CSV is read, CSV, tables of rich and of HTML are written in one package."""
    writers = r"\bcsv\.(reader|writer|Dict)|import csv\n|rich\.table|<table"
    texts = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "tetractl").rglob("*.py")
        if re.search(writers, path.read_text("utf-8"))
    }
    names = ("csv_rows", "table_files", "terminal_table")
    assert texts == {f"tetractl/tools/table/{name}.py" for name in names}


@pytest.mark.parametrize(
    "text",
    ["=cmd()", "+1", "-1", "@sum", "\tx", "\rx", " =1", "\n+1", "\xa0-1", "＝1", " ＋1", "﹫x"],
)
def test_a_spreadsheet_computes_nothing(text):
    assert format_csv_entry(text).startswith("'")
    assert format_csv_entry("arrived") == "arrived"


def test_a_table_without_rows_is_its_columns():
    columns = (Column("n", []), Column("w", []))
    assert format_csv(Table("", columns)) == "n,w\n"


def test_a_row_whose_only_entry_is_unknown_is_still_a_row():
    table = Table("", (Column("n", [1, None, 3]),))
    assert csv_rows(table) == [["n"], ["1"], [""], ["3"]]


LONG = "words " * 60


def test_without_a_terminal_words_are_wrapped():
    wide = Table.of_texts("Logs", ("log", "note"), [("a", LONG), ("b", LONG)])
    lines = printed(wide).splitlines()
    assert DEFAULT_WIDTH - 20 < max(map(len, lines)) <= DEFAULT_WIDTH


def test_without_a_terminal_names_are_not_broken():
    path = "folder/" * 40
    assert len(path) > DEFAULT_WIDTH
    text = printed(Table.of_texts("", ("log",), [(path,)]))
    assert path in text


def test_columns_that_are_empty_in_all_rows_are_left_out():
    table = Table.of_texts("", ("name", "empty", "why"), [("a", "-", ""), ("b", "", "x")])
    assert table.header == ["name", "why"]


def test_records_that_lack_a_key_have_no_value_there():
    table = Table.of_records("", [{"a": 1}, {"a": 2, "b": 3}])
    assert table.as_dict() == {"a": [1, 2], "b": [None, 3]}


def test_nested_items_become_one_row():
    nested = {"a": {"value": 1, "ci95": [0, 2]}, "b": {"ci95": None}, "c": ["x", "y"]}
    expected = {"a_value": 1, "a_low": 0, "a_high": 2, "b_low": None, "b_high": None, "c": "x; y"}
    assert flatten(nested) == expected


@pytest.mark.parametrize("forced", ["FORCE_COLOR", "TTY_COMPATIBLE"])
def test_a_file_gets_no_code_of_a_terminal_though_colour_is_forced(forced, monkeypatch, capsys):
    monkeypatch.setenv(forced, "1")
    console = open_console()
    with console.screen():
        console.print("in a file", style="bold")
    with Progress(console=console) as bar:
        bar.add_task("trials", total=2)
    assert not console.is_terminal
    print_tables([Table("Title", (Column("robot", ["green"]),))])
    assert "\x1b" not in capsys.readouterr().out
