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
    TIME_LABEL,
    Curve,
    create_robot_curves,
    draw_curves,
    end_s,
    name_curves,
)
from tetractl.view.figures.trials import (
    check_same_scene,
    describe_incompleteness,
    find_final_poses,
    group_by_folder,
    require_frames,
)

HEADROOM = 1.04
"""Upper limit of a panel, relative to its largest value."""
AXIS_LIMIT_MIN = 1e-9
"""Minimum upper limit of an axis [length unit], because the limits of an axis must differ."""
MEDIAN_POINTS = 400
"""Number of times at which medians are computed."""
PANELS_MAX = 12
"""Maximum number of folders in a figure. Each folder has its own panels."""


def compute_errors_at(log: TrialLog, time_s: Floats) -> Floats:
    """Compute the robots' distances to their targets (M, N) at given times (M,) [s].

    Times count from the first command. Each distance is the last measured distance up to its time.
    At the end of the trial and later, it is the error in the result, if the log has a result.
    """
    require_frames(log)
    distances = log.start.setup.distances(log.positions)
    row = np.arange(len(distances))[:, None]
    rows = np.where(np.isfinite(distances), row, 0)
    held_distances = np.take_along_axis(distances, np.maximum.accumulate(rows, axis=0), axis=0)
    newest_rows = np.searchsorted(log.frames_s, time_s, side="right") - 1
    errors = held_distances[np.maximum(newest_rows, 0)]
    if log.result is not None:  # the robots stand still after the trial
        is_after_end = time_s >= end_s(log)
        errors[is_after_end] = log.result.robot_errors
    return errors


@style.styled()
def errors_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the robots' distances to their targets over time, for one trial or several.

    For one trial, the figure shows the error of each robot. For several, it has two panels for each
    folder: the total error of every trial, and the median of each robot's error. Bands contain the
    middle half of the trials. After its end, a trial keeps its final error. Incomplete trials are
    drawn, but do not count in medians and bands.
    """
    if len(logs) == 1:
        return _draw_single_trial(logs[0])
    logs_by_folder = _group_by_panel(logs)
    # until the end of the longest trial
    time_s = np.linspace(0, max(map(end_s, logs)), MEDIAN_POINTS)
    setups = [folder_logs[0].start.setup for folder_logs in logs_by_folder.values()]
    figure, panels = _panels(setups, 2.4, 1.8, time_s[-1])
    signs: dict[str, Artist] = {}
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    for (name, folder_logs), (total_axes, robots_axes) in zip(
        logs_by_folder.items(), panels, strict=True
    ):
        _draw_errors(total_axes, robots_axes, folder_logs, time_s)
        signs |= {str(sign.get_label()): sign for sign in _draw_signs(total_axes, folder_logs)}
        title_prefix = f"{name}: " if name else ""
        trials_text = f"{len(folder_logs)} {pluralize('trial', len(folder_logs))}"
        total_title = f"total error of {trials_text}, the sum over the robots"
        robots_title = "distance of each robot to its target, median of the trials"
        total_axes.set_title(f"({next(letters)}) {title_prefix}{total_title}", loc="left")
        robots_axes.set_title(f"({next(letters)}) {title_prefix}{robots_title}", loc="left")
        total_axes.set_ylim(bottom=0)
        robots_axes.set_ylim(bottom=0)
    style.legend(figure, list(signs.values()), 5)
    return figure


def _draw_single_trial(log: TrialLog) -> Figure:
    """Draw one trial: the total error, and below it the distance of each robot to its target.

    The log must contain camera frames, otherwise LogError is raised.
    """
    require_frames(log)
    time_s = log.frames_s
    setup = log.start.setup
    unit = format_unit(setup.unit)
    distances = setup.distances(log.positions)
    final_distances = setup.distances(find_final_poses(log)[:, :2])
    # only the names show the last values, which are the result's
    distances = np.vstack([distances, final_distances])
    format_distance = create_length_format(float(final_distances.sum()))
    figure, [[total_axes, robots_axes]] = _panels([setup], 1.9, 1.6, end_s(log))
    name = f"{format_distance(final_distances.sum())} {unit}"
    total_curves = [Curve(distances.sum(axis=1), style.WHOLE, name, "total", width=1.4)]
    distance_curves = create_robot_curves(setup, distances, show=format_distance)
    _draw_from_zero(total_axes, time_s, total_curves, distances.sum(axis=1))
    _draw_from_zero(robots_axes, time_s, distance_curves, distances)
    tolerance = log.experiment.controller.arrival_tolerance
    if tolerance:
        label = f"arrival within {tolerance:g} {unit}"
        robots_axes.axhline(tolerance, **style.LIMIT, label=label)
    _mark_steps(robots_axes, log)
    total_axes.set_title("(a) total error, the sum over the robots", loc="left")
    robots_axes.set_title("(b) distance of each robot to its target", loc="left")
    style.legend(figure, robots_axes.get_legend_handles_labels()[0])
    name_curves(total_axes, total_curves)
    name_curves(robots_axes, distance_curves)
    return figure


def _draw_from_zero(axes: Axes, time_s: Floats, curves: Sequence[Curve], values: Floats) -> None:
    """Draw curves on axes that begin at 0, with room for the values since the first command.

    The last row of `values` is not drawn.
    """
    draw_curves(axes, time_s, curves)
    is_after_start = time_s >= 0
    value_max = float(np.nanmax(values[:-1][is_after_start], initial=AXIS_LIMIT_MIN))
    axes.set_ylim(0, value_max * HEADROOM)


def _group_by_panel(logs: Sequence[TrialLog]) -> dict[str, list[TrialLog]]:
    """Group trials by folder, as each folder has its own panels. A single folder has the name "".

    Raises UsageError for too many folders, and for trials of different robots in a folder.
    """
    folders = group_by_folder(logs, complete=False)
    if len(folders) > PANELS_MAX:
        raise UsageError(
            f"there are {len(folders)} folders, but this figure has panels for at most "
            f"{PANELS_MAX}",
            "give fewer folders, or use --kind batch",
            "give fewer folders, or use kind batch",
        )
    for folder_logs in folders.values():
        check_same_scene(folder_logs)
    return folders if len(folders) > 1 else {"": list(logs)}


def _draw_errors(
    total_axes: Axes, robots_axes: Axes, logs: Sequence[TrialLog], time_s: Floats
) -> None:
    """Draw the errors of the trials of one folder at the times `time_s` [s], and their medians.

    The medians are those of the complete trials or, if there are none, of all trials.
    """
    setup = logs[0].start.setup
    errors = np.array([compute_errors_at(log, time_s) for log in logs])  # (trials, M, N)
    is_complete = np.array([not describe_incompleteness(log) for log in logs])
    counted_errors = errors[is_complete] if is_complete.any() else errors
    for values, completed in zip(errors.sum(axis=2), is_complete, strict=True):
        color = style.GREY if completed else style.ALARM
        total_axes.plot(time_s, values, color=color, lw=0.5, alpha=0.6, zorder=1, gid="trial")
    total_medians, total_band = _compute_quartiles(counted_errors.sum(axis=2))
    name = f"median {total_medians[-1]:.3g} {format_unit(setup.unit)}"
    median_curves = [Curve(total_medians, style.WHOLE, name, "median", total_band, "median", 1.5)]
    draw_curves(total_axes, time_s, median_curves)
    medians, bands = _compute_quartiles(counted_errors)
    robot_median_curves = create_robot_curves(setup, medians, bands, "{:.3g}".format)
    draw_curves(robots_axes, time_s, robot_median_curves)
    name_curves(total_axes, median_curves)
    name_curves(robots_axes, robot_median_curves)


def _draw_signs(total_axes: Axes, logs: Sequence[TrialLog]) -> list[Artist]:
    """Draw the published mean if there is one, and return the entries of the legend.

    The legend also states how many of the trials did not run to their end, if any.
    """
    signs: list[Artist] = [
        style.sign("one trial", ls="-", lw=0.5),
        *total_axes.get_legend_handles_labels()[0],
        Patch(color=style.WHOLE, alpha=0.25, lw=0, label="middle half of the trials"),
    ]
    incomplete = [log for log in logs if describe_incompleteness(log)]
    if incomplete:
        label = f"{len(incomplete)} of {len(logs)} did not run to their end"
        signs.append(style.sign(label, color=style.ALARM, ls="-", lw=0.5))
    reference = logs[0].experiment.reference
    if reference:
        label = "published mean at the end"
        signs.append(total_axes.axhline(reference.mean, **style.LIMIT, label=label))
    return signs


def _compute_quartiles(values: Floats) -> tuple[Floats, Floats]:
    """Compute the median over the first axis, and the first and third quartiles, shape (2, ...).

    NaN is ignored.
    """
    lower, median, upper = np.nanpercentile(values, (25, 50, 75), axis=0)
    return median, np.stack([lower, upper])


def _panels(
    setups: Sequence[Setup], total_in: float, robots_min_in: float, end_s: float
) -> tuple[Figure, np.ndarray]:
    """Create a figure with two panels for each of several batches: axes of shape (batches, 2).

    The axes show the total error and, below, the robots' errors. All go from 0 to `end_s` [s] and
    have the same scale.
    """
    robots_in = max(robots_min_in, *(NAME_IN * len(setup.names) for setup in setups))
    figure = style.figure(style.PAGE_IN, (total_in + robots_in) * len(setups))
    ratios = [0.7 * total_in, robots_in] * len(setups)
    panels = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for index, axes in enumerate(panels):
        axes.sharey(panels[index % 2])
        axes.set(ylabel=f"error [{format_unit(setups[0].unit)}]", xlim=(0, end_s))
    panels[-1].set_xlabel(TIME_LABEL)
    return figure, panels.reshape(-1, 2)


def _mark_steps(axes: Axes, log: TrialLog) -> None:
    """Mark the times of control steps by ticks on the lower edge of the axes.

    A triangle marks each step that missed the deadline.
    """
    sent_s = log.steps_s
    is_late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    edge_transform = axes.get_xaxis_transform()
    axes.vlines(
        sent_s, 0, 0.025, color=style.GREY, lw=0.6, transform=edge_transform, label="control steps"
    )
    if is_late.any():
        axes.plot(
            sent_s[is_late], np.full(is_late.sum(), 0.04), "v", color=style.ALARM, ms=4, mew=0,
            transform=edge_transform, label="deadline missed",
        )  # fmt: skip
