"""Write tables for people: to a terminal, and as Markdown, LaTeX and HTML."""

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING

from tetractl.core.errors import printable
from tetractl.tools.table.table import NONE, Table
from tetractl.tools.terminal import is_terminal

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable

LISTED_MAX = 20
"""Maximum number of problems, or trials with problems, that are listed."""
WIDTH = 120
"""Line width in characters if there is no terminal; a longer word is not broken."""

SHORT = 12
"""Maximum length of an entry of a page's table that is not broken [characters]."""

_FITTED = r"\noindent\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
_WORDS = r">{\raggedright\arraybackslash}X"  # a LaTeX column with wrapped text
_SPECIAL = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"$<$",
        ">": r"$>$",
        **{c: "\\" + c for c in "&%$#_{}"},
    }
)
_UM = re.compile(r"\bum\b")
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
    """Print tables to a terminal, or as plain text of WIDTH characters if there is none.

    By default, they are printed to stdout.
    """
    console = console or open_console()
    for table in tables:
        _print(table, console)


def _print(table: Table, console: "Console") -> None:
    from rich.console import Console
    from rich.text import Text

    fitted = _fitting(table, console) if console.is_terminal else table
    drawn = _drawn(fitted, console.is_terminal)
    if not console.is_terminal:
        console = Console(file=console.file, width=10_000, color_system=None)
        console.width = max(WIDTH, _least_width(drawn, console))
    console.print(Text(printable(table.title), style="bold"), soft_wrap=not console.is_terminal)
    console.print(drawn)
    headings = {column.heading for column in fitted.columns}
    left_out = [column.heading for column in table.columns if column.heading not in headings]
    notes = [f"too narrow for: {', '.join(left_out)}"] if left_out else []
    for line in [*notes, *table.note.splitlines()]:
        console.print(Text(printable(line)), soft_wrap=not console.is_terminal)
    console.print()


def _fitting(table: Table, console: "Console") -> Table:
    """Select as many columns as fit into a terminal without breaking a number or a word.

    These are the first columns, and the last one.
    """
    columns = table.columns
    while len(columns) > 2 and _least_width(_drawn(table, True), console) > console.width:
        columns = (*columns[:-2], columns[-1])
        table = replace(table, columns=columns)
    return table


def _least_width(drawn: "RichTable", console: "Console") -> int:
    from rich.measure import Measurement

    wide = console.options.update(width=10_000)
    return Measurement.get(console, wide, drawn).minimum


def _drawn(table: Table, terminal: bool) -> "RichTable":
    """Convert a table to a table of the library rich.

    Words are wrapped. Numbers and units are not broken. Without a terminal, names and paths in the
    first column are not broken either.
    """
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    drawn = RichTable(box=box.SIMPLE_HEAD, show_edge=False)
    for i, column in enumerate(table.columns):
        texts = [column.heading, *column.texts]
        unbroken = not column.words or (i == 0 and not terminal)
        if unbroken:
            least = max(Text(text).cell_len for text in texts)
        else:
            words = [word for text in texts for word in text.split()]
            least = max((Text(word).cell_len for word in words), default=0)
            longest = max(Text(text).cell_len for text in texts)
            least = max(least, min(16, longest))
        drawn.add_column(
            Text(column.heading),
            justify="left" if column.words or i == 0 else "right",
            overflow="fold",
            no_wrap=unbroken,
            min_width=least if unbroken or not terminal else None,
        )
    for row in table.rows:
        drawn.add_row(*(Text(printable(entry)) for entry in row))
    return drawn


def markdown(tables: Sequence[Table]) -> str:
    """Format tables as text in Markdown. The note of a table becomes a list below it."""
    parts = []
    for table in tables:
        first, *others = table.columns
        rule = ["---", *("---" if column.words else "---:" for column in others)]
        parts.append(f"**{_markdown(table.title)}**\n")
        parts += [
            "| " + " | ".join(map(_markdown, line)) + " |"
            for line in ([first.heading, *table.header[1:]], rule, *table.rows)
        ]
        parts += ["", *(f"- {_markdown(line)}" for line in table.note.splitlines()), ""]
    return "\n".join(parts)


def _markdown(text: str) -> str:
    return printable(text).replace("\\", "\\\\").replace("|", "\\|")


def latex(tables: Sequence[Table]) -> str:
    r"""Format tables as LaTeX: `tabular` and `tabularx` environments that fit the text's width.

    The document needs the packages booktabs, graphicx and tabularx. Tables of numbers that are too
    wide are set smaller; in tables of words the words are wrapped. Title and note are below.
    """
    parts = [r"% needs \usepackage{booktabs,graphicx,tabularx}"]
    for table in tables:
        notes = [table.title, *table.note.splitlines()]
        comment = " ".join(notes).strip()
        parts.append(f"% {printable(comment)}")
        header, *rows = (
            " & ".join(map(_latex_cell, row)) + r" \\" for row in (table.header, *table.rows)
        )
        body = [r"\toprule", header, r"\midrule", *rows, r"\bottomrule"]
        width = len(table.columns)
        if table.words:
            begin = rf"\noindent\begin{{tabularx}}{{\linewidth}}{{{_WORDS * width}}}"
            parts += [begin, *body, r"\end{tabularx}", ""]
        else:
            note = _escaped("; ".join(filter(None, notes)))
            begin = rf"\begin{{tabular}}{{l{'r' * (width - 1)}}}"
            below = rf"\par\medskip{{\footnotesize\raggedright {note}.\par}}"
            parts += [_FITTED, begin, *body, r"\end{tabular}}", below, ""]
    return "\n".join(parts)


def _latex_cell(text: str) -> str:
    if text == NONE or text.startswith(f"{NONE} "):
        return f"-- {_escaped(text.removeprefix(NONE))}".strip()
    return (r"\quad " if text.startswith("  ") else "") + _escaped(text)


def _escaped(text: str) -> str:
    """Escape LaTeX's special characters in a text.

    A first "[" is also escaped, because it would belong to the end of the row above. A path may
    break after each part.
    """
    text = printable(text).strip().translate(_SPECIAL)
    text = re.sub(r"^\[", "{[}", text)
    text = _UM.sub(r"$\\mu$m", _MINUS.sub("$-$", text))
    return text.replace("/", r"/\allowbreak{}")


def html(tables: Sequence[Table], links: Mapping[str, str] | None = None) -> str:
    """Format tables as HTML, each in an element that scrolls.

    `links` maps the text of an entry in the first column to the address that it links to.
    """
    return "".join(_html(table, links or {}) for table in tables)


def _html(table: Table, links: Mapping[str, str]) -> str:
    def named(text: str) -> str:
        escaped = escape(text)
        return f'<a href="{escape(links[text])}">{escaped}</a>' if text in links else escaped

    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.header)
    rows = ""
    for first, *entries in table.rows:
        cells = ""
        for entry in entries:
            unbroken = ' class="short"' if len(entry) <= SHORT else ""  # such as "20 and 20"
            cells += f"<td{unbroken}>{escape(entry)}</td>"
        rows += f'<tr><th scope="row">{named(first)}</th>{cells}</tr>'
    kind = ' class="words"' if table.words else ""
    caption = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    lines = "<br>".join(map(escape, table.note.splitlines()))
    note = f'<p class="note">{lines}</p>' if lines else ""
    return (
        f'<div class="scroll"><table{kind}>{caption}'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{note}</div>"
    )


TEXTS: Mapping[str, Callable[[Sequence[Table]], str]] = {
    "markdown": markdown,
    "latex": latex,
    "html": html,
}
