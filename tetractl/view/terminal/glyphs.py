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
SPARK_CHARACTERS = "▁▂▃▄▅▆▇█"
"""Characters of a draw_sparkline, from low to high."""
FUTURE_CHARACTER = "·"
"""Character of a draw_sparkline for values to come."""
LOG_MIN = 1e-12
"""Minimum value on a logarithmic scale. A smaller value is shown like this one."""


def choose_arrow(angle: float) -> str:
    """Return the arrow character nearest to an angle from +x [rad]. For NaN, it points along +x."""
    if not math.isfinite(angle):
        return ARROWS[0]
    return ARROWS[round(math.remainder(angle, math.tau) / (math.pi / 4)) % len(ARROWS)]


def draw_bar(width: int, fraction: float, style: str) -> Text:
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


def draw_sparkline(
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
    bars = [SPARK_CHARACTERS[level] for level in _bar_heights(finite, log)]
    total = max(total, len(bars))
    n_cells = min(width, total)
    cell_ends = (np.arange(n_cells) + 1) * total / n_cells
    newest_indices = np.ceil(cell_ends).astype(int) - 1  # index of the newest value of each cell
    shown_bars = [bars[index] for index in newest_indices if index < len(bars)]
    shown_to = newest_indices[len(shown_bars) - 1] + 1 if shown_bars else 0
    # the newest values belong to a cell that is not complete yet
    if len(shown_bars) < n_cells and len(bars) > shown_to:
        shown_bars.append(bars[-1])
    return Text.assemble(
        "".join(shown_bars), (FUTURE_CHARACTER * (n_cells - len(shown_bars)), "dim")
    )


def _bar_heights(values: Floats, log: bool) -> list[int]:
    """Compute the height of each value's bar, as an index into SPARK_CHARACTERS.

    A NaN gets the maximum height. The lowest bar stands for 0 on a linear scale and, if `log` is
    true, for the minimum of the values.
    """
    if log:
        values = np.log(np.maximum(values, LOG_MIN))
    bottom = np.nanmin(values) if log else 0.0
    top = np.nanmax(values)
    fraction = np.zeros_like(values)
    if top > bottom:
        fraction = (np.clip(values, bottom, top) - bottom) / (top - bottom)
    highest = len(SPARK_CHARACTERS) - 1
    levels = np.nan_to_num(fraction * highest, nan=highest).round()
    return levels.astype(int).tolist()
