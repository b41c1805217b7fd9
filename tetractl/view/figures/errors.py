"""The errors of the trials of a batch over time, with the range that half of them lie in."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tetractl.core.clock import SECOND
from tetractl.core.colors import BLUE, RED, robot_colors
from tetractl.core.errors import LogError
from tetractl.core.poses import Bools, Floats
from tetractl.core.text import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.recording import tracked
from tetractl.view import style
from tetractl.view.figures.axes import (
    NUMBERED,
    check_alike,
    robot_labels,
    unfinished,
)
from tetractl.view.figures.labels import end_labels

POINTS = 400  # of the time axis
QUARTILES = (25, 50, 75)
LINE_IN = 0.1  # height of a robot's label


def errors_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the total error of every trial over time, and the median of each robot's.

    The band holds the middle half of the trials. A trial that has ended counts with its error at
    the end. Trials that did not run to their own end are drawn and not counted.
    """
    check_alike(logs)
    for log in logs:
        if not len(log.mocap_ns):
            raise LogError(f"{log.path}: holds no camera frames to plot")
    setup = logs[0].start.setup
    unit = unit_of(setup.unit)
    end_s = max(1e-9, *(float(log.mocap_ns[-1] - log.began_ns) / SECOND for log in logs))
    time_s = np.linspace(0, end_s, POINTS)
    errors = np.array([errors_at(log, time_s) for log in logs])  # (trials, POINTS, N)
    whole = np.array([not unfinished(log) for log in logs])
    counted = errors[whole] if whole.any() else errors
    with style.styled():
        each_in = max(1.8, LINE_IN * len(setup.names))
        figure = style.figure(style.PAGE_IN, 2.4 + each_in)
        total, each = figure.subplots(2, 1, sharex=True, height_ratios=[1.8, each_in])
        _total(total, time_s, errors.sum(axis=2), whole, counted.sum(axis=2))
        signs = _key(logs, whole)
        if reference := logs[0].experiment.reference:
            total.axhline(reference.mean, color=RED, lw=0.8, ls="--")
            label = "published mean at the end"
            signs.append(Line2D([], [], color=RED, lw=0.8, ls="--", label=label))
        colors = robot_colors(setup.names, setup.colors)
        ends = _robots(each, time_s, counted, colors)
        for axes in (total, each):
            axes.set_ylim(bottom=0)
            axes.set_xlim(0, end_s)
            axes.set_ylabel(f"error [{unit}]")
        each.set_xlabel("time since the first command [s]")
        style.panel(total, "a", f"total error of {len(logs)} trial{'s' * (len(logs) > 1)}")
        style.panel(each, "b", "distance of each robot to its target, median of the trials")
        figure.legend(handles=signs, loc="outside lower center", ncols=5)
        last = float(np.median(counted.sum(axis=2)[:, -1]))
        end_labels(total, [last], [f"median {last:.3g} {unit}"], [BLUE])
        texts = [
            f"{name} {end:.3g}" for name, end in zip(robot_labels(setup.names), ends, strict=True)
        ]
        end_labels(each, ends, texts, colors)
    return figure


def errors_at(log: TrialLog, time_s: Floats) -> Floats:
    """Return the robots' distances (M, N) at times (M,) since the first command [s].

    Each is the last measured before its time; after the trial's end it is that of the result.
    """
    gaps = log.start.setup.distances(tracked(log.mocap, log.valid))
    rows = np.arange(len(gaps))[:, None] * np.isfinite(gaps)
    held = np.take_along_axis(gaps, np.maximum.accumulate(rows, axis=0), axis=0)
    sampled_s = (log.mocap_ns - log.began_ns) / SECOND
    found = held[np.maximum(np.searchsorted(sampled_s, time_s, side="right") - 1, 0)]
    if log.result is not None:  # the robots stand still from there on
        found[time_s >= sampled_s[-1]] = log.result.robot_errors
    return found


def _total(axes: Axes, time_s: Floats, totals: Floats, whole: Floats, counted: Floats) -> None:
    for errors, complete in zip(totals, whole, strict=True):
        color = style.GREY if complete else style.ALARM
        axes.plot(time_s, errors, color=color, lw=0.5, alpha=0.6, zorder=1, gid="trial")
    low, middle, high = np.nanpercentile(counted, QUARTILES, axis=0)
    axes.fill_between(time_s, low, high, color=BLUE, alpha=0.25, lw=0, zorder=2)
    axes.plot(time_s, middle, color=BLUE, lw=1.5, zorder=3, gid="median")


def _robots(axes: Axes, time_s: Floats, counted: Floats, colors: list[str]) -> list[float]:
    """Draw each robot's median and, where they are few, its band; return the medians' ends."""
    low, middle, high = np.nanpercentile(counted, QUARTILES, axis=0)
    for robot, color in enumerate(colors):
        if len(colors) < NUMBERED:
            axes.fill_between(time_s, low[:, robot], high[:, robot], color=color, alpha=0.2, lw=0)
        axes.plot(time_s, middle[:, robot], color=color, lw=1.1, gid=f"robot-{robot}")
    return [float(end) for end in middle[-1]]


def _key(logs: Sequence[TrialLog], whole: Bools) -> list[Line2D | Patch]:
    signs: list[Line2D | Patch] = [
        Line2D([], [], color=style.GREY, lw=0.5, label="one trial"),
        Line2D([], [], color=BLUE, lw=1.5, label="median"),
        Patch(color=BLUE, alpha=0.25, lw=0, label="middle half of the trials"),
    ]
    if not whole.all():
        label = f"{(~whole).sum()} of {len(logs)} did not run to their end"
        signs.append(Line2D([], [], color=style.ALARM, lw=0.5, label=label))
    return signs
