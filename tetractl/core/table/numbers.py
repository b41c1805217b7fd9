"""Numbers as text."""

import math
from collections.abc import Callable

NONE = "-"
"""The text for an unknown value."""


def fixed(decimals: int) -> Callable[[float], str]:
    """Return a format with the given number of decimals."""

    def show(value: float | None) -> str:
        return NONE if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"

    return show


def lengths(scale: float, finest: int = 9) -> Callable[[float], str]:
    """Return a format for lengths of about `scale`: three digits, one decimal below 1000.

    The format has at most `finest` decimals.
    """
    scale = abs(scale)
    size = math.floor(math.log10(scale)) if math.isfinite(scale) and scale > 0 else 1
    return fixed(min(max(2 - size, int(size < 3)), finest))


def digits(value: float) -> str:
    """Return a number as text with three significant digits."""
    if value <= 0 or not math.isfinite(value):
        return fixed(0)(value)
    return fixed(min(max(2 - math.floor(math.log10(value)), 0), 9))(value)


def p_value(p: float) -> str:
    """Return a p-value as text with two digits."""
    if not math.isfinite(p):
        return NONE
    return f"{p:.2g}" if p >= 0.001 else "< 0.001"
