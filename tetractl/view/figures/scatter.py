"""The figure of the robots' final positions in a batch, with covariance ellipses."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import DEVIATIONS, INSIDE, Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import (
    draw_ellipse,
    final_poses,
    panels_of,
    robot_labels,
    unfinished,
)

FOR_ELLIPSE = 3  # least number of trials for an ellipse


@style.styled()
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
    robots = [len(found[0].start.setup.names) for found in arms.values()]
    columns = min(max(robots), 4)
    rows = [-(-count // columns) for count in robots]
    side_in = style.PAGE_IN / max(columns, 3)
    figure = style.figure(columns * side_in, sum(rows) * (side_in + 0.2) + 0.6)
    panels = np.split(figure.subplots(sum(rows), columns, squeeze=False), np.cumsum(rows)[:-1])
    counted = [
        _arm([*of.flat], name, found, columns)
        for (name, found), of in zip(arms.items(), panels, strict=True)
    ]
    numbers = " to ".join(map(str, sorted({min(counted), max(counted)})))
    signs = [
        style.sign("target", marker="s", ms=6, mfc="none"),
        style.sign("one trial", marker="o", ms=4),
        style.sign(f"mean of {numbers}", marker="+", ms=8, color=style.INK),
    ]
    if max(counted) >= FOR_ELLIPSE:
        label = f"covariance, {100 * INSIDE:g} % of a normal distribution"
        signs.append(style.sign(label, ls="--", lw=0.8, color=style.INK))
    if any(map(unfinished, logs)):
        signs.append(style.sign("did not run to its end", marker="x", ms=4, color=style.ALARM))
    style.legend(figure, signs, 5)
    return figure


def _arm(panels: Sequence[Axes], name: str, logs: Sequence[TrialLog], columns: int) -> int:
    """Draw the panels of one folder's robots; return the number of trials in the means."""
    setup = logs[0].start.setup
    unit, colors = unit_of(setup.unit), robot_colors(setup.names, setup.colors)
    gaps = np.array([final_poses(log)[:, :2] - log.start.setup.targets for log in logs])
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
        axes.set(xlabel=f"x error [{unit}]" * lowest, ylabel=f"y error [{unit}]" * first)
    limit = 1.08 * reach or 1.0
    panels[0].set(xlim=(-limit, limit), ylim=(-limit, limit))
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
    if len(gaps) < FOR_ELLIPSE:
        return reach
    covariance = np.cov(gaps.T)
    centre = (float(mean[0]), float(mean[1]))
    draw_ellipse(axes, centre, covariance, edgecolor=style.INK, lw=0.8, ls="--", zorder=3)
    span = DEVIATIONS * np.sqrt(np.diag(covariance))
    return max(reach, float((np.abs(mean) + span).max()))
