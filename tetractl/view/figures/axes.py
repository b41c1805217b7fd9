"""Helpers for the axes of figures: logarithmic axes, and the names of categories."""

import re
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import (
    FuncFormatter,
    LogFormatterMathtext,
    LogLocator,
    MaxNLocator,
    NullFormatter,
)

from tetractl.core.poses import Floats

LOG_RATIO_MIN = 30
"""Ratio of the largest error to the smallest from which on their axis is logarithmic."""
EVEN_RATIO = 5
"""Ratio of the limits of a logarithmic axis below which its ticks are even."""
MARKED_RATIO = 1000
"""Ratio below which there are ticks at 1, 2 and 5 of each decade."""
DECIMAL_MIN = 1e-3
"""Minimum lower limit of a logarithmic axis whose ticks are decimal."""
DECIMAL_MAX = 1e5
"""Maximum upper limit of a logarithmic axis whose ticks are decimal."""
FLAT_RATIO = 1.1
"""Maximum ratio of values that count as equal."""
FLAT_MARGIN_FACTOR = 1.05
"""Factor by which the axis extends beyond values that count as equal."""
EMPTY_LIMITS = (0.1, 10.0)
"""Limits of a logarithmic axis without values."""
CHARACTER_IN = 0.05
"""Width of a character of a category's name [in]."""
LINE_IN = 0.1
"""Height of a line of a category's name [in]."""
SMALL_NAMES_MIN = 50
"""Number of categories from which on their names are small."""
NAME_PT = 6
"""Font size of the names of fewer than SMALL_NAMES_MIN categories [pt]."""
SMALL_NAME_PT = 4
"""Font size of the names of SMALL_NAMES_MIN categories or more [pt]."""


def positive(values: Floats) -> Floats:
    """Return the values that a logarithmic axis can show; all others become NaN.

    The axis can show finite numbers above 0.
    """
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def set_log_axis(axes: Axes, values: Floats, below: float, above: float) -> None:
    """Make the y axis of a figure logarithmic, with limits and ticks that suit some values.

    The ticks are even if the limits have a ratio below 5, at 1, 2 and 5 of each decade below 1000,
    otherwise at each decade. All have the same format: decimal if the limits lie between 0.001 and
    100,000 or have a ratio below 5, else powers of ten.

    Args:
        axes: The axes.
        values: The values.
        below: How far the axis extends below the values, as a fraction of their range.
        above: How far it extends above them, as a fraction of their range.
    """
    lower_limit, upper_limit = _log_limits(values, below, above)
    ratio = upper_limit / lower_limit
    axes.set_yscale("log")
    axes.set_ylim(lower_limit, upper_limit)
    if ratio < EVEN_RATIO:
        axes.yaxis.set_major_locator(MaxNLocator(4))
    elif ratio < MARKED_RATIO:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    else:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0,)))
    if (lower_limit >= DECIMAL_MIN and upper_limit <= DECIMAL_MAX) or ratio < EVEN_RATIO:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    else:
        axes.yaxis.set_major_formatter(LogFormatterMathtext(labelOnlyBase=False))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _log_limits(values: Floats, below: float, above: float) -> tuple[float, float]:
    """Compute the limits of a logarithmic axis for some values.

    Args:
        values: The values.
        below: How far the axis extends below the values, as a fraction of their range.
        above: How far the axis extends above the values, as a fraction of their range.
    """
    finite = values[np.isfinite(values)]
    lower_limit, upper_limit = EMPTY_LIMITS
    if len(finite):
        lower_limit = float(finite.min())
        upper_limit = float(finite.max())
    if upper_limit <= FLAT_RATIO * lower_limit:
        lower_limit = lower_limit / FLAT_MARGIN_FACTOR
        upper_limit = upper_limit * FLAT_MARGIN_FACTOR
    ratio = upper_limit / lower_limit
    return lower_limit / ratio**below, upper_limit * ratio**above


def needs_log_axis(errors: Floats) -> bool:
    """Decide whether errors (n,) need a logarithmic axis.

    On an axis that begins at 0, the smallest errors could not be distinguished from 0.
    """
    return bool(0 < LOG_RATIO_MIN * errors.min() <= errors.max())


def name_categories(axes: Axes, names: Sequence[str], width_in: float) -> None:
    """Label the x axis with the names of categories, and make the figure taller by these labels.

    The names are horizontal, with a line for each field of an arm, or vertical if these lines are
    too long.

    Args:
        axes: The axes.
        names: The names.
        width_in: Width of the axes [in].
    """
    horizontal_labels = [re.sub(r"-(?=[\w.]+=)", "\n", name) for name in names]
    longest = max(len(line) for label in horizontal_labels for line in label.split("\n"))
    fits_horizontally = CHARACTER_IN * (longest + 2) < width_in / len(names)
    if fits_horizontally:
        labels = horizontal_labels
        below_in = LINE_IN * max(label.count("\n") for label in horizontal_labels)
    else:
        labels = [name.replace("\n", ", ") for name in names]
        below_in = CHARACTER_IN * max(map(len, names))
    font_size = NAME_PT if len(names) < SMALL_NAMES_MIN else SMALL_NAME_PT
    axes.set_xticks(range(len(names)), labels)
    axes.tick_params(
        axis="x", length=0, rotation=0 if fits_horizontally else 90, labelsize=font_size
    )
    axes.set_xlim(-0.5, len(names) - 0.5)
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.set_figheight(figure.get_figheight() + below_in)
