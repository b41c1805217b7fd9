"""The paper's Figure 5: how the robots drove, for one trial or many over one another."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator

from tetractl.errors import UsageError
from tetractl.log.records import TrialLog
from tetractl.model.state import Floats
from tetractl.replay.frame import distances, starts, targets, tracked
from tetractl.spec.experiment import Experiment
from tetractl.view import style

LABELLED = 8  # most robots that get a line of the legend each
MARKS = 5  # about as many times are marked along a trail
HALO = [withStroke(linewidth=1.6, foreground="white")]


def trajectory_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw one trial with times, headings and errors, or several lightly over one another.

    Trails are as measured; where the truth is known and differs visibly it is dashed. Raises
    UsageError where the logs are not of the same robots, arena and obstacles.
    """
    spec = logs[0].start.experiment
    for log in logs[1:]:
        _check_alike(logs[0], log)
    with style.styled():
        width = style.COLUMN_IN
        shape = min(max(spec.arena.height / spec.arena.width, 0.3), 2.0)
        figure = style.figure(width, (width - 0.55) * shape + 0.78)
        axes = figure.subplots()
        colors = style.robot_colors(spec.robots)
        _scene(axes, spec, colors)
        ends = np.array([_final(log) for log in logs])
        if len(logs) == 1:
            _one(axes, logs[0], colors)
        else:
            _many(axes, logs, colors)
        for robot, color in enumerate(colors):
            _end_marks(axes, ends[:, robot], color, alone=len(logs) == 1)
        _limits(axes, spec, ends)
        _legends(figure, logs, colors, distances(spec, ends[..., :2]))
    return figure


def _check_alike(first: TrialLog, other: TrialLog) -> None:
    a, b = first.start.experiment, other.start.experiment
    if (a.robots, a.arena, a.obstacles, a.units) != (b.robots, b.arena, b.obstacles, b.units):
        raise UsageError(
            f"{first.path} and {other.path} are of different experiments",
            "plot together only trials with the same robots, arena and obstacles",
        )


def _scene(axes: Axes, spec: Experiment, colors: list[str]) -> None:
    unit = spec.units.length
    axes.set_aspect("equal")
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")
    ticks = _nice_step(max(spec.arena.width, spec.arena.height), 9)
    axes.xaxis.set_major_locator(MultipleLocator(ticks))
    axes.yaxis.set_major_locator(MultipleLocator(ticks))
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    for obstacle in spec.obstacles:
        patch = (
            Circle(obstacle.center, obstacle.radius)
            if obstacle.type == "circle"
            else Rectangle((obstacle.left, obstacle.bottom), obstacle.width, obstacle.height)
        )
        patch.set(facecolor=style.OBSTACLE, edgecolor=style.OBSTACLE_EDGE, linewidth=0.6, zorder=1)
        axes.add_patch(patch)
    for robot, color in zip(spec.robots, colors, strict=True):
        look: dict[str, Any] = {
            "markeredgecolor": color,
            "linestyle": "none",
            "zorder": 4,
            "clip_on": False,
        }
        axes.plot(*robot.start, marker="o", markersize=6, markerfacecolor="white", **look)
        axes.plot(*robot.target, marker="s", markersize=7, markerfacecolor="none", **look)


def _one(axes: Axes, log: TrialLog, colors: list[str]) -> None:
    trail = tracked(log.mocap, log.valid)
    truth = _visible_truth(log)
    times = _marked_times(log)
    final, spec = _final(log)[:, :2], log.start.experiment
    ahead = 0.028 * max(spec.arena.width, spec.arena.height)
    point = spec.arena.width / (72 * (style.COLUMN_IN - 0.65))
    crowd = [trail[::6].reshape(-1, 2), final, targets(spec), starts(spec)[:, :2], _edge(spec)]
    labels = _Labels(axes, np.concatenate(crowd), point)
    for robot, color in enumerate(colors):
        xy = trail[:, robot]
        axes.plot(xy[:, 0], xy[:, 1], color=color, zorder=3, gid=f"trail-{robot}")
        if truth is not None:
            axes.plot(*truth[:, robot].T, color=style.INK, lw=0.6, ls=(0, (3, 2)), zorder=3.5)
        for time_s in times:
            index = int(np.searchsorted(log.mocap_ns, time_s * 1e9 - 1))
            x, y, heading = log.mocap[min(index, len(log.mocap) - 1), robot]
            tip = x + ahead * np.cos(heading), y + ahead * np.sin(heading)
            axes.plot([x, tip[0]], [y, tip[1]], color=color, lw=1.0, zorder=3.6)
            axes.plot(x, y, ".", color=color, ms=4, zorder=3.6)
            labels.write(np.array([x, y]), np.array(tip), f"{time_s:g} s")
        gap = np.array([final[robot], spec.robots[robot].target])
        axes.plot(*gap.T, color=color, lw=0.6, ls=":", zorder=2)


def _edge(spec: Experiment) -> Floats:
    """Points all along the edge of the arena, shape (M, 2)."""
    arena = spec.arena
    x = np.linspace(arena.left, arena.left + arena.width, 60)
    y = np.linspace(arena.bottom, arena.bottom + arena.height, 60)
    rows = [np.column_stack([x, np.full(60, end)]) for end in (y[0], y[-1])]
    columns = [np.column_stack([np.full(60, end), y]) for end in (x[0], x[-1])]
    return np.concatenate([*rows, *columns])


class _Labels:
    """Writes times beside the trails, each on the side where there is most room."""

    def __init__(self, axes: Axes, trails: Floats, point: float) -> None:
        """Keep clear of `trails` (M, 2); `point` is a typographic point in length units."""
        self._axes, self._point = axes, point
        self._taken = trails[np.isfinite(trails).all(axis=1)]

    def write(self, xy: Floats, tip: Floats, text: str) -> None:
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
            text,
            (float(xy[0]), float(xy[1])),
            xytext=tuple(aside[best]),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=5.5,
            color=style.INK,
            path_effects=HALO,
            zorder=5,
        )


def _many(axes: Axes, logs: Sequence[TrialLog], colors: list[str]) -> None:
    alpha = max(0.75 / len(logs) ** 0.25, 0.1)
    for log in logs:
        trail = tracked(log.mocap, log.valid)
        for robot, color in enumerate(colors):
            xy = trail[:, robot]
            axes.plot(xy[:, 0], xy[:, 1], color=color, lw=0.6, alpha=alpha, zorder=3)


def _end_marks(axes: Axes, ends: Floats, color: str, alone: bool) -> None:
    size = 6 if alone else 4
    look: dict[str, Any] = {
        "markeredgecolor": "white",
        "markeredgewidth": 0.5,
        "linestyle": "none",
        "zorder": 6,
    }
    axes.plot(ends[:, 0], ends[:, 1], marker="D", markersize=size - 1, color=color, **look)


def _limits(axes: Axes, spec: Experiment, ends: Floats) -> None:
    arena = spec.arena
    corners = np.array(
        [[arena.left, arena.bottom], [arena.left + arena.width, arena.bottom + arena.height]]
    )
    ends = ends[..., :2].reshape(-1, 2)
    ends = ends[np.isfinite(ends).all(axis=1)]
    margin = 0.02 * max(arena.width, arena.height)
    least, most = ends.min(axis=0, initial=np.inf), ends.max(axis=0, initial=-np.inf)
    low = np.where(least < corners[0], least - margin, corners[0])
    high = np.where(most > corners[1], most + margin, corners[1])
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    if (low < corners[0]).any() or (high > corners[1]).any():
        frame = Rectangle(tuple(corners[0]), arena.width, arena.height)
        frame.set(fill=False, edgecolor=style.GREY, linewidth=0.6, linestyle="--")
        axes.add_patch(frame)


def _legends(figure: Figure, logs: Sequence[TrialLog], colors: list[str], errors: Floats) -> None:
    """Errors above the axes, the signs below: neither can cover a trail."""
    spec = logs[0].start.experiment
    unit = spec.units.length
    total = errors.sum(axis=1)
    if len(logs) == 1:
        words = [f"{error:.1f}" for error in errors[0]]
        title = f"error at the end [{unit}], total {total[0]:.1f}"
    else:
        words = [_spread(robot) for robot in errors.T]
        title = f"{len(logs)} trials, error at the end [{unit}], total {_spread(total)}"
    handles = [
        Line2D([], [], color=color, label=f"{robot.name} {word}")
        for robot, color, word in zip(spec.robots, colors, words, strict=True)
    ][: LABELLED if len(colors) <= LABELLED else 0]
    figure.legend(
        handles=handles,
        title=title,
        title_fontsize=7,
        loc="outside upper center",
        ncols=3,
        columnspacing=1.4,
        handlelength=1.2,
        handletextpad=0.5,
    )
    figure.legend(
        handles=_signs(logs), loc="outside lower center", ncols=4, fontsize=6, columnspacing=1.2
    )


def _spread(errors: Floats) -> str:
    """Mean and standard deviation (n - 1)."""
    mean, std = float(errors.mean()), float(errors.std(ddof=1))
    digits = 0 if mean >= 100 else 1 if mean >= 10 else 2
    return f"{mean:.{digits}f} ± {std:.{digits}f}"


def _signs(logs: Sequence[TrialLog]) -> list[Line2D | Patch]:
    grey: dict[str, Any] = {"color": style.GREY, "linestyle": "none"}
    signs: list[Line2D | Patch] = [
        Line2D([], [], marker="o", markerfacecolor="white", markersize=5, label="start", **grey),
        Line2D([], [], marker="s", markerfacecolor="none", markersize=5, label="target", **grey),
        Line2D([], [], marker="D", markersize=4, label="end", **grey),
    ]
    if logs[0].start.experiment.obstacles:
        signs.append(
            Patch(facecolor=style.OBSTACLE, edgecolor=style.OBSTACLE_EDGE, lw=0.6, label="obstacle")
        )
    if len(logs) == 1 and _visible_truth(logs[0]) is not None:
        signs.append(Line2D([], [], color=style.INK, lw=0.6, ls=(0, (3, 2)), label="true path"))
    return signs


def _final(log: TrialLog) -> Floats:
    """Last poses (N, 3): as the plant judged them, else the last that were measured."""
    if log.result is not None:
        return log.result.verdict.final.array()
    poses = starts(log.start.experiment)
    for robot in range(len(poses)):
        seen = np.flatnonzero(log.valid[:, robot])
        if len(seen):
            poses[robot] = log.mocap[seen[-1], robot]
    return poses


def _visible_truth(log: TrialLog) -> Floats | None:
    """True positions (M, N, 2), if they leave the measured ones by more than 0.5 % of the arena."""
    if log.truth is None or not len(log.truth):
        return None
    gap = np.linalg.norm(log.truth[..., :2] - tracked(log.mocap, log.valid), axis=-1)
    arena = log.start.experiment.arena
    differs = np.nanmax(gap, initial=0.0) > 0.005 * max(arena.width, arena.height)
    return log.truth[..., :2] if differs else None


def _marked_times(log: TrialLog) -> list[float]:
    """Whole numbers of 1, 2, 5, 10 ... s, at most `MARKS` of them, within the trial."""
    end_s = float(log.mocap_ns[-1]) / 1e9 if len(log.mocap_ns) else 0.0
    if end_s <= 0:
        return []
    step = _nice_step(end_s, MARKS)
    return [float(t) for t in np.arange(step, end_s * 0.92, step)]


def _nice_step(length: float, most: int) -> float:
    """Least 1, 2 or 5 times a power of ten that divides a length into at most `most` parts."""
    power = 10.0 ** np.floor(np.log10(length / most))
    return float(next(n * power for n in (1, 2, 5, 10) if length / (n * power) <= most))
