"""Small drawings made of characters, for views in a terminal: arrows, bars, and curves."""

import math
from collections.abc import Sequence

import numpy as np
from rich.text import Text

from tetractl.core.poses import Floats

ARROWS = "→↗↑↖←↙↓↘"
"""Eight directions, anticlockwise from +x."""
FILLED_CHARACTER = "━"
"""Character of the filled part of a bar."""
OPEN_CHARACTER = "─"
"""Character of the open part of a bar."""
SPARKS = "▁▂▃▄▅▆▇█"
"""Characters of a sparkline, from low to high."""
FUTURE_CHARACTER = "·"
"""Character of a sparkline for values to come."""
LOG_MIN = 1e-12
"""Minimum value on a logarithmic scale. A smaller value is shown like this one."""


def arrow(angle: float) -> str:
    """Return the arrow character nearest to an angle from +x [rad]. For NaN, it points along +x."""
    if not math.isfinite(angle):
        return ARROWS[0]
    return ARROWS[round(math.remainder(angle, math.tau) / (math.pi / 4)) % len(ARROWS)]


def bar(width: int, fraction: float, style: str) -> Text:
    """Draw a horizontal bar of characters, for example for a robot's distance to its target.

    Args:
        width: Number of characters.
        fraction: Fraction of the bar that is filled. If it is NaN, the whole bar is filled.
        style: Style of the filled part.
    """
    filled = width
    if math.isfinite(fraction):
        filled = round(width * min(max(fraction, 0.0), 1.0))
    return Text.assemble(
        (FILLED_CHARACTER * filled, style), (OPEN_CHARACTER * (width - filled), "dim")
    )


def sparkline(
    values: Sequence[float] | Floats,
    width: int,
    *,
    total: int = 0,
    log: bool = False,
) -> Text:
    """Draw a curve of values as a line of small bars, with dots for values still to come.

    Args:
        values: The values.
        width: Maximum number of bars.
        total: Number of values that the whole line stands for. It is at least the number of values.
        log: Whether the scale is logarithmic, from the minimum value. Otherwise, it begins at 0.
    """
    finite = np.asarray(values, dtype=float)
    finite = np.where(np.isfinite(finite), finite, np.nan)
    if not len(finite) or np.isnan(finite).all() or width < 1:
        return Text(FUTURE_CHARACTER * max(width, 0), "dim")
    bars = [SPARKS[level] for level in _bar_heights(finite, log)]
    total = max(total, len(bars))
    cells = min(width, total)
    ends = (np.arange(cells) + 1) * total / cells
    newest = np.ceil(ends).astype(int) - 1  # index of the newest value of each cell
    shown = [bars[index] for index in newest if index < len(bars)]
    shown_to = newest[len(shown) - 1] + 1 if shown else 0
    if len(shown) < cells and len(bars) > shown_to:  # the first values of the next cell
        shown.append(bars[-1])
    return Text.assemble("".join(shown), (FUTURE_CHARACTER * (cells - len(shown)), "dim"))


def _bar_heights(values: Floats, log: bool) -> list[int]:
    """Compute the height of each value as an index into SPARKS. A NaN gets the greatest height.

    The lowest height is 0 on a linear scale, and the minimum of the values if `log` is true.
    """
    if log:
        values = np.log(np.maximum(values, LOG_MIN))
    bottom = np.nanmin(values) if log else 0.0
    top = np.nanmax(values)
    fraction = np.zeros_like(values)
    if top > bottom:
        fraction = (np.clip(values, bottom, top) - bottom) / (top - bottom)
    highest = len(SPARKS) - 1
    levels = np.nan_to_num(fraction * highest, nan=highest).round()
    return levels.astype(int).tolist()
