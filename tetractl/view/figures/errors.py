"""Figures of the robots' distances to their targets over time, for one trial or several folders."""

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.errors import UsageError, format_unit
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.log.read.trial_log import TrialLog
from tetractl.tools.table.table import create_length_format, pluralize
from tetractl.view import style
from tetractl.view.figures.curves import (
    NAME_IN,
    SINCE,
    Curve,
    draw_curves,
    end_s,
    name_curves,
    robot_curves,
)
from tetractl.view.figures.trials import (
    by_folder,
    check_alike,
    final_poses,
    need_frames,
    unfinished,
)

HEADROOM = 1.04
"""Upper limit of a panel, relative to its largest value."""
LEAST = 1e-9
"""Minimum of the largest value [length unit], because the limits of an axis must differ."""
TIMES = 400
"""Number of points of a median over time."""
PANELS_MAX = 12
"""Maximum number of folders, each of which has its own panels."""


def errors_at(log: TrialLog, time_s: Floats) -> Floats:
    """Return the robots' distances to their targets (M, N) at given times (M,) [s].

    Times count from the first command. Each distance is the last one measured up to its time. From
    the end of the trial on, it is the error in the result, if the log has one.
    """
    need_frames(log)
    gaps = log.start.setup.distances(log.positions)
    row = np.arange(len(gaps))[:, None]
    rows = np.where(np.isfinite(gaps), row, 0)
    held = np.take_along_axis(gaps, np.maximum.accumulate(rows, axis=0), axis=0)
    newest = np.searchsorted(log.frames_s, time_s, side="right") - 1
    errors = held[np.maximum(newest, 0)]
    if log.result is not None:  # the robots stand still after the trial
        ended = time_s >= end_s(log)
        errors[ended] = log.result.robot_errors
    return errors


@style.styled()
def errors_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the error, robots' distances to their targets, over time, of one trial or several.

    For one trial, the figure shows the error of each robot. For several, it has two panels for each
    folder: the total error of every trial, and the median of each robot's error. Bands contain the
    middle half of the trials. After its end, a trial keeps its final error. Incomplete trials are
    drawn, but do not count in medians and bands.
    """
    if len(logs) == 1:
        return _of_trial(logs[0])
    arms = _by_panel(logs)
    time_s = np.linspace(0, max(map(end_s, logs)), TIMES)  # until the end of the longest trial
    setups = [of_arm[0].start.setup for of_arm in arms.values()]
    figure, panels = _panels(setups, 2.4, 1.8, time_s[-1])
    signs: dict[str, Artist] = {}
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    for (name, of_arm), (of_total, of_robots) in zip(arms.items(), panels, strict=True):
        _draw_errors(of_total, of_robots, of_arm, time_s)
        signs |= {str(sign.get_label()): sign for sign in _draw_signs(of_total, of_arm)}
        start = f"{name}: " if name else ""
        trials = f"{len(of_arm)} {pluralize('trial', len(of_arm))}"
        total = f"total error of {trials}, the sum over the robots"
        robots = "distance of each robot to its target, median of the trials"
        of_total.set_title(f"({next(letters)}) {start}{total}", loc="left")
        of_robots.set_title(f"({next(letters)}) {start}{robots}", loc="left")
        of_total.set_ylim(bottom=0)
        of_robots.set_ylim(bottom=0)
    style.legend(figure, list(signs.values()), 5)
    return figure


def _of_trial(log: TrialLog) -> Figure:
    """Draw one trial: the total error, and below it the distance of each robot to its target.

    The log must contain camera frames, otherwise LogError is raised.
    """
    need_frames(log)
    time_s = log.frames_s
    setup = log.start.setup
    unit = format_unit(setup.unit)
    gaps = setup.distances(log.positions)
    ends = setup.distances(final_poses(log)[:, :2])
    # only the names show the last values, which are the result's
    gaps = np.vstack([gaps, ends])
    show = create_length_format(float(ends.sum()))
    figure, [[of_total, of_robots]] = _panels([setup], 1.9, 1.6, end_s(log))
    name = f"{show(ends.sum())} {unit}"
    total = [Curve(gaps.sum(axis=1), style.WHOLE, name, "total", width=1.4)]
    robots = robot_curves(setup, gaps, show=show)
    _draw_from_zero(of_total, time_s, total, gaps.sum(axis=1))
    _draw_from_zero(of_robots, time_s, robots, gaps)
    tolerance = log.experiment.controller.arrival_tolerance
    if tolerance:
        label = f"arrival within {tolerance:g} {unit}"
        of_robots.axhline(tolerance, **style.LIMIT, label=label)
    _mark_steps(of_robots, log)
    of_total.set_title("(a) total error, the sum over the robots", loc="left")
    of_robots.set_title("(b) distance of each robot to its target", loc="left")
    style.legend(figure, of_robots.get_legend_handles_labels()[0])
    name_curves(of_total, total)
    name_curves(of_robots, robots)
    return figure


def _draw_from_zero(axes: Axes, time_s: Floats, curves: Sequence[Curve], values: Floats) -> None:
    """Draw curves on axes that begin at 0, with room for the values since the first command.

    The last row of `values` is not drawn.
    """
    draw_curves(axes, time_s, curves)
    after_start = time_s >= 0
    greatest = float(np.nanmax(values[:-1][after_start], initial=LEAST))
    axes.set_ylim(0, greatest * HEADROOM)


def _by_panel(logs: Sequence[TrialLog]) -> dict[str, list[TrialLog]]:
    """Group trials by folder, as each folder has its own panels. A single folder has the name "".

    Raises UsageError for too many folders, and for trials of different robots in a folder.
    """
    folders = by_folder(logs, complete=False)
    if len(folders) > PANELS_MAX:
        raise UsageError(
            f"there are {len(folders)} folders, but this figure has panels for at most "
            f"{PANELS_MAX}",
            "give fewer folders, or use --kind batch",
            "give fewer folders, or use kind batch",
        )
    for of_folder in folders.values():
        check_alike(of_folder)
    return folders if len(folders) > 1 else {"": list(logs)}


def _draw_errors(of_total: Axes, of_robots: Axes, logs: Sequence[TrialLog], time_s: Floats) -> None:
    """Draw the errors of the trials of one folder at the times `time_s` [s], and their medians.

    The medians are those of the complete trials or, if there are none, of all trials.
    """
    setup = logs[0].start.setup
    errors = np.array([errors_at(log, time_s) for log in logs])  # (trials, M, N)
    completed = np.array([not unfinished(log) for log in logs])
    counted = errors[completed] if completed.any() else errors
    for values, complete in zip(errors.sum(axis=2), completed, strict=True):
        color = style.GREY if complete else style.ALARM
        of_total.plot(time_s, values, color=color, lw=0.5, alpha=0.6, zorder=1, gid="trial")
    middle, band = _quartiles(counted.sum(axis=2))
    name = f"median {middle[-1]:.3g} {format_unit(setup.unit)}"
    median = [Curve(middle, style.WHOLE, name, "median", band, "median", 1.5)]
    draw_curves(of_total, time_s, median)
    medians, bands = _quartiles(counted)
    robots = robot_curves(setup, medians, bands, "{:.3g}".format)
    draw_curves(of_robots, time_s, robots)
    name_curves(of_total, median)
    name_curves(of_robots, robots)


def _draw_signs(of_total: Axes, logs: Sequence[TrialLog]) -> list[Artist]:
    """Draw the published mean if there is one, and return the entries of the legend.

    The legend also states how many of the trials did not run to their end, if any.
    """
    signs: list[Artist] = [
        style.sign("one trial", ls="-", lw=0.5),
        *of_total.get_legend_handles_labels()[0],
        Patch(color=style.WHOLE, alpha=0.25, lw=0, label="middle half of the trials"),
    ]
    incomplete = [log for log in logs if unfinished(log)]
    if incomplete:
        label = f"{len(incomplete)} of {len(logs)} did not run to their end"
        signs.append(style.sign(label, color=style.ALARM, ls="-", lw=0.5))
    reference = logs[0].experiment.reference
    if reference:
        label = "published mean at the end"
        signs.append(of_total.axhline(reference.mean, **style.LIMIT, label=label))
    return signs


def _quartiles(values: Floats) -> tuple[Floats, Floats]:
    """Compute the median over the first axis, and the first and third quartiles, shape (2, ...).

    NaN is ignored.
    """
    low, middle, high = np.nanpercentile(values, (25, 50, 75), axis=0)
    return middle, np.stack([low, high])


def _panels(
    setups: Sequence[Setup], total_in: float, least_in: float, end_s: float
) -> tuple[Figure, np.ndarray]:
    """Create a figure with two panels for each of several batches: axes of shape (batches, 2).

    The axes show the total error and, below, the robots' errors. All go from 0 to `end_s` [s] and
    have the same scale.
    """
    robots_in = max(least_in, *(NAME_IN * len(setup.names) for setup in setups))
    figure = style.figure(style.PAGE_IN, (total_in + robots_in) * len(setups))
    ratios = [0.7 * total_in, robots_in] * len(setups)
    places = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for index, axes in enumerate(places):
        axes.sharey(places[index % 2])
        axes.set(ylabel=f"error [{format_unit(setups[0].unit)}]", xlim=(0, end_s))
    places[-1].set_xlabel(SINCE)
    return figure, places.reshape(-1, 2)


def _mark_steps(axes: Axes, log: TrialLog) -> None:
    """Mark the times of control steps by ticks on the lower edge of the axes.

    A triangle marks each step that missed the deadline.
    """
    sent_s = log.steps_s
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    rug = axes.get_xaxis_transform()
    axes.vlines(sent_s, 0, 0.025, color=style.GREY, lw=0.6, transform=rug, label="control steps")
    if late.any():
        axes.plot(
            sent_s[late], np.full(late.sum(), 0.04), "v", color=style.ALARM, ms=4, mew=0,
            transform=rug, label="deadline missed",
        )  # fmt: skip
