"""Draws the paths of the robots in one or more trials (the paper's Figure 5).

The paths of cells in a dish are drawn over the microscope's image.

`trajectory_figure` draws the scene (`draw_scene`), the paths (`_draw_single_trial` or
`_draw_several_trials`), their ends, a legend of the robots above, and a legend of the signs below.

Shapes: T trials of N robots; a trail is (M, N, 2), NaN where a robot was not seen. Places are in
the trials' unit of length, sizes on paper in points [1/72 inch] or inches.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import format_unit
from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Bounds, Setup
from tetractl.log.read.trial_log import TrialLog
from tetractl.tools.table.table import create_length_format
from tetractl.verification.dish_pictures import DishPictures
from tetractl.view import style
from tetractl.view.figures.trials import (
    NUMBERED_MIN,
    check_same_scene,
    describe_incompleteness,
    find_final_poses,
    robot_labels,
)
from tetractl.view.player import find_first_positions

WIDTH_IN = style.COLUMN_IN
BESIDE_AXES_IN = 0.55
ABOVE_AND_BELOW_AXES_IN = 0.5
"""Space above and below the axes for their labels [in]. BESIDE_AXES_IN is that beside them."""
LEGEND_LINE_IN = 0.156
"""Height of a line of a legend [in]."""
SHAPE_MIN = 0.3
SHAPE_MAX = 2.0
"""Maximum height of the axes, relative to their width. SHAPE_MIN is the minimum."""
PARTS_OF_ARENA = 9
"""Maximum number of parts into which ticks divide the arena's longer side."""
NAMED_MAX = 30
"""Maximum number of robots that have entries in the legend."""
LETTER_WIDTH_PT = 3.9
"""Width of a letter of the legend [points]."""
SIGN_WIDTH_PT = 20.0
"""Width of a sign of the legend with its gaps [points]."""
LEGEND_COLUMNS_MAX = 6
SIGNS_IN_A_LINE = 5
"""Maximum number of signs in one line. More signs are in lines of three."""
PICTURE_SIDE_IN = 5.0
"""Longer side of the image of a trial that is still running [in]."""
PICTURE_PIXELS_PER_INCH = 100

MARGIN = 0.02
"""Distance of a path that leaves the arena from the frame, relative to the arena's longer side."""
FAR_OUTSIDE_MAX = 2.0
"""Maximum distance outside the arena at which a path is shown, relative to its longer side.

An outlier therefore does not hide the rest.
"""
TRUTH_DISTANCE_MIN = 0.005
"""Minimum distance at which a true path is drawn, relative to the arena's longer side.

It is the distance of the true positions from the measured ones.
"""

TIMES_MAX = 5
MARKED_FRACTION_MAX = 0.92
"""Fraction of the trial after which no time is marked, because the end has its own sign.

TIMES_MAX is the maximum number of times that are marked.
"""
TICK = 0.028
"""Length of a tick that shows a heading, relative to the arena's longer side."""
LABEL_ASIDE_PT = 9.0
"""Distance of a time from its robot, to the left of the robot's heading [points]."""
ERROR_LINE_MIN = 0.04
"""Minimum error that leaves a line between the signs of end and target free.

It is relative to the arena's longer side.
"""

DASHED_STYLE: dict[str, Any] = {"lw": 0.6, "ls": (0, (3, 2))}
"""Line style of a true path, and of the arena's edge in the legend."""
EDGE: dict[str, Any] = {"fill": False, "edgecolor": style.GREY, "linewidth": 0.6, "linestyle": "--"}
DOTTED_STYLE: dict[str, Any] = {"lw": 0.6, "ls": ":"}
"""Line style of the error at the end, where the signs of end and target do not cover it."""
END: dict[str, Any] = {"mec": "white", "mew": 0.5, "zorder": 6}
HALO = [withStroke(linewidth=1.6, foreground="white")]
PICTURE: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 255, "alpha": 0.55, "zorder": 0}


@style.styled()
def trajectory_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the paths of one trial, or of several trials together in lighter colours.

    One trial is drawn with times, headings and errors. Trails are measured positions. True paths
    are dashed if they differ visibly.

    Raises:
        UsageError: If the logs have different robots, arenas or obstacles.
    """
    check_same_scene(logs)
    setups = [log.start.setup for log in logs]
    setup = setups[0]
    colors = robot_colors(setup.names, setup.colors)
    trails = [log.positions for log in logs]
    final_positions = np.array([find_final_poses(log)[:, :2] for log in logs])  # (T, N, 2)
    is_single = len(logs) == 1

    title, legend_entries = _compose_heading(logs, final_positions)
    figure = _create_titled_figure(setup.arena, title, legend_entries, colors)
    axes = figure.subplots()
    draw_scene(axes, setups, colors, trails)
    leaves_arena = _set_limits(axes, setup.arena, [final_positions, *trails])
    truth = _find_visible_truth(logs[0]) if is_single else None
    if is_single:
        _draw_single_trial(axes, logs[0], colors, truth)
    else:
        _draw_several_trials(axes, trails, colors)
    for robot, color in enumerate(colors):
        axes.plot(*final_positions[:, robot].T, "D", ms=5 if is_single else 3, color=color, **END)
    shows_errors = is_single and bool(_robots_with_error_line(logs[0]).any())
    _add_sign_legend(
        figure,
        logs,
        leaves_arena=leaves_arena,
        shows_truth=truth is not None,
        shows_errors=shows_errors,
    )
    return figure


# ---- The scene ----


def draw_scene(
    axes: Axes, setups: Sequence[Setup], colors: list[str], trails: Sequence[Floats]
) -> None:
    """Draw the arena with obstacles, starts and targets.

    Targets are grey if trials assigned them differently. NUMBERED_MIN or more robots have numbered
    starts and targets.

    Args:
        axes: The axes.
        setups: The constants of each trial.
        colors: The robots' colours.
        trails: The measured trails, shape (M, N, 2) each, where the starts are taken from.
    """
    setup = setups[0]
    unit = format_unit(setup.unit)
    arena = setup.arena
    axes.set(aspect="equal", xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    axes.set(xlim=(arena.left, arena.right), ylim=(arena.bottom, arena.top))
    tick_step = _round_step(arena.longer_side, PARTS_OF_ARENA)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(tick_step))
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(True)
    for obstacle in setup.obstacles:
        axes.add_patch(Polygon(obstacle.outline(), zorder=1, **style.OBSTACLE))
    starts = np.array(
        [
            find_first_positions(trail, trial.starts.xy)
            for trail, trial in zip(trails, setups, strict=True)
        ]
    )
    targets = np.unique([trial.targets for trial in setups], axis=0)  # (K, N, 2), K assignments
    for robot, color in enumerate(colors):
        target_color = style.GREY if len(targets) > 1 else color
        marker_style: dict[str, Any] = {"zorder": 4, "clip_on": False}
        axes.plot(*starts[:, robot].T, "o", ms=6, mfc="white", mec=color, **marker_style)
        axes.plot(*targets[:, robot].T, "s", ms=7, mfc="none", mec=target_color, **marker_style)
        for point in setup.legs[:-1, robot]:
            axes.plot(*point, "s", ms=4, mfc="none", mec=target_color, **marker_style)
        if setup.hold is not None:
            for target in targets[:, robot]:
                circle = Circle(target, setup.hold.radius, fill=False, ec=target_color, lw=0.6)
                axes.add_patch(circle)
    if len(setup.names) >= NUMBERED_MIN:
        for robot, color in enumerate(colors):
            _write_number(axes, robot, color, starts[0, robot], aside_pt=(0, 0))
            _write_number(axes, robot, color, setup.targets[robot], aside_pt=(6.5, 4))


def _write_number(
    axes: Axes, robot: int, color: str, position: Floats, aside_pt: tuple[float, float]
) -> None:
    """Write the number of a robot, its index plus 1, beside a place.

    `aside_pt` is the offset of the text from the place, x and y [pt].
    """
    axes.annotate(
        str(robot + 1), tuple(position), aside_pt, textcoords="offset points", ha="center",
        va="center", fontsize=4.5, color=color, path_effects=HALO, zorder=7,
    )  # fmt: skip


class DishBackground:
    """The background of a figure of cells in a dish: the microscope's images, if there are any."""

    def __init__(self, axes: Axes, log: TrialLog) -> None:
        self._pictures = DishPictures(log)
        self._shown_index = -1
        self._image = None
        if not self._pictures.times_ns:
            return
        lower_left, lower_right, upper_left = self._pictures.corners
        image_to_axes = Affine2D(
            np.vstack(
                [
                    np.column_stack(
                        [lower_right - lower_left, upper_left - lower_left, lower_left]
                    ),
                    [0, 0, 1],
                ]
            )
        )
        limits = axes.axis()
        self._image = axes.imshow(
            self._pictures.grey(0), extent=(0, 1, 0, 1), interpolation="bilinear",
            transform=image_to_axes + axes.transData, **PICTURE,
        )  # fmt: skip
        axes.axis(limits)

    def show(self, when_ns: int) -> bool:
        """Show the last image that was taken up to a time of the trial's clock [ns].

        Returns:
            Whether the image that is shown has changed.
        """
        index = self._pictures.index_at(when_ns)
        if index is None or index == self._shown_index:
            return False
        assert self._image is not None, "`_image` is set if there are pictures"
        self._image.set_data(self._pictures.grey(index))
        self._shown_index = index
        return True


def _set_limits(axes: Axes, arena: Bounds, paths: Sequence[Floats]) -> bool:
    """Set the limits of the axes to show the whole arena, and all paths up to FAR_OUTSIDE_MAX.

    Returns:
        Whether a path leaves the arena. The arena's edge is then drawn as a dashed line.
    """
    corners = np.array([[arena.left, arena.bottom], [arena.right, arena.top]])
    points = np.concatenate([path.reshape(-1, 2) for path in paths])
    points = points[np.isfinite(points).all(axis=1)]
    margin = MARGIN * arena.longer_side
    far_outside = FAR_OUTSIDE_MAX * arena.longer_side
    minima = points.min(axis=0, initial=np.inf)
    maxima = points.max(axis=0, initial=-np.inf)
    lower_limits = np.where(
        minima < corners[0], np.maximum(minima - margin, corners[0] - far_outside), corners[0]
    )
    upper_limits = np.where(
        maxima > corners[1], np.minimum(maxima + margin, corners[1] + far_outside), corners[1]
    )
    axes.set(xlim=(lower_limits[0], upper_limits[0]), ylim=(lower_limits[1], upper_limits[1]))
    leaves_arena = bool((lower_limits < corners[0]).any() or (upper_limits > corners[1]).any())
    if leaves_arena:
        edge_patch = Rectangle((arena.left, arena.bottom), arena.width, arena.height)
        axes.add_patch(edge_patch).set(**EDGE)
    return leaves_arena


# ---- Paths ----


def _draw_several_trials(axes: Axes, trails: Sequence[Floats], colors: list[str]) -> None:
    """Draw the paths of several trials, in fainter colours the more there are."""
    alpha = max(0.75 / len(trails) ** 0.25, 0.1)
    for trail in trails:
        for robot, color in enumerate(colors):
            axes.plot(*trail[:, robot].T, color=color, lw=0.6, alpha=alpha, zorder=3)


def _draw_single_trial(axes: Axes, log: TrialLog, colors: list[str], truth: Floats | None) -> None:
    """Draw the measured paths of one trial over its last image.

    The paths are marked with times and headings, and with the errors at the end.

    Args:
        axes: The axes.
        log: The trial.
        colors: The robots' colours.
        truth: The true paths to draw, shape (M, N, 2). None to draw no true paths.
    """
    setup = log.start.setup
    trail = log.positions
    final_positions = find_final_poses(log)[:, :2]
    last_ns = log.stop.sent_ns if log.stop else int(log.mocap_ns.max(initial=0))
    DishBackground(axes, log).show(last_ns)
    for robot, color in enumerate(colors):
        axes.plot(*trail[:, robot].T, color=color, zorder=3, gid=f"trail-{robot}")
        if truth is not None:
            axes.plot(*truth[:, robot].T, color=style.INK, zorder=3.5, **DASHED_STYLE)
        for time_s in _choose_marked_times(log):
            _mark_time(axes, log, robot, color, time_s)
    for robot in np.flatnonzero(_robots_with_error_line(log)):
        error_line = np.array([final_positions[robot], setup.targets[robot]])
        axes.plot(*error_line.T, color=colors[robot], zorder=2, **DOTTED_STYLE)


def _robots_with_error_line(log: TrialLog) -> Bools:
    """Find the robots (N,) for which a line fits between the marks of their end and target.

    The distance must exceed ERROR_LINE_MIN times the longer side of the arena.
    """
    errors = np.linalg.norm(find_final_poses(log)[:, :2] - log.start.setup.targets, axis=1)
    return np.asarray(errors > ERROR_LINE_MIN * log.start.setup.arena.longer_side)


def _mark_time(axes: Axes, log: TrialLog, robot: int, color: str, time_s: float) -> None:
    """Mark a time since the first direction on a robot's path, by a tick along its heading.

    If there are fewer than NUMBERED_MIN robots, the time is written to the left of the robot.
    Nothing is drawn if the robot was not tracked at this time.
    """
    frame = int(np.searchsorted(log.mocap_ns, log.began_ns + time_s * SECOND - 1))
    frame = min(frame, len(log.mocap) - 1)
    if not log.valid[frame, robot]:
        return
    x, y, heading = log.mocap[frame, robot].tolist()
    tick_length = TICK * log.start.setup.arena.longer_side
    tip_x = x + tick_length * math.cos(heading)
    tip_y = y + tick_length * math.sin(heading)
    axes.plot([x, tip_x], [y, tip_y], color=color, lw=1.0, zorder=3.6)
    axes.plot(x, y, ".", color=color, ms=4, zorder=3.6)
    if len(log.start.setup.names) >= NUMBERED_MIN:
        return
    aside_pt = -LABEL_ASIDE_PT * math.sin(heading), LABEL_ASIDE_PT * math.cos(heading)
    axes.annotate(
        f"{time_s:g} s", (x, y), aside_pt, textcoords="offset points", ha="center", va="center",
        fontsize=5.5, color=style.INK, path_effects=HALO, zorder=5,
    )  # fmt: skip


def _find_visible_truth(log: TrialLog) -> Floats | None:
    """Return the true positions (M, N, 2) if they visibly differ from the measured positions.

    The result is None if they are unknown, or if no difference exceeds TRUTH_DISTANCE_MIN.
    """
    if log.truth is None or not len(log.truth):
        return None
    true_positions = log.truth[..., :2]
    distances = np.linalg.norm(true_positions - log.positions, axis=-1)
    differs = (
        np.nanmax(distances, initial=0.0) > TRUTH_DISTANCE_MIN * log.start.setup.arena.longer_side
    )
    return true_positions if differs else None


def _choose_marked_times(log: TrialLog) -> list[float]:
    """Select at most TIMES_MAX round times to mark on the paths [s since the first direction].

    They are multiples of 1, 2 or 5 times 10^n.
    """
    end_s = log.elapsed_s(int(log.mocap_ns[-1])) if len(log.mocap_ns) else 0.0
    if end_s <= 0:
        return []
    step_s = _round_step(end_s, TIMES_MAX)
    return [float(time_s) for time_s in np.arange(step_s, end_s * MARKED_FRACTION_MAX, step_s)]


# ---- Legends ----


def _create_titled_figure(
    arena: Bounds, title: str, entries: list[str], colors: list[str]
) -> Figure:
    """Create an empty figure with a title, for axes with the shape of the arena.

    Below the title are the `entries`, which may be empty or one for each robot, in as many columns
    as fit.
    """
    entry_length_max = max((len(entry) for entry in entries), default=0)
    columns_that_fit = int(
        (72 * WIDTH_IN + 1) // (LETTER_WIDTH_PT * entry_length_max + SIGN_WIDTH_PT)
    )
    n_columns = max(min(len(entries), columns_that_fit, LEGEND_COLUMNS_MAX), 1)
    n_lines = title.count("\n") + 1 + math.ceil(len(entries) / n_columns)
    aspect = min(max(arena.height / arena.width, SHAPE_MIN), SHAPE_MAX)
    axes_in = (WIDTH_IN - BESIDE_AXES_IN) * aspect
    figure = style.figure(WIDTH_IN, axes_in + ABOVE_AND_BELOW_AXES_IN + LEGEND_LINE_IN * n_lines)
    colored_entries = zip(entries, colors, strict=False)
    figure.legend(
        handles=[style.sign(entry, color=color, ls="-") for entry, color in colored_entries],
        title=title, title_fontsize=7, loc="outside upper center",
        ncols=n_columns, columnspacing=1.2, handlelength=1.2, handletextpad=0.5,
    )  # fmt: skip
    return figure


def _compose_heading(logs: Sequence[TrialLog], final_positions: Floats) -> tuple[str, list[str]]:
    """Compose the title of a figure of trials, and an entry for each robot: its name and error.

    Means over several trials leave out incomplete trials. For trials of several folders, no means
    are stated. For more than NAMED_MAX robots, there are no entries.

    Args:
        logs: The trials.
        final_positions: Positions of the robots at the end of each trial, shape (T, N, 2).
    """
    setup = logs[0].start.setup
    unit = format_unit(setup.unit)
    errors = np.array(
        [
            log.start.setup.distances(trial_positions)
            for log, trial_positions in zip(logs, final_positions, strict=True)
        ]
    )
    names = robot_labels(setup.names)
    folders = {log.log.rpartition("/")[0] for log in logs}
    if len(logs) == 1:
        total_error = float(errors.sum())
        format_error = create_length_format(total_error)
        title = f"error at the end [{unit}], total {format_error(total_error)}"
        entries = _with_errors(names, [format_error(error) for error in errors[0]])
    elif len(folders) > 1:
        title = f"{len(logs)} trials of {len(folders)} folders"
        entries = names
    else:
        is_complete = np.array([not describe_incompleteness(log) for log in logs])
        counted_errors = errors[is_complete] if is_complete.any() else errors
        total_error = _mean_and_std(counted_errors.sum(axis=1))
        title = f"{len(logs)} trials, error at the end [{unit}], total {total_error}"
        entries = _with_errors(
            names, [_mean_and_std(robot_errors) for robot_errors in counted_errors.T]
        )
    return title, entries if len(entries) <= NAMED_MAX else []


def _with_errors(names: list[str], errors: list[str]) -> list[str]:
    return [f"{name}: {error}" for name, error in zip(names, errors, strict=True)]


def _mean_and_std(errors: Floats) -> str:
    """Format the mean of errors and, for two or more errors, their standard deviation (n - 1)."""
    mean = float(errors.mean())
    decimals = 2
    if mean >= 10:
        decimals = 1
    if mean >= 100:
        decimals = 0
    if len(errors) < 2:
        return f"{mean:.{decimals}f}"
    std = float(errors.std(ddof=1))
    return f"{mean:.{decimals}f} ± {std:.{decimals}f}"


def _add_sign_legend(
    figure: Figure,
    logs: Sequence[TrialLog],
    leaves_arena: bool,
    shows_truth: bool,
    shows_errors: bool,
) -> None:
    """Draw a legend below the axes that explains the markers in the figure.

    Args:
        figure: The figure.
        logs: The trials.
        leaves_arena: Whether a path leaves the arena.
        shows_truth: Whether true paths are drawn.
        shows_errors: Whether the line of an error is drawn.
    """
    is_single = len(logs) == 1
    setup = logs[0].start.setup
    signs: list[Artist] = [
        style.sign("start", marker="o", mfc="white", ms=5),
        style.sign("target", marker="s", mfc="none", ms=5),
        style.sign("end", marker="D", ms=4),
    ]
    if shows_errors:
        signs.append(style.sign("error: end to target", **DOTTED_STYLE))
    if setup.obstacles:
        signs.append(Patch(label="obstacle", **style.OBSTACLE))
    times_s = (
        _choose_marked_times(logs[0]) if is_single and len(setup.names) >= NUMBERED_MIN else []
    )
    if times_s:
        signs.append(style.sign(f"every {times_s[0]:g} s", marker=".", ms=4))
    if leaves_arena:
        signs.append(style.sign("arena", **DASHED_STYLE))
    if shows_truth:
        signs.append(style.sign("true path", color=style.INK, **DASHED_STYLE))
    n_columns = len(signs)
    if len(signs) > SIGNS_IN_A_LINE:
        n_columns = 3
        figure.set_figheight(figure.get_figheight() + LEGEND_LINE_IN)
    style.legend(figure, signs, n_columns, fontsize=6, columnspacing=1.2)


def draw_arena_picture(setup: Setup, positions: Floats) -> NDArray[np.uint8]:
    """Draw an image (H, W, 3) of a trial that is still running.

    It shows the scene, and the robots' positions so far in `positions`, shape (M, N, 2).
    """
    arena = setup.arena
    in_per_unit = PICTURE_SIDE_IN / arena.longer_side
    size_in = in_per_unit * arena.width, in_per_unit * arena.height
    figure = Figure(size_in, PICTURE_PIXELS_PER_INCH, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    colors = robot_colors(setup.names, setup.colors)
    draw_scene(axes, [setup], colors, [positions])
    for robot, color in enumerate(colors):
        axes.plot(*positions[:, robot].T, color=color, lw=1.3)
        axes.plot(*positions[-1, robot], "o", color=color, ms=6)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


# ---- Sizes ----


def _round_step(extent: float, parts_max: int) -> float:
    """Compute the smallest step of 1, 2 or 5 times 10^n with which an extent has few parts.

    Args:
        extent: The extent to divide.
        parts_max: Maximum number of parts.
    """
    power_of_ten = 10.0 ** np.floor(np.log10(extent / parts_max))
    for multiple in (1, 2, 5):
        if extent / (multiple * power_of_ten) <= parts_max:
            return float(multiple * power_of_ten)
    return float(10 * power_of_ten)
