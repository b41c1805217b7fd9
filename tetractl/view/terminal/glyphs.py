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
    """Return a bar of `width` characters, `fraction` of it filled."""
    done = round(width * min(max(fraction, 0.0), 1.0)) if math.isfinite(fraction) else width
    return Text.assemble((glyphs.bar[0] * done, style), (glyphs.bar[1] * (width - done), "dim"))


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
    if log:
        y = np.log(np.maximum(y, 1e-12))
    low, high = (np.nanmin(y) if log else 0.0), np.nanmax(y)
    y = np.clip(y, low, high)
    shape = (y - low) / (high - low) if high > low else np.zeros_like(y)
    level = np.nan_to_num(shape * (len(glyphs.spark) - 1), nan=len(glyphs.spark) - 1).round()
    total = max(total, len(y))
    cells = min(width, total)
    edges = (np.arange(cells) + 1) * total / cells
    last = np.ceil(edges).astype(int) - 1  # the newest value of each cell
    drawn = [glyphs.spark[int(level[i])] for i in last if i < len(y)]
    if len(drawn) < cells and len(y) > (last[len(drawn) - 1] + 1 if drawn else 0):
        drawn.append(glyphs.spark[int(level[-1])])
    return Text.assemble("".join(drawn), (glyphs.rest * (cells - len(drawn)), "dim"))
