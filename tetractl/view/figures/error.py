"""The distances of the robots to their targets over the time of a trial."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError
from tetractl.core.poses import Floats
from tetractl.core.text import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.recording import tracked
from tetractl.view import style
from tetractl.view.figures.axes import one_trial, robot_labels
from tetractl.view.figures.labels import end_labels

LINE_IN = 0.1  # height of a robot's label


def error_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the total error, and below it the distance of each robot to its target, over time."""
    log = one_trial(logs)
    if not len(log.mocap_ns):
        raise LogError(f"{log.path}: holds no camera frames to plot")
    setup = log.start.setup
    unit = unit_of(setup.unit)
    time_s = (log.mocap_ns - log.began_ns) / SECOND
    gaps = setup.distances(tracked(log.mocap, log.valid))
    with style.styled():
        each_in = max(1.6, LINE_IN * len(setup.names))
        figure = style.figure(style.PAGE_IN, 1.9 + each_in)
        total, each = figure.subplots(2, 1, sharex=True, height_ratios=[1.2, each_in])
        total.plot(time_s, gaps.sum(axis=1), color=style.INK, lw=1.4)
        colors = robot_colors(setup.names, setup.colors)
        for robot, color in enumerate(colors):
            each.plot(time_s, gaps[:, robot], color=color, lw=1.1, gid=f"robot-{robot}")
        if tolerance := log.experiment.controller.arrival_tolerance:
            label = f"arrival within {tolerance:g} {unit}"
            each.axhline(tolerance, color=style.GREY, lw=0.8, ls="--", label=label)
        _steps(each, log)
        since = time_s >= 0
        for axes, values in ((total, gaps.sum(axis=1)), (each, gaps)):
            axes.set_ylim(0, float(np.nanmax(values[since], initial=1e-9)) * 1.04)
            axes.set_ylabel(f"error [{unit}]")
        total.set_xlim(0, max(float(time_s[-1]), 1e-9))
        each.set_xlabel("time since the first command [s]")
        style.panel(total, "a", "total error")
        style.panel(each, "b", "distance of each robot to its target")
        figure.legend(loc="outside lower center", ncols=3)
        _ends(total, each, log, gaps, colors)
    return figure


def _steps(axes: Axes, log: TrialLog) -> None:
    """Mark the control steps at the lower edge, and the missed deadlines."""
    sent_s = np.array([log.elapsed_s(step.command.sent_ns) for step in log.steps])
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    rug = axes.get_xaxis_transform()
    axes.vlines(sent_s, 0, 0.025, color=style.GREY, lw=0.6, transform=rug, label="control steps")
    if late.any():
        axes.plot(
            sent_s[late], np.full(late.sum(), 0.04), "v", color=style.ALARM, ms=4, mew=0,
            transform=rug, label="deadline missed",
        )  # fmt: skip


def _ends(total: Axes, each: Axes, log: TrialLog, gaps: Floats, colors: list[str]) -> None:
    """Write the errors at the end beside the curves: the result's, else the last ones measured."""
    setup = log.start.setup
    errors = _last(gaps) if log.result is None else np.array(log.result.robot_errors)
    unit = unit_of(setup.unit)
    end_labels(total, [errors.sum()], [f"{errors.sum():.1f} {unit}"], [style.INK])
    names = robot_labels(setup.names)
    texts = [f"{name} {error:.1f}" for name, error in zip(names, errors, strict=True)]
    end_labels(each, errors.tolist(), texts, colors)


def _last(gaps: Floats) -> Floats:
    """Return the last distance (N,) of each robot that was measured, 0 for none."""
    known = np.isfinite(gaps)
    last = len(gaps) - 1 - known[::-1].argmax(axis=0)
    return np.nan_to_num(gaps[last, np.arange(gaps.shape[1])])
