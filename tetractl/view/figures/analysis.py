"""The figure of `tetractl analyze`: end positions, singular values, and two curves of the error."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from tetractl.analysis.analyze import Analysis
from tetractl.analysis.steering import Steering
from tetractl.core.colors import robot_colors
from tetractl.core.errors import UsageError, unit_of
from tetractl.core.poses import ellipse
from tetractl.view import style
from tetractl.view.figures.axes import robot_labels

ROOM = 1.15  # half width of panel (a), relative to the largest ellipse


def analysis_figure(found: Analysis) -> Figure:
    """Draw an analysis: (a) the ellipse that contains 95 % of each robot's end positions, around
    the planned end; (b) how far the signals move the ends, as singular values [length unit/rad];
    the predicted mean total error (c) over the smallest relative difference between two robots'
    turning rates a, and (d) over the number of robots. For one robot only (a) and (b) are drawn.
    Raises UsageError if no plan reaches the targets.
    """
    if found.steering is None:
        raise UsageError("no plan found, nothing to draw", "raise controller.horizon_max")
    several = bool(found.by_gap)
    with style.styled():
        figure = style.figure(style.PAGE_IN, 5.2 if several else 2.8)
        panels = figure.subplots(2 if several else 1, 2, squeeze=False)
        _ends(panels[0, 0], found, found.steering)
        _singular(panels[0, 1], found, found.steering)
        if several:
            _map(panels[1, 0], found, found.steering.error)
            _crowd(panels[1, 1], found)
    style.headline(figure, f"{found.setup.name}: predicted by a linear model; no trial was run")
    return figure


def _ends(axes: Axes, found: Analysis, here: Steering) -> None:
    setup, unit = found.setup, unit_of(found.setup.unit)
    colors, reach = robot_colors(setup.names, setup.colors), 0.0
    for i, (name, color) in enumerate(zip(robot_labels(setup.names), colors, strict=True)):
        long, short, angle = ellipse(here.covariance[i])
        reach = max(reach, long)
        axes.add_patch(
            Ellipse((0, 0), 2 * long, 2 * short, angle=math.degrees(angle), fill=False, ec=color,
                    lw=1.2, label=name)
        )  # fmt: skip
    limit = ROOM * reach or 1.0
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-limit, limit)
    axes.set_aspect("equal")
    axes.set_xlabel(f"x error from the planned end [{unit}]")
    axes.set_ylabel(f"y error from the planned end [{unit}]")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    style.panel(axes, "a", "95 % of the end positions, with feedback")


def _singular(axes: Axes, found: Analysis, here: Steering) -> None:
    values = here.singular
    axes.bar(np.arange(1, len(values) + 1), values, color=style.GREY, width=0.6)
    if (values > 0).any():
        axes.set_yscale("log")
    axes.set_xticks(np.arange(1, len(values) + 1))
    axes.set_xlabel("singular value")
    axes.set_ylabel(f"singular values [{unit_of(found.setup.unit)}/rad]")
    style.panel(axes, "b", "how far signals move robots' ends")


def _map(axes: Axes, found: Analysis, error: float) -> None:
    gaps, errors = zip(*found.by_gap, strict=True)
    axes.plot(100 * np.array(gaps), errors, color=style.INK, marker="o", ms=3)
    axes.plot([100 * found.gap], [error], "D", color=style.ALARM, ms=5, ls="none",
              label="robots in the spec")  # fmt: skip
    _error_axis(axes, found, [*errors, error])
    axes.set_xlabel("smallest relative difference of two robots' a [%]")
    axes.legend()
    style.panel(axes, "c", "error over the difference between robots")


def _crowd(axes: Axes, found: Analysis) -> None:
    counts, errors = zip(*found.by_count, strict=True)
    axes.plot(counts, errors, color=style.INK, marker="o", ms=3)
    axes.set_xticks(counts)
    _error_axis(axes, found, errors)
    axes.set_xlabel("number of robots, in the spec's order")
    style.panel(axes, "d", "error for fewer robots")


def _error_axis(axes: Axes, found: Analysis, errors: "list[float] | tuple[float, ...]") -> None:
    if np.nanmin(errors) > 0:
        axes.set_yscale("log")
    axes.set_ylabel(f"mean total error [{unit_of(found.setup.unit)}]")
