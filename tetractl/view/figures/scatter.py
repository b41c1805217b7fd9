"""The figure of the robots' final positions in a batch, with covariance ellipses."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import DEVIATIONS, INSIDE, Floats, ellipse
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import (
    final_poses,
    panels_of,
    robot_labels,
    unfinished,
)

COLUMNS = 4
FEWEST = 3  # least number of trials for an ellipse


def scatter_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw each robot's final position relative to its target, a dot for each trial, in a panel for
    each robot of each folder.

    The dashed ellipse contains 95 % of a normal distribution with the mean and covariance (n - 1)
    of the complete trials. All panels of a folder have the same scale.
    """
    for log in logs:
        if log.result is None and not len(log.mocap_ns):
            raise LogError(f"{log.path}: contains no camera frames to plot")
    arms = panels_of(logs)
    counts = [len(found[0].start.setup.names) for found in arms.values()]
    columns = min(max(counts), COLUMNS)
    rows = [-(-count // columns) for count in counts]
    with style.styled():
        side_in = style.PAGE_IN / max(columns, 3)
        figure = style.figure(columns * side_in, sum(rows) * (side_in + 0.2) + 0.6)
        panels = figure.subplots(sum(rows), columns, squeeze=False)
        ends = np.cumsum(rows)
        drawn = [
            _arm(list(panels[end - of : end].flat), name, found, columns)
            for (name, found), end, of in zip(arms.items(), ends, rows, strict=True)
        ]
        figure.legend(
            handles=_key(drawn, any(map(unfinished, logs))), loc="outside lower center", ncols=5
        )
    return figure


def _arm(panels: Sequence[Axes], name: str, logs: Sequence[TrialLog], columns: int) -> int:
    """Draw the panels of one folder's robots; return the number of trials in the means."""
    setup = logs[0].start.setup
    unit, colors = unit_of(setup.unit), robot_colors(setup.names, setup.colors)
    gaps = np.array([final_poses(log)[:, :2] for log in logs]) - setup.targets
    whole = np.array([not unfinished(log) for log in logs])
    counted = gaps[whole] if whole.any() else gaps
    reach = 0.0
    for robot, axes in enumerate(panels):
        if robot >= len(colors):
            axes.set_visible(False)
            continue
        axes.sharex(panels[0])
        axes.sharey(panels[0])
        reach = max(reach, _panel(axes, counted[:, robot], gaps[~whole, robot], colors[robot]))
        mean = float(np.linalg.norm(counted[:, robot], axis=1).mean())
        who = f"{name}: " * bool(name) + robot_labels(setup.names)[robot]
        title = f"{who}\nmean error {mean:.3g} {unit}"
        axes.set_title(title, loc="left", color=colors[robot], fontsize=7)
        lowest, first = robot + columns >= len(colors), robot % columns == 0
        axes.tick_params(labelbottom=lowest, labelleft=first)
        axes.set_xlabel(f"x error [{unit}]" * lowest)
        axes.set_ylabel(f"y error [{unit}]" * first)
    limit = 1.08 * reach or 1.0
    panels[0].set_xlim(-limit, limit)
    panels[0].set_ylim(-limit, limit)
    return len(counted)


def _panel(axes: Axes, gaps: Floats, cut: Floats, color: str) -> float:
    """Draw one robot's errors x, y: `gaps` (n, 2) of complete trials, and `cut` of incomplete ones.
    Return the largest |x| or |y| to show.
    """
    axes.set_aspect("equal")
    for line in (axes.axhline, axes.axvline):
        line(0, color=style.FAINT, lw=0.5, zorder=0)
    axes.plot(0, 0, "s", ms=7, mfc="none", mec=color, zorder=3)
    axes.plot(*gaps.T, "o", ms=3.5, color=color, alpha=0.6, mew=0, zorder=2, gid="ends")
    axes.plot(*cut.T, "x", ms=4, color=style.ALARM, zorder=2)
    mean = gaps.mean(axis=0)
    axes.plot(*mean, "+", ms=8, mew=1.2, color=style.INK, zorder=4, gid="mean")
    reach = float(np.abs(np.concatenate([gaps, cut])).max(initial=0))
    if len(gaps) < FEWEST:
        return reach
    covariance = np.cov(gaps.T)
    long, short, angle = ellipse(covariance)
    axes.add_patch(
        Ellipse(
            (float(mean[0]), float(mean[1])), 2 * long, 2 * short, angle=math.degrees(angle),
            fill=False, edgecolor=style.INK, lw=0.8, ls="--", zorder=3,
        )
    )  # fmt: skip
    span = DEVIATIONS * np.sqrt(np.diag(covariance))
    return max(reach, float((np.abs(mean) + span).max()))


def _key(counted: Sequence[int], cut: bool) -> list[Line2D]:
    """Return the signs of the legend; `counted` are the numbers of trials in the means."""
    numbers = " to ".join(map(str, sorted({min(counted), max(counted)})))

    def key(label: str, **look: object) -> Line2D:
        return Line2D([], [], **{"ls": "none", "color": style.GREY, "label": label, **look})  # pyright: ignore[reportArgumentType]

    signs = [
        key("target", marker="s", ms=6, mfc="none"),
        key("one trial", marker="o", ms=4),
        key(f"mean of {numbers}", marker="+", ms=8, color=style.INK),
    ]
    if max(counted) >= FEWEST:
        label = f"covariance, {100 * INSIDE:g} % of a normal distribution"
        signs.append(key(label, ls="--", lw=0.8, color=style.INK))
    if cut:
        signs.append(key("did not run to its end", marker="x", ms=4, color=style.ALARM))
    return signs
