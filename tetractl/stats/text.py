"""Numbers and intervals as text for tables."""

import math
from collections.abc import Callable

from tetractl.stats.estimate import Interval

NONE = "-"


def fixed(decimals: int) -> Callable[[float], str]:
    """Return a function that writes a number with so many decimals, NONE for one not finite."""

    def show(value: float) -> str:
        return f"{value:.{decimals}f}" if math.isfinite(value) else NONE

    return show


def lengths(scale: float, finest: int = 9) -> Callable[[float], str]:
    """Return a function that writes lengths with three digits for one of the size of `scale`.

    Below 1000 it writes one decimal at least, and never more than `finest`.
    """
    scale = abs(scale)
    size = math.floor(math.log10(scale)) if math.isfinite(scale) and scale > 0 else 1
    return fixed(min(max(2 - size, int(size < 3)), finest))


def digits(value: float) -> str:
    """Return a number with three significant digits."""
    if value <= 0 or not math.isfinite(value):
        return fixed(0)(value)
    return fixed(min(max(2 - math.floor(math.log10(value)), 0), 9))(value)


def span(interval: Interval, show: Callable[[float], str]) -> str:
    """Return both ends of an interval, or the reason why there is none."""
    if interval.known:
        return f"{show(interval.low)} to {show(interval.high)}"
    return f"none: {interval.reason}" if interval.reason else NONE


def percent(interval: Interval) -> str:
    """Return the interval of a share in brackets, "" where there is none."""
    if not interval.known:
        return ""
    return f" (95 % interval {100 * interval.low:.0f} to {100 * interval.high:.0f} %)"


def p_value(p: float) -> str:
    """Return a p-value with two digits."""
    if not math.isfinite(p):
        return NONE
    return f"{p:.2g}" if p >= 0.001 else "< 0.001"
