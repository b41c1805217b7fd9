"""Named curves over time, one for each robot or one for all, as several figures draw them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.trials import NUMBERED_MIN, robot_labels
from tetractl.view.player import find_end_ns

NAME_IN = 0.1
"""Height of a robot's name next to its curve [in]."""
NAME_PT = 6.5
SMALL_NAME_PT = 5.5
"""Font size of names for NUMBERED_MIN curves or more [points]. NAME_PT is that for fewer."""
TIME_LABEL = "time since the first command [s]"


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve of a figure: values over time, with a name and a colour.

    Attributes:
        values: The values, shape (M,).
        color: Colour of the curve.
        name: Name that is written next to the axes.
        gid: Id of the curve's element in an SVG file.
        band: Lower and upper edge of a shaded band around the curve, shape (2, M). None for no
            band.
        key: The curve's entry in a legend. Empty for no entry.
        width: Width of the line [points].
    """

    values: Floats
    color: str
    name: str
    gid: str
    band: Floats | None = None
    key: str = ""
    width: float = 1.1


def draw_curves(axes: Axes, time_s: Floats, curves: Iterable[Curve]) -> None:
    """Draw curves and their bands over time on the axes of a figure.

    Args:
        axes: The axes.
        time_s: The times [s], shape (M,).
        curves: The curves.
    """
    for curve in curves:
        if curve.band is not None:
            axes.fill_between(time_s, *curve.band, color=curve.color, alpha=0.2, lw=0)
        label = curve.key or f"_{curve.gid}"
        line_style = {"color": curve.color, "lw": curve.width, "label": label, "gid": curve.gid}
        axes.plot(time_s, curve.values[: len(time_s)], **line_style)


def name_curves(axes: Axes, curves: Sequence[Curve]) -> None:
    """Name the curves in a legend to the right of the axes.

    The curve with the highest last value comes first.
    """
    by_last_value = np.argsort([curve.values[-1] for curve in curves])[::-1]
    named = [curves[index] for index in by_last_value]
    axes.legend(
        handles=[style.sign(curve.name, color=curve.color, ls="-") for curve in named],
        fontsize=NAME_PT if len(curves) < NUMBERED_MIN else SMALL_NAME_PT,
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        borderpad=0.0,
        handlelength=0.8,
        labelspacing=0.15,
    )


def create_robot_curves(
    setup: Setup,
    values: Floats,
    band: Floats | None = None,
    show: Callable[[float], str] | None = None,
) -> list[Curve]:
    """Create a curve for each of N robots, in the colour and with the name of the robot.

    A curve is named after its robot, followed by the last value if `show` formats it.

    Args:
        setup: The constants of the experiment.
        values: The values, shape (M, N).
        band: Lower and upper edge of a band, shape (2, M, N). None for no band. NUMBERED_MIN or
            more robots have no bands.
        show: Formats the last value. None to leave it out.
    """
    colors = robot_colors(setup.names, setup.colors)
    labels = robot_labels(setup.names)
    curves = []
    for robot, (color, label) in enumerate(zip(colors, labels, strict=True)):
        robot_values = values[:, robot]
        name = label if show is None else f"{label} {show(robot_values[-1])}"
        curve = Curve(robot_values, color, name, f"robot-{robot}")
        if band is not None and len(labels) < NUMBERED_MIN:
            curve = replace(curve, band=band[..., robot])
        curves.append(curve)
    return curves


def end_s(log: TrialLog) -> float:
    """Compute the time from the first direction of a trial to its end [s], at least 1e-9."""
    return max((find_end_ns(log) - log.began_ns) / SECOND, 1e-9)
