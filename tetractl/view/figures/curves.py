"""Figures of errors over time: of one trial, or of the trials of several folders."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.core.table.table import lengths
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.player import end_ns, tracked
from tetractl.view import style
from tetractl.view.figures.axes import (
    NUMBERED,
    final_poses,
    panels_of,
    robot_labels,
    separated,
    unfinished,
)

NAME_IN = 0.1  # height of a robot's name at its curve [in]
SINCE = "time since the first command [s]"


@dataclass(frozen=True, slots=True)
class Curve:
    """Values (M,) over time, with a `band` of two rows (2, M), from low to high, unless it is None.

    `name` is written at the end of the curve; `key` is the curve's entry in a legend.
    """

    values: Floats
    color: str
    name: str
    gid: str
    band: Floats | None = None
    key: str = ""
    width: float = 1.1


def draw_curves(axes: Axes, time_s: Floats, curves: Iterable[Curve]) -> None:
    """Draw curves at times (M,)."""
    for curve in curves:
        if curve.band is not None:
            axes.fill_between(time_s, *curve.band, color=curve.color, alpha=0.2, lw=0)
        label = curve.key or f"_{curve.gid}"
        look = {"color": curve.color, "lw": curve.width, "label": label, "gid": curve.gid}
        axes.plot(time_s, curve.values[: len(time_s)], **look)


def name_curves(axes: Axes, curves: Sequence[Curve]) -> None:
    """Write the curves' names at the right of the axes, near the heights of their last values;
    called after the axes' limits are set.

    Names are at least the height of a line apart, in the order of the values.
    """
    ends = np.array([curve.values[-1] for curve in curves])
    size = 6.5 if len(curves) < NUMBERED else 5.5
    figure = axes.get_figure(root=True)
    assert figure is not None
    style.lay_out(figure)  # computes the height of the axes
    line = 1.3 * size / (72 * axes.get_window_extent().height / figure.dpi)
    order = np.argsort(ends, kind="stable")
    points = np.column_stack([np.zeros(len(ends)), ends[order]])
    places = axes.transAxes.inverted().transform(axes.transData.transform(points))[:, 1]
    wanted = np.clip(places, 0.0, 1.0)
    for which, height, place in zip(order, wanted, separated(wanted, line), strict=True):
        color = curves[which].color
        axes.annotate(
            curves[which].name, (1.0, float(height)), (1.025, float(place)), color=color,
            xycoords="axes fraction", textcoords="axes fraction", va="center", fontsize=size,
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-", "color": color, "lw": 0.4,
                "shrinkA": 0, "shrinkB": 0, "relpos": (0.0, 0.5),
            },
        )  # fmt: skip


def robot_curves(
    setup: Setup,
    values: Floats,
    band: Floats | None = None,
    show: Callable[[float], str] | None = None,
) -> list[Curve]:
    """Return a curve for each of N robots from values (M, N), with a `band` (2, M, N); NUMBERED or
    more robots have no bands. A curve is named after its robot, followed by the last value if
    `show` formats it.
    """
    colors, names = robot_colors(setup.names, setup.colors), robot_labels(setup.names)
    bands = [None] * len(names)
    if band is not None and len(names) < NUMBERED:
        bands = list(np.moveaxis(band, -1, 0))
    return [
        Curve(one, color, f"{name} {show(one[-1])}" if show else name, f"robot-{i}", of)
        for i, (one, color, name, of) in enumerate(zip(values.T, colors, names, bands, strict=True))
    ]


def errors_at(log: TrialLog, time_s: Floats) -> Floats:
    """Return the robots' distances to their targets (M, N) at times (M,) since the first command
    [s].

    Each distance is the last measured up to its time or, from the end of the trial on, the error in
    the result, if the log has a result.
    """
    gaps = log.start.setup.distances(tracked(log.mocap, log.valid))
    rows = np.arange(len(gaps))[:, None] * np.isfinite(gaps)
    held = np.take_along_axis(gaps, np.maximum.accumulate(rows, axis=0), axis=0)
    sampled_s = _since(log)
    found = held[np.maximum(np.searchsorted(sampled_s, time_s, side="right") - 1, 0)]
    if log.result is not None:  # the robots stand still after the trial
        found[time_s >= end_s(log)] = log.result.robot_errors
    return found


def errors_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the total error and each robot's error over time, of one trial or of several."""
    return _of_trial(logs[0]) if len(logs) == 1 else _of_trials(logs)


@style.styled()
def _of_trial(log: TrialLog) -> Figure:
    """Draw the total error, and below it the distance of each robot to its target, over time."""
    time_s = _since(log)
    setup = log.start.setup
    unit = unit_of(setup.unit)
    gaps = setup.distances(tracked(log.mocap, log.valid))
    ends = setup.distances(final_poses(log)[:, :2])
    # only the names show the last values, which are the result's
    gaps = np.vstack([gaps, ends])
    show = lengths(float(ends.sum()))
    figure, [(total, each)] = _panels([setup], 1.9, 1.6, end_s(log))
    name = f"{show(ends.sum())} {unit}"
    whole = [Curve(gaps.sum(axis=1), style.WHOLE, name, "total", width=1.4)]
    robots = robot_curves(setup, gaps, show=show)
    panels = (total, whole, gaps.sum(axis=1)), (each, robots, gaps)
    for axes, curves, values in panels:
        draw_curves(axes, time_s, curves)
        seen = values[:-1][time_s >= 0]
        axes.set_ylim(0, float(np.nanmax(seen, initial=1e-9)) * 1.04)
    if tolerance := log.experiment.controller.arrival_tolerance:
        label = f"arrival within {tolerance:g} {unit}"
        each.axhline(tolerance, **style.LIMIT, label=label)
    _mark_steps(each, log)
    total.set_title("(a) total error, the sum over the robots", loc="left")
    each.set_title("(b) distance of each robot to its target", loc="left")
    style.legend(figure, each.get_legend_handles_labels()[0])
    for axes, curves, _ in panels:
        name_curves(axes, curves)
    return figure


@style.styled()
def _of_trials(logs: Sequence[TrialLog]) -> Figure:
    """Draw the total error of every trial over time, and the median of each robot's error, in two
    panels for each folder.

    Bands contain the middle half of the trials. After its end, a trial keeps its final error.
    Incomplete trials are drawn, but not counted in medians and bands.
    """
    arms = panels_of(logs)
    time_s = _common_times(logs)
    setups = [found[0].start.setup for found in arms.values()]
    figure, panels = _panels(setups, 2.4, 1.8, time_s[-1])
    signs: dict[str, Artist] = {}
    drawn = list[tuple[Axes, list[Curve]]]()
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    for (name, found), pair in zip(arms.items(), panels, strict=True):
        curves, more = _arm_errors(found, time_s, *pair)
        drawn += zip(pair, curves, strict=True)
        signs |= {str(sign.get_label()): sign for sign in more}
        trials = f"{len(found)} trial{'s' * (len(found) > 1)}"
        total = f"total error of {trials}, the sum over the robots"
        each = "distance of each robot to its target, median of the trials"
        for axes, text in zip(pair, (total, each), strict=True):
            what = f"{name}: {text}" if name else text
            axes.set_title(f"({next(letters)}) {what}", loc="left")
            axes.set_ylim(bottom=0)
    style.legend(figure, list(signs.values()), 5)
    for axes, curves in drawn:  # the limits are set
        name_curves(axes, curves)
    return figure


def _arm_errors(
    logs: Sequence[TrialLog], time_s: Floats, total: Axes, each: Axes
) -> tuple[tuple[list[Curve], list[Curve]], list[Artist]]:
    """Draw the errors of one folder's trials; return the medians of the total error and of the
    robots' errors, and the signs of the legend.
    """
    setup = logs[0].start.setup
    errors = np.array([errors_at(log, time_s) for log in logs])  # (trials, M, N)
    whole = np.array([not unfinished(log) for log in logs])
    counted = errors[whole] if whole.any() else errors
    for values, complete in zip(errors.sum(axis=2), whole, strict=True):
        color = style.GREY if complete else style.ALARM
        total.plot(time_s, values, color=color, lw=0.5, alpha=0.6, zorder=1, gid="trial")
    middle, band = _quartiles(counted.sum(axis=2))
    name = f"median {middle[-1]:.3g} {unit_of(setup.unit)}"
    median = [Curve(middle, style.WHOLE, name, "median", band, "median", 1.5)]
    draw_curves(total, time_s, median)
    robots = robot_curves(setup, *_quartiles(counted), "{:.3g}".format)
    draw_curves(each, time_s, robots)
    signs: list[Artist] = [
        style.sign("one trial", ls="-", lw=0.5),
        *total.get_legend_handles_labels()[0],
        _middle_half(style.WHOLE),
    ]
    if not whole.all():
        label = f"{(~whole).sum()} of {len(logs)} did not run to their end"
        signs.append(style.sign(label, color=style.ALARM, ls="-", lw=0.5))
    if reference := logs[0].experiment.reference:
        label = "published mean at the end"
        signs.append(total.axhline(reference.mean, **style.LIMIT, label=label))
    return (median, robots), signs


def _quartiles(values: Floats) -> tuple[Floats, Floats]:
    """Return the median over the first axis, and the first and third quartiles (2, ...)."""
    low, middle, high = np.nanpercentile(values, (25, 50, 75), axis=0)
    return middle, np.stack([low, high])


def _panels(
    setups: Sequence[Setup], top_in: float, least_in: float, end_s: float
) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """Return a figure with two axes for each batch: for the total error and, below, for the robots'
    errors, all from 0 to `end_s` [s] and of the same scale.
    """
    each_in = max(least_in, *(NAME_IN * len(setup.names) for setup in setups))
    figure = style.figure(style.PAGE_IN, (top_in + each_in) * len(setups))
    ratios = [0.7 * top_in, each_in] * len(setups)
    panels = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for i, axes in enumerate(panels):
        axes.sharey(panels[i % 2])
        axes.set(ylabel=f"error [{unit_of(setups[0].unit)}]", xlim=(0, end_s))
    panels[-1].set_xlabel(SINCE)
    return figure, list(zip(panels[::2], panels[1::2], strict=True))


def _since(log: TrialLog) -> Floats:
    """Return the times of the camera frames since the first command [s]; LogError if there are
    none."""
    if not len(log.mocap_ns):
        raise LogError(f"{log.log}: contains no camera frames to plot")
    return (log.mocap_ns - log.began_ns) / SECOND


def end_s(log: TrialLog) -> float:
    """Return the time from the first command to the end of the trial [s], above 0."""
    return max((end_ns(log) - log.began_ns) / SECOND, 1e-9)


def _common_times(logs: Sequence[TrialLog]) -> Floats:
    """Return times since the first command (M,) until the end of the longest trial [s]."""
    return np.linspace(0, max(map(end_s, logs)), 400)


def _middle_half(color: str) -> Patch:
    return Patch(color=color, alpha=0.25, lw=0, label="middle half of the trials")


def _mark_steps(axes: Axes, log: TrialLog) -> None:
    """Mark the times of the control steps at the axes' lower edge, and which of them missed the
    deadline.
    """
    sent_s = np.array([log.elapsed_s(step.command.sent_ns) for step in log.steps])
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    rug = axes.get_xaxis_transform()
    axes.vlines(sent_s, 0, 0.025, color=style.GREY, lw=0.6, transform=rug, label="control steps")
    if late.any():
        axes.plot(
            sent_s[late], np.full(late.sum(), 0.04), "v", color=style.ALARM, ms=4, mew=0,
            transform=rug, label="deadline missed",
        )  # fmt: skip
