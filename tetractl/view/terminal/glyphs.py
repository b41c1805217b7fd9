"""Small drawings made of characters, for views in a terminal: arrows, bars, and curves."""

import math
from collections.abc import Sequence

import numpy as np
from rich.text import Text

from tetractl.core.poses import Floats

ARROWS = "→↗↑↖←↙↓↘"
"""Eight directions, anticlockwise from +x."""
DONE = "━"
OPEN = "─"
"""Character of the open part of a bar. DONE is that of the done part."""
SPARKS = "▁▂▃▄▅▆▇█"
"""Characters of a sparkline, from low to high."""
TO_COME = "·"
"""Character of a sparkline for values to come."""
LEAST = 1e-12
"""Minimum value on a logarithmic scale. Smaller values are shown as if they were this."""


def arrow(angle: float) -> str:
    """Return the arrow character nearest to an angle from +x [rad]. For NaN, it points along +x."""
    if not math.isfinite(angle):
        return ARROWS[0]
    return ARROWS[round(math.remainder(angle, math.tau) / (math.pi / 4)) % len(ARROWS)]


def bar(width: int, fraction: float, style: str) -> Text:
    """Return a horizontal bar of characters, such as for a robot's distance to its target.

    Args:
        width: Number of characters.
        fraction: Fraction of the bar that is filled. The whole bar is filled if it is unknown.
        style: Style of the filled part.
    """
    filled = width
    if math.isfinite(fraction):
        filled = round(width * min(max(fraction, 0.0), 1.0))
    return Text.assemble((DONE * filled, style), (OPEN * (width - filled), "dim"))


def sparkline(
    values: Sequence[float] | Floats,
    width: int,
    *,
    total: int = 0,
    log: bool = False,
) -> Text:
    """Return a curve of values as a line of small bars, with dots for values still to come.

    Args:
        values: The values.
        width: Maximum number of bars.
        total: Number of values that the line has space for, at least as many as are given.
        log: Whether the scale is logarithmic, from the minimum value. If not, it begins at 0.
    """
    y = np.asarray(values, dtype=float)
    y = np.where(np.isfinite(y), y, np.nan)
    if not len(y) or np.isnan(y).all() or width < 1:
        return Text(TO_COME * max(width, 0), "dim")
    bars = [SPARKS[level] for level in _levels(y, log)]
    total = max(total, len(bars))
    cells = min(width, total)
    edges = (np.arange(cells) + 1) * total / cells
    newest = np.ceil(edges).astype(int) - 1  # index of the newest value of each cell
    drawn = [bars[index] for index in newest if index < len(bars)]
    shown_to = newest[len(drawn) - 1] + 1 if drawn else 0
    if len(drawn) < cells and len(bars) > shown_to:  # the first values of the next cell
        drawn.append(bars[-1])
    return Text.assemble("".join(drawn), (TO_COME * (cells - len(drawn)), "dim"))


def _levels(y: Floats, log: bool) -> list[int]:
    """Return the height of each value as an index into SPARKS, the highest for unknown values.

    The lowest height is 0 on a linear scale, and the minimum of the values if `log` is true.
    """
    if log:
        y = np.log(np.maximum(y, LEAST))
    low = np.nanmin(y) if log else 0.0
    high = np.nanmax(y)
    share = np.zeros_like(y)
    if high > low:
        share = (np.clip(y, low, high) - low) / (high - low)
    highest = len(SPARKS) - 1
    levels = np.nan_to_num(share * highest, nan=highest).round()
    return levels.astype(int).tolist()
