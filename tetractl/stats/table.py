"""Statistics as tables in a terminal and in Markdown, with the rows of every other form."""

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tetractl.core.text import printable
from tetractl.stats.comparison import Comparison
from tetractl.stats.rows import Grid, grids
from tetractl.stats.summary import Summary

_PLAIN_WIDTH = 1000  # characters; without a terminal no line is wrapped or cut


def print_table(summary: Summary, console: Console, comparison: Comparison | None = None) -> None:
    """Print the summary, as `print_grids`."""
    print_grids(grids(summary, comparison), console)


def print_grids(tables: Sequence[Grid], console: Console) -> None:
    """Print tables; plain lines of full length where there is no terminal."""
    if not console.is_terminal:
        console = Console(file=console.file, width=_PLAIN_WIDTH, color_system=None)
    for grid in tables:
        table = Table(box=box.SIMPLE_HEAD, show_edge=False)
        for i, name in enumerate(grid.header):
            table.add_column(Text(name), justify="right" if i and not grid.words else "left")
        for row in grid.rows:
            table.add_row(*(Text(printable(cell)) for cell in row))
        console.print(Text(printable(grid.title), style="bold"))
        console.print(table)
        console.print()


def as_markdown(summary: Summary, comparison: Comparison | None = None) -> str:
    """Return Markdown tables."""
    return grids_markdown(grids(summary, comparison))


def grids_markdown(tables: Sequence[Grid]) -> str:
    """Return tables in Markdown."""
    parts = []
    for grid in tables:
        rule = ["---"] + ["---" if grid.words else "---:"] * (len(grid.header) - 1)
        lines = [grid.header, rule, *grid.rows]
        parts.append(f"**{_markdown(grid.title)}**\n")
        parts += ["| " + " | ".join(map(_markdown, line)) + " |" for line in lines]
        parts.append("")
    return "\n".join(parts)


def _markdown(text: str) -> str:
    return printable(text).replace("\\", "\\\\").replace("|", "\\|")
