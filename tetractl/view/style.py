"""The style of every figure: colours, type sizes, sizes on paper; and saving a figure."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.core.errors import UsageError

INK, GREY, FAINT = "#222222", "#8A8A8A", "#D0D0D0"
OBSTACLE, OBSTACLE_EDGE = "#F6DF8B", "#B8960C"
ALARM = "#B00020"

COLUMN_IN, PAGE_IN = 3.5, 7.16  # widths of one and two columns of an IEEE page
FORMATS = ("png", "svg", "pdf")

RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same picture everywhere
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
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # text stays text
    "svg.fonttype": "none",
    "svg.hashsalt": "tetractl",  # the same file from the same log
}
_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None, "Creator": "tetractl", "Producer": None},
}


def unit_of(unit: str) -> str:
    """Return the length unit as papers write it."""
    return unit.replace("um", "µm")


@contextmanager
def styled() -> Iterator[None]:
    """Apply this style to what is drawn inside the block, and restore matplotlib's settings."""
    with style.context(RC, after_reset=True):
        yield


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure that needs no display."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def headline(drawing: Figure, text: str) -> None:
    """Write a line above everything else in a figure."""
    with styled():
        drawing.suptitle(text, x=0.01, ha="left", fontsize=7, color=GREY)


def panel(axes: Axes, letter: str, title: str) -> None:
    """Set the title of a panel: (a) what it shows."""
    axes.set_title(f"({letter}) {title}", loc="left")


def file_format(path: Path) -> str:
    """Return the picture format of a file's name.

    Raises UsageError for a name without one, and where the file's folder does not exist.
    """
    wanted = path.suffix.lower().removeprefix(".")
    if wanted not in FORMATS:
        raise UsageError(
            f"{path}: cannot write '{path.suffix}' pictures"
            if wanted
            else f"{path}: the name of a picture needs an ending",
            f"end the name in {', '.join('.' + name for name in FORMATS)}",
        )
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: there is no folder {path.parent}")
    return wanted


def save(drawing: Figure, path: Path) -> None:
    """Write a figure; the same figure gives the same bytes."""
    wanted = file_format(path)
    with styled():
        drawing.savefig(path, format=wanted, metadata=_METADATA[wanted])


def svg(drawing: Figure) -> bytes:
    """Return a figure as SVG; the same figure gives the same bytes."""
    picture = io.BytesIO()
    with styled():
        drawing.savefig(picture, format="svg", metadata=_METADATA["svg"])
    return picture.getvalue()
