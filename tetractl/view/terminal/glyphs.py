"""The characters of the terminal views, in Unicode and in ASCII."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.text import Text

from tetractl.core.poses import Floats


@dataclass(frozen=True, slots=True)
class Glyphs:
    """A set of characters, by default in Unicode."""

    ascii: bool = False
    arrows: str = "→↗↑↖←↙↓↘"  # eight directions, anticlockwise from +x
    start: str = "○"
    target: str = "□"
    box: str = "┌┐┘└─│"  # corners from top left clockwise, then horizontal and vertical
    bar: str = "━─"  # characters for the done and the open part of a bar
    spark: str = "▁▂▃▄▅▆▇█"  # characters of a sparkline, from low to high
    rest: str = "·"  # character for values to come in a sparkline
    degree: str = "°"
    play: str = "▶"
    pause: str = "‖"
    times: str = "×"
    plus_minus: str = "±"
    left_right: str = "←→"
    to: str = "→"


LEAST = 1e-12
"""Values below it are shown as if they were this, on a logarithmic scale."""
UNICODE = Glyphs()
ASCII = Glyphs(
    True, ">/^\\</v\\", "o", "+", "++++-|", "=-", "_.-~=*%#", ".", " deg", ">", "=", "x", "+/-",
    "arrows", "->",
)  # fmt: skip


def glyphs_for(console: Console) -> Glyphs:
    """Return Unicode glyphs, or ASCII for a terminal that lacks cursor control, UTF-8 or colour.

    Without colour the robots' dots look alike: the ASCII view distinguishes them by number.
    """
    plain = console.is_dumb_terminal or console.options.ascii_only or console.no_color
    return ASCII if plain else UNICODE


def arrow(glyphs: Glyphs, angle: float) -> str:
    """Return the arrow nearest to an angle [rad]."""
    return glyphs.arrows[eighth(angle)]


def eighth(angle: float) -> int:
    """Return the index of the nearest eighth of a turn, 0 to 7 anticlockwise from +x; 0 for NaN."""
    if not math.isfinite(angle):
        return 0
    return round(math.remainder(angle, math.tau) / (math.pi / 4)) % 8


def bar(glyphs: Glyphs, width: int, fraction: float, style: str) -> Text:
    """Return a bar of `width` characters, `fraction` of it filled; all for an unknown one."""
    filled = width
    if math.isfinite(fraction):
        filled = round(width * min(max(fraction, 0.0), 1.0))
    full, empty = glyphs.bar
    return Text.assemble((full * filled, style), (empty * (width - filled), "dim"))


def sparkline(
    glyphs: Glyphs,
    values: Sequence[float] | Floats,
    width: int,
    *,
    total: int = 0,
    log: bool = False,
) -> Text:
    """Return at most `width` bars that show values, from 0 or, with `log`, on a logarithmic scale
    from the least value.

    The line has room for `total` values, or for the given ones if these are more; dots stand for
    values still to come.
    """
    y = np.asarray(values, dtype=float)
    y = np.where(np.isfinite(y), y, np.nan)
    if not len(y) or np.isnan(y).all() or width < 1:
        return Text(glyphs.rest * max(width, 0), "dim")
    bars = [glyphs.spark[level] for level in _levels(y, len(glyphs.spark), log)]
    total = max(total, len(bars))
    cells = min(width, total)
    edges = (np.arange(cells) + 1) * total / cells
    newest = np.ceil(edges).astype(int) - 1  # index of the newest value of each cell
    drawn = [bars[index] for index in newest if index < len(bars)]
    shown_to = newest[len(drawn) - 1] + 1 if drawn else 0
    if len(drawn) < cells and len(bars) > shown_to:  # the first values of the next cell
        drawn.append(bars[-1])
    return Text.assemble("".join(drawn), (glyphs.rest * (cells - len(drawn)), "dim"))


def _levels(y: Floats, count: int, log: bool) -> list[int]:
    """Return the level of each value, 0 to count - 1: the highest for a value that is unknown."""
    if log:
        y = np.log(np.maximum(y, LEAST))
    low = np.nanmin(y) if log else 0.0
    high = np.nanmax(y)
    share = np.zeros_like(y)
    if high > low:
        share = (np.clip(y, low, high) - low) / (high - low)
    highest = count - 1
    levels = np.nan_to_num(share * highest, nan=highest).round()
    return levels.astype(int).tolist()
