"""The figure of a study: total errors against the values of a field that the study varies.

It shows the mean with its 95 % interval, and a dot for each trial.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from tetractl.core.errors import format_unit
from tetractl.statistics.estimate import ArmErrors, Interval, are_numeric
from tetractl.view import style
from tetractl.view.figures.axes import name_categories, needs_log_axis, set_log_axis

HEIGHT_IN = 2.8
"""Height of the figure [in]."""
CURVES_ASIDE_IN = 0.12
"""Horizontal distance between two curves at the same value [in]: no curve hides another."""
TRIALS_ASIDE_IN = 0.05
"""Horizontal distance between a mean and its trials [in]."""
MARGIN = 0.05
"""Free space beyond the errors of a logarithmic axis, as a fraction of their range."""
LABEL_LENGTH = 24
"""Maximum length of a value's text [characters]."""
LOG_DECADES = 1.5
"""Minimum span of positive values for a logarithmic axis [decades]."""
TICKS_MAX = 8
"""Maximum number of values for which each value has a tick."""


@style.styled()
def study_errors_figure(
    curves: Mapping[str, Sequence[ArmErrors]], field: str, unit: str, is_only_field: bool = True
) -> Figure:
    """Draw the errors of a study against the values of one of its fields, as coloured curves.

    A line connects numbers if arms at neighbouring values differ only in the field. This is so if
    no other field is swept, or if each value stands for the same number of arms, and more than one.

    Args:
        curves: The errors of each curve, by its name.
        field: The field. Empty to draw errors against arms, labelled with their names.
        unit: Unit of the errors.
        is_only_field: Whether no other field is swept.
    """
    all_arms = [arm for arms in curves.values() for arm in arms]
    figure = style.figure(style.PAGE_IN, HEIGHT_IN)
    axes = figure.subplots()
    positions = _place_values(axes, all_arms)
    are_numbers = are_numeric(all_arms)
    errors = np.array([error for arm in all_arms for error in arm.errors])
    is_logarithmic = needs_log_axis(errors)
    if is_logarithmic:
        set_log_axis(axes, errors, MARGIN, MARGIN)
    for number, (name, arms) in enumerate(curves.items()):
        arm_counts = {arm.arms for arm in arms}
        is_comparable = len(arm_counts) == 1 and (is_only_field or arms[0].arms > 1)
        x = [positions[repr(arm.value)] for arm in arms]
        marker = "-o" if are_numbers and is_comparable else "o"
        rank = number - (len(curves) - 1) / 2
        aside_in = CURVES_ASIDE_IN * rank if field else 0
        color = style.batch_look(number)["color"]
        curve_style = _curve_style(axes, color, aside_in)
        means = [arm.error.mean for arm in arms]
        axes.plot(x, means, marker, markersize=3.5, label=name or None, zorder=3, **curve_style)
        _draw_intervals(axes, x, arms, curve_style)
        _draw_trials(axes, x, arms, _curve_style(axes, color, aside_in - TRIALS_ASIDE_IN))
        _include_in_limits(axes, x, arms)
    if not field:
        name_categories(axes, [arm.label for arm in all_arms], 0.9 * style.PAGE_IN)
    axes.set_xlabel(field)
    axes.set_ylabel(f"total error [{format_unit(unit)}]")
    if not is_logarithmic:
        axes.set_ylim(bottom=0)
    style.grid_of_heights(axes)
    if any(curves):
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def _curve_style(axes: Axes, color: str, aside_in: float) -> dict[str, Any]:
    """Create the style of a curve whose marks are drawn beside their place on the x axis.

    Args:
        axes: The axes.
        color: Colour of the marks.
        aside_in: Distance by which the marks are shifted to the right [in]. It may be negative.
    """
    figure = axes.get_figure(root=True)
    assert figure is not None
    shift = ScaledTranslation(aside_in, 0, figure.dpi_scale_trans)
    return {"color": color, "clip_on": False, "transform": axes.transData + shift}


def _place_values(axes: Axes, arms: Sequence[ArmErrors]) -> dict[str, float]:
    """Place the values of arms on the x axis, and label the axis with the values.

    If all values are numbers, each is placed at itself, on a logarithmic axis if they span more
    than LOG_DECADES. Otherwise, the values are placed at 0, 1, 2 and so on, in their order.

    Returns:
        The x coordinate of each value, by the value's `repr`.
    """
    if not are_numeric(arms):
        labels = {repr(arm.value): arm.label for arm in arms}
        tick_labels = [label[:LABEL_LENGTH] for label in labels.values()]
        axes.set_xticks(range(len(tick_labels)), tick_labels)
        axes.set_xlim(-0.5, len(labels) - 0.5)
        return {value: float(place) for place, value in enumerate(labels)}
    arms_by_value = sorted(arms, key=lambda arm: arm.value)
    label_by_value = {float(arm.value): arm.label for arm in arms_by_value}
    smallest = min(label_by_value)
    if smallest > 0 and max(label_by_value) / smallest >= 10**LOG_DECADES:
        axes.set_xscale("log")
    if len(label_by_value) <= TICKS_MAX:
        axes.set_xticks([*label_by_value], [*label_by_value.values()])
    return {repr(arm.value): float(arm.value) for arm in arms}


def _draw_intervals(
    axes: Axes, x: Sequence[float], arms: Sequence[ArmErrors], style_of_curve: dict[str, Any]
) -> None:
    """Draw the 95 % interval of each arm's mean as a vertical line, if the interval is known."""
    positions_with_interval: list[float] = []
    intervals: list[Interval] = []
    for position, arm in zip(x, arms, strict=True):
        if arm.error.ci95.known:
            positions_with_interval.append(position)
            intervals.append(arm.error.ci95)
    lower_ends = [interval.low for interval in intervals]
    if axes.get_yscale() == "log":
        lower_ends = [
            max(lower_end, axes.get_ylim()[0]) for lower_end in lower_ends
        ]  # a bound may be 0 or less
    upper_ends = [interval.high for interval in intervals]
    axes.vlines(
        positions_with_interval, lower_ends, upper_ends, linewidth=2.5, alpha=0.45, **style_of_curve
    )


def _draw_trials(
    axes: Axes, x: Sequence[float], arms: Sequence[ArmErrors], style_of_curve: dict[str, Any]
) -> None:
    """Draw a dot for the error of each trial of a curve."""
    errors = np.concatenate([arm.errors for arm in arms])
    positions = np.repeat(x, [len(arm.errors) for arm in arms])
    axes.plot(
        positions, errors, "o", markersize=2.5, mew=0, alpha=0.5, gid="trials", **style_of_curve
    )


def _include_in_limits(axes: Axes, x: Sequence[float], arms: Sequence[ArmErrors]) -> None:
    """Set the limits of the axes so that a curve fits.

    This is needed because curves that are shifted sideways do not change the limits themselves.
    """
    points: list[tuple[float, float]] = []
    for position, arm in zip(x, arms, strict=True):
        points += [(position, error) for error in arm.errors]
        if arm.error.ci95.known:
            points += [(position, arm.error.ci95.low), (position, arm.error.ci95.high)]
    if points:
        axes.update_datalim(points)
    axes.autoscale_view()
