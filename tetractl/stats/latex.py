"""Statistics as LaTeX tables that fit the width of the text they are pasted into."""

import re
from collections.abc import Sequence

from tetractl.core.text import printable
from tetractl.stats.comparison import Comparison
from tetractl.stats.rows import Grid, grids
from tetractl.stats.summary import Summary
from tetractl.stats.text import NONE

_FITTED = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
_WORDS = r">{\raggedright\arraybackslash}X"  # a column that breaks its lines
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
_MINUS = re.compile(r"(?<![\w.])-(?=\d)")


def as_latex(summary: Summary, comparison: Comparison | None = None) -> str:
    """Return a summary as `grids_latex` does."""
    return grids_latex(grids(summary, comparison))


def grids_latex(tables: Sequence[Grid]) -> str:
    r"""Return `tabular` and `tabularx` environments ready to paste.

    The document needs the packages booktabs, graphicx and tabularx. Numbers are made smaller where
    they are wider than the text, words broken. The first table's last line says what was steered.
    """
    parts = [r"% needs \usepackage{booktabs,graphicx,tabularx}"]
    for grid in tables:
        parts += [f"% {printable(grid.title)}", *(_words(grid) if grid.words else _numbers(grid))]
        parts.append("")
    return "\n".join(parts)


def _numbers(grid: Grid) -> list[str]:
    width = len(grid.header)
    note = rf"\multicolumn{{{width}}}{{l}}{{\footnotesize {_escaped(grid.note)}}} \\"
    begin = rf"\begin{{tabular}}{{l{'r' * (width - 1)}}}"
    return [_FITTED, begin, *_body(grid), note, r"\end{tabular}}"]


def _words(grid: Grid) -> list[str]:
    columns = _WORDS * len(grid.header)
    return [rf"\begin{{tabularx}}{{\linewidth}}{{{columns}}}", *_body(grid), r"\end{tabularx}"]


def _body(grid: Grid) -> list[str]:
    header, *rows = (" & ".join(map(_cell, row)) + r" \\" for row in (grid.header, *grid.rows))
    return [r"\toprule", header, r"\midrule", *rows, r"\bottomrule"]


def _cell(text: str) -> str:
    if text == NONE or text.startswith(f"{NONE} "):
        return f"-- {_escaped(text.removeprefix(NONE))}".strip()
    return (r"\quad " if text.startswith("  ") else "") + _escaped(text)


def _escaped(text: str) -> str:
    """Return text with its special characters written out, breakable after the parts of a path."""
    text = printable(text).strip().translate(_SPECIAL)
    text = _MINUS.sub("$-$", text).replace("[um]", r"[$\mu$m]")
    return text.replace("/", r"/\allowbreak{}")
