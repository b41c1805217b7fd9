"""The paper's Figure 5: the paths of the robots in one trial or several; for a dish, over the
microscope's picture.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import Affine2D

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import unit_of
from tetractl.core.poses import Floats
from tetractl.core.setup import Bounds, Setup
from tetractl.core.table.table import lengths
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.dish_pictures import DishPictures
from tetractl.replay.player import first_seen, tracked
from tetractl.view import style
from tetractl.view.figures.axes import (
    NUMBERED,
    check_alike,
    final_poses,
    robot_labels,
    unfinished,
)


class DishGround:
    """Shows a microscope's pictures behind the axes of a trial; nothing if its log has none."""

    def __init__(self, axes: Axes, log: TrialLog) -> None:
        self._pictures, self._shown, self._image = DishPictures(log), -1, None
        if not self._pictures.times:
            return
        low, right, up = self._pictures.corners
        place = Affine2D(np.vstack([np.column_stack([right - low, up - low, low]), [0, 0, 1]]))
        limits = axes.axis()
        self._image = axes.imshow(
            self._pictures.grey(0), cmap="gray", vmin=0, vmax=255, alpha=0.55, zorder=0,
            extent=(0, 1, 0, 1), interpolation="bilinear", transform=place + axes.transData,
        )  # fmt: skip
        axes.axis(limits)

    def show(self, when_ns: int) -> bool:
        """Show the last picture taken up to a time of the trial's clock [ns]; return whether the
        picture shown changed.
        """
        which = self._pictures.at(when_ns)
        if which is None or which == self._shown:
            return False
        assert self._image is not None, "`_image` is set if there are pictures"
        self._image.set_data(self._pictures.grey(which))
        self._shown = which
        return True


HALO = [withStroke(linewidth=1.6, foreground="white")]
LEGEND_LINE_IN = 0.156  # height of a line of the legend [in]


@style.styled()
def trajectory_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw one trial with times, headings and errors, or several trials together in lighter
    colours.

    Trails are measured positions; true paths are dashed if they differ visibly. Raises UsageError
    for logs of different robots, arenas or obstacles.
    """
    setups = [log.start.setup for log in logs]
    setup = setups[0]
    check_alike(logs)
    colors = robot_colors(setup.names, setup.colors)
    ends = np.array([final_poses(log)[:, :2] for log in logs])
    errors = [of.distances(end) for of, end in zip(setups, ends, strict=True)]
    title, names = _errors(logs, np.array(errors))
    columns = _columns(names)
    rows = title.count("\n") + 1 + -(-len(names) // columns)
    width = style.COLUMN_IN
    shape = min(max(setup.arena.height / setup.arena.width, 0.3), 2.0)
    figure = style.figure(width, (width - 0.55) * shape + 0.5 + LEGEND_LINE_IN * rows)
    axes = figure.subplots()
    named = zip(names, colors, strict=False)  # there may be no names
    figure.legend(
        handles=[style.sign(name, color=color, ls="-") for name, color in named],
        title=title, title_fontsize=7, loc="outside upper center", ncols=columns,
        columnspacing=1.2, handlelength=1.2, handletextpad=0.5,
    )  # fmt: skip
    trails = [tracked(log.mocap, log.valid) for log in logs]
    draw_scene(axes, setups, colors, trails)
    truth = _visible_truth(logs[0]) if len(logs) == 1 else None
    if len(logs) == 1:
        last = int(logs[0].mocap_ns.max(initial=0))
        DishGround(axes, logs[0]).show(logs[0].stop.sent_ns if logs[0].stop else last)
        _one(axes, logs[0], colors, truth)
    else:
        alpha = max(0.75 / len(logs) ** 0.25, 0.1)
        for trail in trails:
            for robot, color in enumerate(colors):
                axes.plot(*trail[:, robot].T, color=color, lw=0.6, alpha=alpha, zorder=3)
    size = 5 if len(logs) == 1 else 3
    for robot, color in enumerate(colors):
        axes.plot(*ends[:, robot].T, "D", ms=size, color=color, mec="white", mew=0.5, zorder=6)
    beyond = _limits(axes, setup.arena, [ends, *trails])
    _signs(figure, logs, beyond, truth is not None)
    return figure


def draw_scene(
    axes: Axes, setups: Sequence[Setup], colors: list[str], trails: Sequence[Floats]
) -> None:
    """Draw obstacles, the measured starts of one or several trails (M, N, 2), and targets, in grey
    if trials assigned them differently; NUMBERED or more robots have numbered starts and targets.
    """
    setup = setups[0]
    unit = unit_of(setup.unit)
    axes.set(aspect="equal", xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    ticks = _nice_step(max(setup.arena.width, setup.arena.height), 9)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(ticks))
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    for obstacle in setup.obstacles:
        axes.add_patch(Polygon(obstacle.outline(), zorder=1, **style.OBSTACLE))
    of_trials = zip(trails, setups, strict=True)
    starts = np.array([first_seen(trail, of.starts.xy) for trail, of in of_trials])
    targets = np.unique([of.targets for of in setups], axis=0)  # (K, N, 2)
    hold = setup.hold
    for robot, color in enumerate(colors):
        look: dict[str, Any] = {"mec": color, "zorder": 4, "clip_on": False}
        axes.plot(*starts[:, robot].T, "o", ms=6, mfc="white", **look)
        look["mec"] = style.GREY if len(targets) > 1 else color
        axes.plot(*targets[:, robot].T, "s", ms=7, mfc="none", **look)
        for point in setup.legs[:-1, robot]:
            axes.plot(*point, "s", ms=4, mfc="none", **look)
        for target in targets[:, robot]:
            if hold is not None:
                axes.add_patch(Circle(target, hold.radius, fill=False, ec=look["mec"], lw=0.6))
    if len(setup.names) >= NUMBERED:
        for robot, color in enumerate(colors):
            for place, aside in ((starts[0, robot], (0, 0)), (setup.targets[robot], (6.5, 4))):
                axes.annotate(
                    str(robot + 1), tuple(place), aside, textcoords="offset points", ha="center",
                    va="center", fontsize=4.5, color=color, path_effects=HALO, zorder=7,
                )  # fmt: skip


def _one(axes: Axes, log: TrialLog, colors: list[str], truth: Floats | None) -> None:
    """Draw trails with times and headings, the `truth` (M, N, 2) if it is given, and the errors."""
    trail = tracked(log.mocap, log.valid)
    times = _marked_times(log)
    final, setup = final_poses(log)[:, :2], log.start.setup
    ahead = 0.028 * max(setup.arena.width, setup.arena.height)
    point = setup.arena.width / (72 * (style.COLUMN_IN - 0.65))
    ring = 4 * point * np.exp(1j * np.arange(0, 2 * np.pi, np.pi / 4))
    starts = first_seen(trail, setup.starts.xy)
    marks = np.concatenate([final, setup.targets, starts])[:, None]
    marks = marks + np.column_stack([ring.real, ring.imag])
    covered = [trail[::6].reshape(-1, 2), marks.reshape(-1, 2), _edge(setup.arena)]
    labels = Labels(axes, np.concatenate(covered), point)
    for robot, color in enumerate(colors):
        xy = trail[:, robot]
        axes.plot(xy[:, 0], xy[:, 1], color=color, zorder=3, gid=f"trail-{robot}")
        if truth is not None:
            axes.plot(*truth[:, robot].T, color=style.INK, lw=0.6, ls=(0, (3, 2)), zorder=3.5)
        for time_s in times:
            index = int(np.searchsorted(log.mocap_ns, log.began_ns + time_s * SECOND - 1))
            x, y, heading = log.mocap[min(index, len(log.mocap) - 1), robot]
            tip = x + ahead * np.cos(heading), y + ahead * np.sin(heading)
            axes.plot([x, tip[0]], [y, tip[1]], color=color, lw=1.0, zorder=3.6)
            axes.plot(x, y, ".", color=color, ms=4, zorder=3.6)
            if len(colors) < NUMBERED:
                labels.write(np.array([x, y]), np.array(tip), f"{time_s:g} s")
        gap = np.array([final[robot], setup.targets[robot]])
        axes.plot(*gap.T, color=color, lw=0.6, ls=":", zorder=2)


def _edge(arena: Bounds) -> Floats:
    """Return points along the edge of the arena, shape (M, 2)."""
    x = np.linspace(arena.left, arena.right, 60)
    y = np.linspace(arena.bottom, arena.top, 60)
    rows = [np.column_stack([x, np.full(60, end)]) for end in (y[0], y[-1])]
    columns = [np.column_stack([np.full(60, end), y]) for end in (x[0], x[-1])]
    return np.concatenate([*rows, *columns])


class Labels:
    """Writes times next to the trails, each where it is farthest from other marks."""

    def __init__(self, axes: Axes, trails: Floats, point: float) -> None:
        """Place labels away from `trails` (M, 2); `point` is the number of length units that 1/72
        inch of the figure shows.
        """
        self._axes, self._point = axes, point
        self._taken = trails[np.isfinite(trails).all(axis=1)]

    def write(self, xy: Floats, tip: Floats, text: str) -> None:
        """Write text next to a tick, which is drawn from `xy` to `tip`."""
        self._taken = np.concatenate([self._taken, [tip, (xy + tip) / 2]])
        angles = np.arange(0, 2 * np.pi, np.pi / 6)
        aside = np.column_stack([9 * np.cos(angles), 6.5 * np.sin(angles)])
        spots = xy + aside * self._point
        gaps = spots[:, None] - self._taken
        gaps[..., 1] *= 1.5  # a label is wider than high
        best = int(np.linalg.norm(gaps, axis=-1).min(axis=1, initial=np.inf).argmax())
        width = np.linspace(-4, 4, 5) * self._point
        label = np.column_stack([spots[best, 0] + width, np.full(5, spots[best, 1])])
        self._taken = np.concatenate([self._taken, label])
        self._axes.annotate(
            text, (float(xy[0]), float(xy[1])), tuple(aside[best]), textcoords="offset points",
            ha="center", va="center", fontsize=5.5, color=style.INK, path_effects=HALO, zorder=5,
        )  # fmt: skip


def _limits(axes: Axes, arena: Bounds, paths: Sequence[Floats]) -> bool:
    """Show the whole arena and all paths; dash the arena's edge if a path leaves it.

    Points further from the arena than twice its longer side are cut off, so that one outlier does
    not hide the rest.
    """
    corners = np.array([[arena.left, arena.bottom], [arena.right, arena.top]])
    points = np.concatenate([path.reshape(-1, 2) for path in paths])
    points = points[np.isfinite(points).all(axis=1)]
    margin = 0.02 * max(arena.width, arena.height)
    least, most = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    far = 2.0 * max(arena.width, arena.height)
    low = np.where(least < corners[0], np.maximum(least - margin, corners[0] - far), corners[0])
    high = np.where(most > corners[1], np.minimum(most + margin, corners[1] + far), corners[1])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    beyond = bool((low < corners[0]).any() or (high > corners[1]).any())
    if beyond:
        frame = Rectangle(tuple(corners[0]), arena.width, arena.height)
        frame.set(fill=False, edgecolor=style.GREY, linewidth=0.6, linestyle="--")
        axes.add_patch(frame)
    return beyond


def _errors(logs: Sequence[TrialLog], errors: Floats) -> tuple[str, list[str]]:
    """Return the title of the robots' legend, and its entries: names and `errors` (trials, N); no
    entries for more than 30 robots.

    Means over several trials leave out incomplete ones; trials of several folders have no means.
    """
    setup = logs[0].start.setup
    unit, names = unit_of(setup.unit), robot_labels(setup.names)
    if len(logs) == 1:
        show = lengths(float(errors.sum()))
        words = [show(error) for error in errors[0]]
        title = f"error at the end [{unit}], total {show(errors.sum())}"
    elif (folders := len({log.log.rpartition("/")[0] for log in logs})) > 1:
        title, words = f"{len(logs)} trials of {folders} folders", []
    else:
        whole = np.array([not unfinished(log) for log in logs])
        counted = errors[whole] if whole.any() else errors
        words = [_spread(robot) for robot in counted.T]
        title = f"{len(logs)} trials, error at the end [{unit}], total "
        title += _spread(counted.sum(axis=1))
    texts = [f"{name}: {word}" for name, word in zip(names, words, strict=True)] if words else names
    return title, texts if len(texts) <= 30 else []


def _columns(texts: Sequence[str]) -> int:
    """Return the number of columns in which the entries of a legend fit."""
    width_pt = 3.9 * max(map(len, texts), default=0) + 20.0  # of the text, and of a sign with gaps
    return max(min(len(texts), int((72 * style.COLUMN_IN + 1) // width_pt), 6), 1)


def _spread(errors: Floats) -> str:
    """Return the mean and, of two or more errors, the standard deviation (n - 1) as text."""
    mean = float(errors.mean())
    digits = 0 if mean >= 100 else 1 if mean >= 10 else 2
    if len(errors) < 2:
        return f"{mean:.{digits}f}"
    std = float(errors.std(ddof=1))
    return f"{mean:.{digits}f} ± {std:.{digits}f}"


def _signs(figure: Figure, logs: Sequence[TrialLog], beyond: bool, truth: bool) -> None:
    """Draw the legend of the markers below the axes."""
    alone, setup = len(logs) == 1, logs[0].start.setup
    dashed: dict[str, Any] = {"lw": 0.6, "ls": (0, (3, 2))}
    signs: list[Artist] = [
        style.sign("start", marker="o", mfc="white", ms=5),
        style.sign("target", marker="s", mfc="none", ms=5),
        style.sign("end", marker="D", ms=4),
    ]
    if alone:
        signs.append(style.sign("error", lw=0.6, ls=":"))
    if setup.obstacles:
        signs.append(Patch(label="obstacle", **style.OBSTACLE))
    if alone and len(setup.names) >= NUMBERED and (times := _marked_times(logs[0])):
        signs.append(style.sign(f"every {times[0]:g} s", marker=".", ms=4))
    if beyond:
        signs.append(style.sign("arena", **dashed))
    if truth:
        signs.append(style.sign("true path", color=style.INK, **dashed))
    if len(signs) > 5:  # two lines are needed
        figure.set_figheight(figure.get_figheight() + LEGEND_LINE_IN)
    columns = len(signs) if len(signs) < 6 else 3
    style.legend(figure, signs, columns, fontsize=6, columnspacing=1.2)


def _visible_truth(log: TrialLog) -> Floats | None:
    """Return the true positions (M, N, 2); None if they are unknown, or if none is further from the
    measured position than 0.5 % of the arena's longer side.
    """
    if log.truth is None or not len(log.truth):
        return None
    gap = np.linalg.norm(log.truth[..., :2] - tracked(log.mocap, log.valid), axis=-1)
    arena = log.start.setup.arena
    differs = np.nanmax(gap, initial=0.0) > 0.005 * max(arena.width, arena.height)
    return log.truth[..., :2] if differs else None


def _marked_times(log: TrialLog) -> list[float]:
    """Return at most five times to mark [s since the first direction]: multiples of 1, 2 or 5
    times 10^n.
    """
    end_s = log.elapsed_s(int(log.mocap_ns[-1])) if len(log.mocap_ns) else 0.0
    if end_s <= 0:
        return []
    step = _nice_step(end_s, 5)
    return [float(t) for t in np.arange(step, end_s * 0.92, step)]


def _nice_step(length: float, most: int) -> float:
    """Return the least number 1, 2 or 5 times 10^n that divides a length into at most `most`
    parts.
    """
    power = 10.0 ** np.floor(np.log10(length / most))
    return float(next(n * power for n in (1, 2, 5, 10) if length / (n * power) <= most))
