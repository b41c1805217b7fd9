"""The figure of a study: total errors against the values of a field that the study varies.

It shows the mean with its 95 % interval, and a dot for each trial.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from tetractl.core.errors import unit_of
from tetractl.statistics.estimate import ArmErrors, Interval, numeric
from tetractl.view import style
from tetractl.view.figures.axes import log_axis, name_categories, spans_orders

HEIGHT_IN = 2.8
"""Height of the figure [in]."""
CURVES_ASIDE_IN = 0.12
"""Horizontal distance between two curves at the same value [in]: no curve hides another."""
TRIALS_ASIDE_IN = 0.05
"""Horizontal distance between a mean and its trials [in]."""
ROOM = 0.05
"""Room beyond the errors of a logarithmic axis, as a fraction of their range."""
LABEL_LENGTH = 24
"""Maximum length of a value's text [characters]."""
LOG_DECADES = 1.5
"""Minimum span of positive values for a logarithmic axis [decades]."""
TICKS_MAX = 8
"""Maximum number of values for which each value has a tick."""


@style.styled()
def errors_by(
    curves: Mapping[str, Sequence[ArmErrors]], field: str, unit: str, only: bool = True
) -> Figure:
    """Draw the errors of a study against the values of one of its fields, as coloured curves.

    A line connects numbers if arms at neighbouring values differ only in the field: if it is the
    only one that is swept, or if each value stands for several arms, always the same number.

    Args:
        curves: The errors of each curve, by its name.
        field: The field. Empty to draw errors against arms, labelled with their names.
        unit: Unit of the errors.
        only: Whether it is the only field that is swept.
    """
    all_arms = [arm for arms in curves.values() for arm in arms]
    figure = style.figure(style.PAGE_IN, HEIGHT_IN)
    axes = figure.subplots()
    places = _places(axes, all_arms)
    numbers = numeric(all_arms)
    errors = np.array([error for arm in all_arms for error in arm.errors])
    is_logarithmic = spans_orders(errors)
    if is_logarithmic:
        log_axis(axes, errors, ROOM, ROOM)
    for number, (name, arms) in enumerate(curves.items()):
        pooled = {arm.arms for arm in arms}
        comparable = len(pooled) == 1 and (only or arms[0].arms > 1)
        x = [places[repr(arm.value)] for arm in arms]
        line = "-o" if numbers and comparable else "o"
        rank = number - (len(curves) - 1) / 2
        aside_in = CURVES_ASIDE_IN * rank if field else 0
        color = style.batch_look(number)["color"]
        look = _look(axes, color, aside_in)
        means = [arm.error.mean for arm in arms]
        axes.plot(x, means, line, markersize=3.5, label=name or None, zorder=3, **look)
        _draw_intervals(axes, x, arms, look)
        _draw_trials(axes, x, arms, _look(axes, color, aside_in - TRIALS_ASIDE_IN))
        _show_all(axes, x, arms)
    if not field:
        name_categories(axes, [arm.label for arm in all_arms], 0.9 * style.PAGE_IN)
    axes.set_xlabel(field)
    axes.set_ylabel(f"total error [{unit_of(unit)}]")
    if not is_logarithmic:
        axes.set_ylim(bottom=0)
    style.grid_of_heights(axes)
    if any(curves):
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def _look(axes: Axes, color: str, aside_in: float) -> dict[str, Any]:
    """Return the style of marks that are drawn beside their place on the x axis.

    `aside_in` is the distance to the right [in]; it may be negative.
    """
    figure = axes.get_figure(root=True)
    assert figure is not None
    shift = ScaledTranslation(aside_in, 0, figure.dpi_scale_trans)
    return {"color": color, "clip_on": False, "transform": axes.transData + shift}


def _places(axes: Axes, arms: Sequence[ArmErrors]) -> dict[str, float]:
    """Return {value: x} of each value on the x axis, and label the axis with the values.

    If all values are numbers, x is the number itself, on a logarithmic axis if they span much.
    Otherwise, x counts the values from 0 in their order.
    """
    if not numeric(arms):
        labels = {repr(arm.value): arm.label for arm in arms}
        texts = [label[:LABEL_LENGTH] for label in labels.values()]
        axes.set_xticks(range(len(texts)), texts)
        axes.set_xlim(-0.5, len(labels) - 0.5)
        return {value: float(place) for place, value in enumerate(labels)}
    rising = sorted(arms, key=lambda arm: arm.value)
    labels_of = {float(arm.value): arm.label for arm in rising}
    least = min(labels_of)
    if least > 0 and max(labels_of) / least >= 10**LOG_DECADES:
        axes.set_xscale("log")
    if len(labels_of) <= TICKS_MAX:
        axes.set_xticks([*labels_of], [*labels_of.values()])
    return {repr(arm.value): float(arm.value) for arm in arms}


def _draw_intervals(
    axes: Axes, x: Sequence[float], arms: Sequence[ArmErrors], look: dict[str, Any]
) -> None:
    """Draw the 95 % interval of each arm's mean as a vertical line.

    Arms without one have no line.
    """
    places: list[float] = []
    intervals: list[Interval] = []
    for place, arm in zip(x, arms, strict=True):
        if arm.error.ci95.known:
            places.append(place)
            intervals.append(arm.error.ci95)
    low = [interval.low for interval in intervals]
    if axes.get_yscale() == "log":
        low = [max(end, axes.get_ylim()[0]) for end in low]  # a bound may be 0 or less
    high = [interval.high for interval in intervals]
    axes.vlines(places, low, high, linewidth=2.5, alpha=0.45, **look)


def _draw_trials(
    axes: Axes, x: Sequence[float], arms: Sequence[ArmErrors], look: dict[str, Any]
) -> None:
    """Draw a dot for the error of each trial of a curve."""
    errors = np.concatenate([arm.errors for arm in arms])
    places = np.repeat(x, [len(arm.errors) for arm in arms])
    axes.plot(places, errors, "o", markersize=2.5, mew=0, alpha=0.5, gid="trials", **look)


def _show_all(axes: Axes, x: Sequence[float], arms: Sequence[ArmErrors]) -> None:
    """Set the limits of the axes so that a curve fits.

    This is needed because curves that are shifted sideways do not change the limits themselves.
    """
    points: list[tuple[float, float]] = []
    for place, arm in zip(x, arms, strict=True):
        points += [(place, error) for error in arm.errors]
        if arm.error.ci95.known:
            points += [(place, arm.error.ci95.low), (place, arm.error.ci95.high)]
    if points:
        axes.update_datalim(points)
    axes.autoscale_view()
