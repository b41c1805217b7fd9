"""The figure of `tetractl analyze`: end positions, singular values, and two curves of the error."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.analysis.analyze import Analysis
from tetractl.analysis.steering import Steering
from tetractl.core.colors import robot_colors
from tetractl.core.errors import UsageError, unit_of
from tetractl.view import style
from tetractl.view.figures.axes import draw_ellipse, robot_labels


def analysis_figure(found: Analysis) -> Figure:
    """Draw an analysis: (a) the ellipse that contains 95 % of each robot's end positions, around
    the planned end; (b) how far the signals move the ends, as singular values [length unit/rad];
    the predicted mean total error (c) over the smallest relative difference between two robots'
    turning rates a, and (d) over the number of robots. For one robot only (a) and (b) are drawn.
    Raises UsageError if no plan reaches the targets.
    """
    if found.steering is None:
        raise UsageError("no plan found, nothing to draw", "raise controller.horizon_max")
    figure = _drawn(found, found.steering)
    style.headline(figure, f"{found.setup.name}: predicted by a linear model; no trial was run")
    return figure


@style.styled()
def _drawn(found: Analysis, here: Steering) -> Figure:
    several = bool(found.by_gap)
    unit = unit_of(found.setup.unit)
    figure = style.figure(style.PAGE_IN, 5.2 if several else 2.8)
    panels = figure.subplots(2 if several else 1, 2, squeeze=False).ravel()
    _ends(panels[0], found, here)
    off = f"error from the planned end [{unit}]"
    style.panel(panels[0], "a", "95 % of the end positions, with feedback", f"x {off}", f"y {off}")
    number = np.arange(1, len(here.singular) + 1)
    panels[1].bar(number, here.singular, color=style.WHOLE, width=0.6)
    if (here.singular > 0).any():
        panels[1].set_yscale("log")
    panels[1].set_xticks(number)
    moved, values = "how far signals move robots' ends", f"singular values [{unit}/rad]"
    style.panel(panels[1], "b", moved, "singular value", values)
    if several:
        error, mean = here.error, f"mean total error [{unit}]"
        _curve(panels[2], [(100 * gap, one) for gap, one in found.by_gap], [error])
        panels[2].plot(
            100 * found.gap, error, "D", color=style.WHOLE, ms=5, label="robots in the spec"
        )
        panels[2].legend()
        gap = "smallest relative difference of two robots' a [%]"
        style.panel(panels[2], "c", "error over the difference between robots", gap, mean)
        _curve(panels[3], found.by_count)
        panels[3].set_xticks([count for count, _ in found.by_count])
        count = "number of robots, in the spec's order"
        style.panel(panels[3], "d", "error for fewer robots", count, mean)
    return figure


def _ends(axes: Axes, found: Analysis, here: Steering) -> None:
    setup = found.setup
    named = zip(robot_labels(setup.names), robot_colors(setup.names, setup.colors), strict=True)
    reach = max(
        draw_ellipse(axes, (0, 0), covariance, ec=color, lw=1.2, label=name)
        for covariance, (name, color) in zip(here.covariance, named, strict=True)
    )
    limit = 1.15 * reach or 1.0
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _curve(axes: Axes, points: Sequence[tuple[float, float]], more: Sequence[float] = ()) -> None:
    """Draw errors over a quantity, on a logarithmic axis if these and `more` are positive."""
    x, errors = zip(*points, strict=True)
    axes.plot(x, errors, color=style.WHOLE, marker="o", ms=3)
    if np.nanmin([*errors, *more]) > 0:
        axes.set_yscale("log")
