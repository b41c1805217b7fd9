"""The distances of the robots to their targets over the time of a trial."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.recording import tracked
from tetractl.view import style
from tetractl.view.figures.axes import LABELLED, one_trial


def error_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the total error and the distance of each robot to its target over time."""
    log = one_trial(logs)
    if not len(log.mocap_ns):
        raise LogError(f"{log.path}: holds no camera frames to plot")
    setup = log.start.setup
    unit = style.unit_of(setup.unit)
    time_s = log.mocap_ns / SECOND
    gaps = setup.distances(tracked(log.mocap, log.valid))
    with style.styled():
        figure = style.figure(style.PAGE_IN, 2.6)
        axes = figure.subplots()
        axes.plot(time_s, gaps.sum(axis=1), color=style.INK, lw=1.4, label="total")
        named = len(setup.names) <= LABELLED
        for robot, color in enumerate(robot_colors(setup.names, setup.colors)):
            name = setup.names[robot] if named else None
            axes.plot(time_s, gaps[:, robot], color=color, lw=1.1, label=name)
        if tolerance := log.experiment.controller.arrival_tolerance:
            label = f"arrival within {tolerance:g} {unit}"
            axes.axhline(tolerance, color=style.GREY, lw=0.8, ls="--", label=label)
        sent_s = np.array([step.command.sent_ns for step in log.steps]) / SECOND
        late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
        rug = axes.get_xaxis_transform()
        axes.vlines(
            sent_s, 0, 0.025, color=style.GREY, lw=0.6, transform=rug, label="control steps"
        )
        if late.any():
            axes.plot(
                sent_s[late], np.full(late.sum(), 0.04), "v", color=style.ALARM, ms=4, mew=0,
                transform=rug, label="deadline missed",
            )  # fmt: skip
        axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
        axes.set_ylim(0, float(np.nanmax(gaps.sum(axis=1), initial=1e-9)) * 1.04)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"distance to target [{unit}]")
        _end_total(axes, log, unit)
        figure.legend(loc="outside upper center", ncols=min(len(axes.get_lines()) + 1, 7))
    return figure


def _end_total(axes: Axes, log: TrialLog, unit: str) -> None:
    if log.result is None:
        return
    text = f"{log.result.total_error:.1f} {unit}"
    axes.annotate(
        text, (1, log.result.total_error), (4, 0), xycoords=("axes fraction", "data"),
        textcoords="offset points", va="center", color=style.INK, annotation_clip=False,
    )  # fmt: skip
