"""Tests of tables for people: on a terminal, in Markdown, in LaTeX and in HTML."""

import io
import math
import sys

import pytest
from rich.console import Console

from tetractl.tools.table import terminal_table as module
from tetractl.tools.table.table import (
    Column,
    Table,
    create_decimal_format,
    create_length_format,
    format_digits,
    format_p_value,
    format_value,
    join_listed,
    pluralize,
)
from tetractl.tools.table.terminal_table import (
    DEFAULT_WIDTH,
    SHORT_ENTRY_MAX,
    format_html,
    format_latex,
    format_markdown,
    open_console,
    print_tables,
)

NUMBERS = Table(
    "Errors",
    (
        Column("robot", ["green", "blue"]),
        Column("mean", [1.25, -2.0], "mm", create_decimal_format(1)),
    ),
    "n = 3\nmeasured",
)
WORDS = Table(
    "Faults",
    (Column("robot", ["a"]), Column("what", ["its radio is silent"], words=True)),
)


def printed(table, **console):
    out = io.StringIO()
    print_tables([table], Console(file=out, **console))
    return out.getvalue().splitlines()


TERMINAL = {"force_terminal": True, "color_system": None}


@pytest.mark.parametrize("console", [{}, TERMINAL | {"width": 80}])
def test_a_table_has_its_title_headings_rows_and_notes(console):
    title, headings, rule, first, second, *notes, empty = printed(NUMBERS, **console)
    assert title.rstrip() == "Errors"
    assert headings.split() == ["robot", "mean", "[mm]"]
    assert set(rule.strip()) == {"─"}
    assert first.split() == ["green", "1.2"]
    assert second.split() == ["blue", "-2.0"]
    assert [note.rstrip() for note in notes] == ["n = 3", "measured"]
    assert empty == ""


def test_names_and_words_are_on_the_left_and_numbers_on_the_right():
    _, headings, _, first, second, *_ = printed(NUMBERS)
    assert first.rstrip().endswith("1.2")
    assert len(first.rstrip()) == len(second.rstrip()) == len(headings.rstrip())
    assert headings.index("robot") == first.index("green") == second.index("blue")
    _, headings, _, row, *_ = printed(WORDS)
    assert headings.index("what") == row.index("its")


def test_foreign_text_cannot_command_a_terminal():
    table = Table("t\x1b[2J", (Column("x", ["a\x1b[2J"]),), "n\x1b[2J")
    assert "\x1b" not in "\n".join(printed(table))


def wide(count):
    return Table("T", tuple(Column(f"column{i}", ["12345678"]) for i in range(count)))


def test_a_terminal_that_is_wide_enough_shows_all_columns():
    lines = printed(wide(4), **TERMINAL, width=60)
    assert not [line for line in lines if "too narrow" in line]
    lines = printed(wide(4), **TERMINAL, width=30)
    assert "column0" in lines[1] and "column3" in lines[1]
    assert "too narrow for: column1, column2" in " ".join(" ".join(lines).split())


def test_two_columns_are_always_shown():
    lines = printed(wide(2), **TERMINAL, width=10)
    assert not [line for line in lines if "too narrow" in line]


def test_without_a_terminal_nothing_is_left_out():
    lines = printed(wide(40))
    assert max(map(len, lines)) > DEFAULT_WIDTH
    assert not [line for line in lines if "too narrow" in line]


def test_markdown_aligns_numbers_to_the_right_and_escapes_bars():
    table = Table(
        "a | b",
        (Column("robot", ["x|y"]), Column("n", [3]), Column("w", ["\\"], words=True)),
        "note | 1\nnote 2",
    )
    assert format_markdown([table]).splitlines() == [
        r"**a \| b**",
        "",
        "| robot | n | w |",
        "| --- | ---: | --- |",
        r"| x\|y | 3 | \\ |",
        "",
        r"- note \| 1",
        "- note 2",
    ]


def test_latex_of_numbers_fits_the_line_and_of_words_wraps():
    numbers = format_latex([NUMBERS]).splitlines()
    assert numbers[0] == r"% needs \usepackage{booktabs,graphicx,tabularx}"
    assert numbers[1] == "% Errors n = 3 measured"
    assert r"\begin{tabular}{lr}" in numbers
    assert r"robot & mean {[}mm] \\" in numbers or r"robot & mean [mm] \\" in numbers
    assert r"blue & $-$2.0 \\" in numbers
    assert any("Errors; n = 3; measured." in line for line in numbers)
    words = format_latex([WORDS])
    assert r"\begin{tabularx}{\linewidth}" in words
    assert r"\begin{tabular}{" not in words


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("-", "--"),
        ("- (2)", "-- (2)"),
        ("-3", "$-$3"),
        ("a-b", "a-b"),
        ("1 - 2", "1 $-$ 2"),
        ("  inner", r"\quad inner"),
        ("50 %", r"50 \%"),
        ("a_b & c", r"a\_b \& c"),
        ("< 3", r"$<$ 3"),
        ("[1]", "{[}1]"),
        ("um", r"$\mu$m"),
        ("sum", "sum"),
        ("a/b", r"a/\allowbreak{}b"),
        ("\\", r"\textbackslash{}"),
    ],
)
def test_an_entry_of_latex_is_escaped(text, written):
    rows = format_latex([Table("", (Column("x", [text]),))]).splitlines()
    assert rf"{written} \\" in rows


def test_html_has_a_caption_and_a_note_only_if_there_are_any():
    text = format_html([NUMBERS])
    assert "<caption>Errors</caption>" in text
    assert '<p class="note">n = 3<br>measured</p>' in text
    bare = format_html([Table("", (Column("x", ["1"]),))])
    assert "<caption>" not in bare
    assert "note" not in bare
    assert 'class="words"' in format_html([WORDS])
    assert 'class="words"' not in text


@pytest.mark.parametrize(
    ("length", "is_short"), [(SHORT_ENTRY_MAX, True), (SHORT_ENTRY_MAX + 1, False)]
)
def test_a_short_entry_of_html_is_not_broken(length, is_short):
    table = Table("", (Column("x", ["a"]), Column("y", ["b" * length])))
    assert ('<td class="short">' in format_html([table])) == is_short


def test_only_entries_with_an_address_are_links():
    text = format_html([NUMBERS], {"green": "a&b", "1.2": "x"})
    assert '<a href="a&amp;b">green</a>' in text
    assert text.count("<a ") == 1


# formats of numbers


@pytest.mark.parametrize(
    ("scale", "value", "text"),
    [
        (1234.0, 1234.5, "1234"),
        (999.0, 999.0, "999.0"),
        (100.0, 123.46, "123.5"),
        (12.0, 12.346, "12.3"),
        (1.2, 1.2346, "1.23"),
        (-1.2, -1.2346, "-1.23"),
        (0.012, 0.012346, "0.0123"),
        (1e-12, 0.0, "0.000000000"),
        (0.0, 3.14159, "3.1"),
        (math.nan, 3.14159, "3.1"),
        (1.0, math.nan, "-"),
        (1.0, None, "-"),
        (1.0, math.inf, "-"),
    ],
)
def test_lengths_have_three_digits_of_their_scale(scale, value, text):
    assert create_length_format(scale)(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1234.5, "1234"), (123.45, "123"), (12.345, "12.3"), (1.2345, "1.23"), (0.12345, "0.123"),
        (0.0, "0"), (-1.5, "-2"), (math.nan, "-"), (math.inf, "-"), (1e-12, "0.000000000"),
    ],
)  # fmt: skip
def test_digits_are_three(value, text):
    assert format_digits(value) == text


@pytest.mark.parametrize(
    ("p", "text"),
    [(0.04567, "0.046"), (0.001, "0.001"), (0.00099, "< 0.001"), (1.0, "1"), (math.nan, "-")],
)
def test_a_p_value_has_two_digits_or_a_limit(p, text):
    assert format_p_value(p) == text


def test_words_follow_their_counts():
    assert [pluralize("log", count) for count in (0, 1, 2)] == ["logs", "log", "logs"]


@pytest.mark.parametrize(
    ("count", "text"), [(0, ""), (1, "0"), (4, "0, 1, 2, 3"), (5, "0, 1, 2, 3 and 1 more")]
)
def test_a_listing_names_four_and_counts_the_rest(count, text):
    assert join_listed([str(i) for i in range(count)]) == text


@pytest.mark.parametrize("stderr", [False, True])
def test_a_console_writes_to_its_stream(stderr, capsys):
    open_console(stderr=stderr).print("text")
    said = capsys.readouterr()
    assert (said.err if stderr else said.out) == "text\n"
    assert (said.out if stderr else said.err) == ""


@pytest.mark.parametrize(("out", "err"), [(True, False), (False, True)])
def test_a_console_is_a_terminal_if_its_stream_is_one(monkeypatch, out, err):
    terminals = {id(sys.stdout): out, id(sys.stderr): err}
    monkeypatch.setattr(module, "is_terminal", lambda stream: terminals[id(stream)])
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert open_console().is_terminal is out
    assert open_console(stderr=True).is_terminal is err


def test_a_quiet_console_writes_nothing(capsys):
    open_console(stderr=True, quiet=True).print("text")
    assert capsys.readouterr().err == ""


def test_unknown_values_are_dashes():
    assert [format_value(value) for value in (None, math.nan, 0, "", False)] == [
        "-", "-", "0", "", "False",
    ]  # fmt: skip


def test_a_column_of_a_data_file_ends_in_its_unit():
    assert Column("speed", [], "mm/s").key == "speed_mm_s"
    assert Column("speed", []).key == "speed"
    assert Column("speed", [], "mm/s").heading == "speed [mm/s]"
    assert len(Table("", ())) == 0
    assert len(NUMBERS) == 2


def test_a_table_is_of_words_if_any_column_but_the_first_is():
    first = Table("", (Column("a", ["x"], words=True), Column("n", [1])))
    assert not first.words
    assert WORDS.words


def test_constants_are_put_in_front_of_every_row():
    longer = NUMBERS.with_first(log="a", trial=3)
    assert list(longer.rows) == [("a", "3", "green", "1.2"), ("a", "3", "blue", "-2.0")]
    assert longer.note == NUMBERS.note
