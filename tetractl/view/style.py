"""The common style of all figures (marks, lines, sizes of type and paper), and their saving.

`core/colors.py` explains what the colours mean.
"""

import io
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib import style
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from tetractl.core import colors
from tetractl.core.errors import UsageError
from tetractl.tools.files import write_atomically

INK = colors.INK
GREY = colors.GREY
FAINT = colors.FAINT
ALARM = colors.ALARM
SLATES = colors.SLATES
OBSTACLE: dict[str, Any] = {"fc": colors.OBSTACLE, "ec": colors.OBSTACLE_EDGE, "lw": 0.6}
TARGET: dict[str, Any] = {"marker": "s", "mfc": "none", "ls": "none"}
LIMIT: dict[str, Any] = {"color": GREY, "lw": 0.9, "ls": "--"}
"""Line style of a limit, or of a published value."""
WHOLE = SLATES[0]
"""Colour of what belongs to no single robot: the signal, a total error, the chosen search."""
_DASHES = ("-", "--", ":")

COLUMN_IN = 3.5  # width of a column of an IEEE page
PAGE_IN = 7.16  # width of two columns with the gap between them
FORMATS = ("png", "svg", "pdf")
PRINT_DPI = 300  # dots per inch of pictures for paper
SCREEN_DPI = 200  # dots per inch of pictures for slides and notebooks
SCREEN_PX_PER_IN = 110  # size at which a notebook shows a figure

HEADLINE_IN = 0.135  # height of a line of a headline, at 7 points
HEADLINE_GAP_IN = 0.03  # between a headline and the upper edge of the figure
HEADLINE_LETTERS_PER_IN = 17
GRID_LW = 0.6  # width of the lines of a grid [points]
NOTE_PT = 6.5  # size of type of a note inside a panel [points]
LEGEND_GAP_IN = 0.06  # between a legend and the axes below it

RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # part of matplotlib, so the same everywhere
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "axes.titlesize": 8,
    "axes.titleweight": "normal",
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "pdf.fonttype": 42,  # embeds fonts, so that text can be searched
    "svg.fonttype": "none",
    "svg.hashsalt": "tetractl",  # the same log gives the same file
}
_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None, "Creator": "tetractl", "Producer": None},
}


@contextmanager
def styled() -> Iterator[None]:
    """Apply the common style to figures drawn in the block, then restore matplotlib's settings."""
    with style.context(RC, after_reset=True):
        yield


class ShownFigure(Figure):
    """A figure that a notebook shows, without pyplot and without `%matplotlib inline`."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return the figure as PNG for a notebook, with the width at which it is shown on paper."""
        width_px = round(self.get_figwidth() * SCREEN_PX_PER_IN)
        return picture(self, "png", SCREEN_DPI), {"width": width_px}


def figure(width_in: float, height_in: float) -> Figure:
    """Create an empty figure of a width and a height [in]. No display is needed."""
    return ShownFigure(figsize=(width_in, height_in), layout="constrained")


def headline(drawing: Figure, text: str, alarm: str = "") -> None:
    """Write a headline at the top of a figure and, below it, a warning.

    The figure becomes taller by these lines, and its axes keep their size.

    Args:
        drawing: The figure.
        text: The line.
        alarm: The warning. Empty for none.
    """
    alarm_lines = textwrap.wrap(alarm, int(HEADLINE_LETTERS_PER_IN * drawing.get_figwidth()))
    old_in = drawing.get_figheight()
    new_in = old_in + HEADLINE_IN * (1 + len(alarm_lines)) + HEADLINE_GAP_IN
    above_in = _lower_legends(drawing, old_in / new_in)
    drawing.set_figheight(new_in)
    engine = drawing.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0.0, 0.0, 1.0, (old_in - above_in) / new_in))
    for row, line in enumerate([text, *alarm_lines]):
        color = ALARM if row else GREY
        top = 1 - (HEADLINE_GAP_IN + row * HEADLINE_IN) / new_in
        with styled():
            drawing.text(0.01, top, line, va="top", ha="left", fontsize=7, color=color)


def _lower_legends(drawing: Figure, fraction: float) -> float:
    """Move each legend above the axes down, into the lower fraction `fraction` of the figure.

    The layout engine would place them next to the headline, not below it.

    Returns:
        The legends' height [in].
    """
    if not drawing.legends:
        return 0.0
    engine = drawing.get_layout_engine()
    if engine is not None:
        engine.execute(drawing)
    above_in = 0.0
    for legend in drawing.legends:
        box = legend.get_window_extent()
        if box.y0 > drawing.bbox.height / 2:
            above_in = max(above_in, box.height / drawing.dpi + LEGEND_GAP_IN)
            legend.set_bbox_to_anchor((0.0, 0.0, 1.0, fraction), transform=drawing.transFigure)
    return above_in


def grid_of_heights(axes: Axes) -> None:
    """Draw a grid line through each tick of the y axis, behind everything else."""
    axes.grid(axis="y", color=FAINT, linewidth=GRID_LW)
    axes.set_axisbelow(True)


def batch_look(number: int) -> dict[str, Any]:
    """Return colour and line style of the batch with this index, from 0.

    All colours are used with the first line style, then with the next. In the end, looks repeat.
    """
    cycle, shade = divmod(number, len(SLATES))
    return {"color": SLATES[shade], "ls": _DASHES[cycle % len(_DASHES)]}


def panel(axes: Axes, letter: str, title: str, x: str = "", y: str = "") -> None:
    """Set the title of a panel to "(LETTER) TITLE", and the labels of its axes.

    Args:
        axes: The axes.
        letter: The letter.
        title: The title.
        x: Label of the x axis.
        y: Label of the y axis.
    """
    axes.set_title(f"({letter}) {title}", loc="left")
    axes.set(xlabel=x, ylabel=y)


def sign(label: str, **look: Any) -> Line2D:
    """Create an entry of a legend, by default a grey marker without a line."""
    whole_look: dict[str, Any] = {"color": GREY, "ls": "none", "label": label, **look}
    return Line2D([], [], **whole_look)


def legend(drawing: Figure, signs: Sequence[Artist], columns: int = 3, **look: Any) -> None:
    """Put the legend of a figure below its panels.

    Args:
        drawing: The figure.
        signs: What the legend shows.
        columns: Number of columns.
        **look: Further arguments of `Figure.legend`.
    """
    drawing.legend(handles=signs, loc="outside lower center", ncols=columns, **look)


def file_format(path: Path, formats: Iterable[str] = FORMATS, what: str = "picture") -> str:
    """Return the format of a file to write, from the ending of its name.

    Args:
        path: The file.
        formats: The possible formats.
        what: The kind of contents, such as "picture", which the error message names.

    Raises:
        UsageError: If the ending is none of `formats`, if the file's folder does not exist, or if
            the path is a folder.
    """
    format_name = path.suffix.lower().removeprefix(".")
    if format_name not in formats:
        problem = f"cannot write '{path.suffix}' {what}s"
        if not format_name:
            problem = f"the ending of the file name must state the format of the {what}"
        endings = ", ".join(f".{name}" for name in formats)
        raise UsageError(f"{path}: {problem}", f"use one of the endings {endings}")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise UsageError(
            f"{path}: this is a folder, but a file is needed", "name a file in this folder"
        )
    return format_name


def save(drawing: Figure, path: Path, dpi: float = PRINT_DPI) -> None:
    """Write a figure to a file. The same figure always gives the same bytes.

    Args:
        drawing: The figure.
        path: The file.
        dpi: Resolution [dots per inch].
    """
    write_atomically(path, picture(drawing, file_format(path), dpi))


def picture(drawing: Figure, wanted: str, dpi: float = PRINT_DPI) -> bytes:
    """Return a figure as the bytes of an image file. The same figure always gives the same bytes.

    Args:
        drawing: The figure.
        wanted: Format of the file, such as "png".
        dpi: Resolution [dots per inch].
    """
    file = io.BytesIO()
    with styled():
        drawing.savefig(file, format=wanted, metadata=_METADATA[wanted], dpi=dpi)
    return file.getvalue()


def svg(drawing: Figure) -> bytes:
    """Return a figure as the bytes of an SVG file."""
    return picture(drawing, "svg")
