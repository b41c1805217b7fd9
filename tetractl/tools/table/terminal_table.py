"""Write tables for people: to a terminal, and as Markdown, LaTeX and HTML."""

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING

from tetractl.core.errors import printable
from tetractl.tools.table.table import UNKNOWN_TEXT, Table
from tetractl.tools.terminal import is_terminal

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable

LISTED_MAX = 20
"""Maximum number of problems, or trials with problems, that are listed."""
DEFAULT_WIDTH = 120
"""Line width in characters if there is no terminal; a longer word is not broken."""

SHORT_ENTRY_MAX = 12
"""Maximum length of an entry of a page's table that is not broken [characters]."""

_LATEX_RESIZEBOX = r"\noindent\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
_LATEX_WORDS_COLUMN = r">{\raggedright\arraybackslash}X"  # a LaTeX column with wrapped text
_LATEX_SPECIAL = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"$<$",
        ">": r"$>$",
        **{c: "\\" + c for c in "&%$#_{}"},
    }
)
_MICROMETRE = re.compile(r"\bum\b")
_MINUS = re.compile(r"(?<![\w.])-(?=\d)|(?<= )-(?= )")


def open_console(stderr: bool = False, quiet: bool = False) -> "Console":
    """Return rich's console of stdout or stderr.

    Unless the stream is a terminal, the console sends no terminal codes, even if FORCE_COLOR or
    TTY_COMPATIBLE is set, as in notebooks and CI.
    """
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    return Console(
        stderr=stderr, quiet=quiet, force_terminal=None if is_terminal(stream) else False
    )


def print_tables(tables: Sequence[Table], console: "Console | None" = None) -> None:
    """Print tables to a terminal, or as plain text of DEFAULT_WIDTH characters if there is none.

    Args:
        tables: The tables.
        console: Console of the library rich. None for stdout.
    """
    console = console or open_console()
    for table in tables:
        _print_table(table, console)


def _print_table(table: Table, console: "Console") -> None:
    from rich.console import Console
    from rich.text import Text

    fitting = _select_fitting_columns(table, console) if console.is_terminal else table
    rich_table = _convert_to_rich(fitting, console.is_terminal)
    if not console.is_terminal:
        console = Console(file=console.file, width=10_000, color_system=None)
        console.width = max(DEFAULT_WIDTH, _measure_width(rich_table, console))
    console.print(Text(printable(table.title), style="bold"), soft_wrap=not console.is_terminal)
    console.print(rich_table)
    headings = {column.heading for column in fitting.columns}
    left_out = [column.heading for column in table.columns if column.heading not in headings]
    notes = [f"too narrow for: {', '.join(left_out)}"] if left_out else []
    for line in [*notes, *table.note.splitlines()]:
        console.print(Text(printable(line)), soft_wrap=not console.is_terminal)
    console.print()


def _select_fitting_columns(table: Table, console: "Console") -> Table:
    """Select as many columns as fit into a terminal without breaking a number or a word.

    These are the first columns, and the last one.
    """
    columns = table.columns
    while (
        len(columns) > 2 and _measure_width(_convert_to_rich(table, True), console) > console.width
    ):
        columns = (*columns[:-2], columns[-1])
        table = replace(table, columns=columns)
    return table


def _measure_width(rich_table: "RichTable", console: "Console") -> int:
    from rich.measure import Measurement

    wide = console.options.update(width=10_000)
    return Measurement.get(console, wide, rich_table).minimum


def _convert_to_rich(table: Table, to_terminal: bool) -> "RichTable":
    """Convert a table to a table of the library rich.

    Words are wrapped. Numbers and units are not broken. Without a terminal, names and paths in the
    first column are not broken either.
    """
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    rich_table = RichTable(box=box.SIMPLE_HEAD, show_edge=False)
    for i, column in enumerate(table.columns):
        entries = [column.heading, *column.texts]
        is_unbroken = not column.words or (i == 0 and not to_terminal)
        if is_unbroken:
            width_min = max(Text(text).cell_len for text in entries)
        else:
            all_words = [word for text in entries for word in text.split()]
            width_min = max((Text(word).cell_len for word in all_words), default=0)
            text_width = max(Text(text).cell_len for text in entries)
            width_min = max(width_min, min(16, text_width))
        rich_table.add_column(
            Text(column.heading),
            justify="left" if column.words or i == 0 else "right",
            overflow="fold",
            no_wrap=is_unbroken,
            min_width=width_min if is_unbroken or not to_terminal else None,
        )
    for row in table.rows:
        rich_table.add_row(*(Text(printable(entry)) for entry in row))
    return rich_table


def format_markdown(tables: Sequence[Table]) -> str:
    """Format tables as text in Markdown. The note of a table becomes a list below it."""
    blocks = []
    for table in tables:
        first_column, *other_columns = table.columns
        rule_cells = ["---", *("---" if column.words else "---:" for column in other_columns)]
        blocks.append(f"**{_escape_markdown(table.title)}**\n")
        blocks += [
            "| " + " | ".join(map(_escape_markdown, cells)) + " |"
            for cells in ([first_column.heading, *table.header[1:]], rule_cells, *table.rows)
        ]
        blocks += ["", *(f"- {_escape_markdown(cells)}" for cells in table.note.splitlines()), ""]
    return "\n".join(blocks)


def _escape_markdown(entry: str) -> str:
    return printable(entry).replace("\\", "\\\\").replace("|", "\\|")


def format_latex(tables: Sequence[Table]) -> str:
    r"""Format tables as LaTeX: `tabular` and `tabularx` environments that fit the text's width.

    The document needs the packages booktabs, graphicx and tabularx. Tables of numbers that are too
    wide are set smaller; in tables of words the words are wrapped. Title and note are below.
    """
    blocks = [r"% needs \usepackage{booktabs,graphicx,tabularx}"]
    for table in tables:
        notes = [table.title, *table.note.splitlines()]
        comment = " ".join(notes).strip()
        blocks.append(f"% {printable(comment)}")
        header, *rows = (
            " & ".join(map(_format_latex_cell, row)) + r" \\" for row in (table.header, *table.rows)
        )
        table_lines = [r"\toprule", header, r"\midrule", *rows, r"\bottomrule"]
        width = len(table.columns)
        if table.words:
            begin_environment = (
                rf"\noindent\begin{{tabularx}}{{\linewidth}}{{{_LATEX_WORDS_COLUMN * width}}}"
            )
            blocks += [begin_environment, *table_lines, r"\end{tabularx}", ""]
        else:
            note = _escape_latex("; ".join(filter(None, notes)))
            begin_environment = rf"\begin{{tabular}}{{l{'r' * (width - 1)}}}"
            note_below = rf"\par\medskip{{\footnotesize\raggedright {note}.\par}}"
            blocks += [
                _LATEX_RESIZEBOX,
                begin_environment,
                *table_lines,
                r"\end{tabular}}",
                note_below,
                "",
            ]
    return "\n".join(blocks)


def _format_latex_cell(text: str) -> str:
    if text == UNKNOWN_TEXT or text.startswith(f"{UNKNOWN_TEXT} "):
        return f"-- {_escape_latex(text.removeprefix(UNKNOWN_TEXT))}".strip()
    return (r"\quad " if text.startswith("  ") else "") + _escape_latex(text)


def _escape_latex(text: str) -> str:
    """Escape LaTeX's special characters in a text.

    A first "[" is also escaped, because it would belong to the end of the row above. A path may
    break after each part.
    """
    text = printable(text).strip().translate(_LATEX_SPECIAL)
    text = re.sub(r"^\[", "{[}", text)
    text = _MICROMETRE.sub(r"$\\mu$m", _MINUS.sub("$-$", text))
    return text.replace("/", r"/\allowbreak{}")


def format_html(tables: Sequence[Table], links: Mapping[str, str] | None = None) -> str:
    """Format tables as HTML, each in an element that scrolls.

    `links` maps the text of an entry in the first column to the address that it links to.
    """
    return "".join(_format_html_table(table, links or {}) for table in tables)


def _format_html_table(table: Table, links: Mapping[str, str]) -> str:
    def link(entry: str) -> str:
        escaped = escape(entry)
        return f'<a href="{escape(links[entry])}">{escaped}</a>' if entry in links else escaped

    header_cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.header)
    rows = ""
    for first_entry, *entries in table.rows:
        cells = ""
        for entry in entries:
            entry_class = (
                ' class="short"' if len(entry) <= SHORT_ENTRY_MAX else ""
            )  # such as "20 and 20"
            cells += f"<td{entry_class}>{escape(entry)}</td>"
        rows += f'<tr><th scope="row">{link(first_entry)}</th>{cells}</tr>'
    table_class = ' class="words"' if table.words else ""
    caption = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    note_html = "<br>".join(map(escape, table.note.splitlines()))
    note = f'<p class="note">{note_html}</p>' if note_html else ""
    return (
        f'<div class="scroll"><table{table_class}>{caption}'
        f"<thead><tr>{header_cells}</tr></thead><tbody>{rows}</tbody></table>{note}</div>"
    )


TEXT_FORMATS: Mapping[str, Callable[[Sequence[Table]], str]] = {
    "markdown": format_markdown,
    "latex": format_latex,
    "html": format_html,
}
