"""The figure of `tetractl analyze`: end positions, singular values, and two curves of the error."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from tetractl.analysis.analyze import Analysis
from tetractl.analysis.steering import Steering
from tetractl.core.colors import robot_colors
from tetractl.core.errors import UsageError, unit_of
from tetractl.core.poses import ellipse
from tetractl.core.setup import Setup
from tetractl.view import style
from tetractl.view.figures.trials import robot_labels

CURVE: dict[str, Any] = {"color": style.WHOLE, "marker": "o", "ms": 3}
"""The look of a curve of predicted errors."""
HEIGHT_IN = 5.2
"""Height of the figure of several robots [in]."""
HEIGHT_ONE_IN = 2.8
"""Height of the figure of one robot [in]."""
ROOM = 1.15
"""Limit of the axes of end positions, over the longest half axis."""


def analysis_figure(analysis: Analysis) -> Figure:
    """Draw an analysis: (a) the ellipse that contains 95 % of each robot's end positions, around
    the planned end; (b) how far the signals move the ends, as singular values [length unit/rad];
    the predicted mean total error (c) over the smallest relative difference between two robots'
    turning rates a, and (d) over the number of robots. For one robot only (a) and (b) are drawn.
    Raises UsageError if no plan reaches the targets.
    """
    if analysis.steering is None:
        raise UsageError("no plan found, nothing to draw", "raise controller.horizon_max")
    figure = _drawn(analysis, analysis.steering)
    name = analysis.setup.name
    style.headline(figure, f"{name}: predicted by a linear model; no trial was run")
    return figure


@style.styled()
def _drawn(analysis: Analysis, steering: Steering) -> Figure:
    """Draw the panels of an analysis of plans that reach the targets."""
    several = bool(analysis.by_gap)
    figure = style.figure(style.PAGE_IN, HEIGHT_IN if several else HEIGHT_ONE_IN)
    panels = figure.subplots(2 if several else 1, 2, squeeze=False).ravel()
    _ends(panels[0], analysis.setup, steering)
    _singular_values(panels[1], analysis.setup, steering)
    if several:
        _errors_by_gap(panels[2], analysis, steering)
        _errors_by_count(panels[3], analysis)
    return figure


def _ends(axes: Axes, setup: Setup, steering: Steering) -> None:
    """Draw the ellipses of the robots' ends."""
    off = f"error from the planned end [{unit_of(setup.unit)}]"
    style.panel(axes, "a", "95 % of the end positions, with feedback", f"x {off}", f"y {off}")
    labels = robot_labels(setup.names)
    colors = robot_colors(setup.names, setup.colors)
    half_axes: list[float] = []
    for covariance, color, label in zip(steering.covariance, colors, labels, strict=True):
        long, short, angle = ellipse(covariance)
        look: dict[str, Any] = {"fill": False, "ec": color, "lw": 1.2, "label": label}
        axes.add_patch(Ellipse((0, 0), 2 * long, 2 * short, angle=math.degrees(angle), **look))
        half_axes.append(long)
    limit = ROOM * max(half_axes) or 1.0
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _singular_values(axes: Axes, setup: Setup, steering: Steering) -> None:
    """Draw how far the signals move combinations of the ends."""
    number = np.arange(1, len(steering.singular) + 1)
    axes.bar(number, steering.singular, color=style.WHOLE, width=0.6)
    if (steering.singular > 0).any():
        axes.set_yscale("log")
    axes.set_xticks(number)
    values = f"singular values [{unit_of(setup.unit)}/rad]"
    style.panel(axes, "b", "how far signals move robots' ends", "singular value", values)


def _errors_by_gap(axes: Axes, analysis: Analysis, steering: Steering) -> None:
    """Draw the errors of robots that differ more or less, and that of the robots in the spec."""
    percents = [100 * gap for gap, _ in analysis.by_gap]
    errors = [error for _, error in analysis.by_gap]
    axes.plot(percents, errors, **CURVE)
    _log_if_positive(axes, [*errors, steering.error])
    in_spec = {"color": style.WHOLE, "ms": 5, "label": "robots in the spec"}
    axes.plot(100 * analysis.gap, steering.error, "D", **in_spec)
    axes.legend()
    gap = "smallest relative difference of two robots' a [%]"
    title = "error over the difference between robots"
    style.panel(axes, "c", title, gap, _mean_error(analysis.setup))


def _errors_by_count(axes: Axes, analysis: Analysis) -> None:
    """Draw the errors of the first robots of the spec."""
    counts = [count for count, _ in analysis.by_count]
    errors = [error for _, error in analysis.by_count]
    axes.plot(counts, errors, **CURVE)
    _log_if_positive(axes, errors)
    axes.set_xticks(counts)
    count = "number of robots, in the spec's order"
    style.panel(axes, "d", "error for fewer robots", count, _mean_error(analysis.setup))


def _mean_error(setup: Setup) -> str:
    return f"mean total error [{unit_of(setup.unit)}]"


def _log_if_positive(axes: Axes, errors: Sequence[float]) -> None:
    """Make the y axis logarithmic if all errors are positive; NaN, for no plan, is left out."""
    if np.nanmin(errors) > 0:
        axes.set_yscale("log")
