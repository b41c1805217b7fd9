"""Functions shared by figures: selecting trials, names of robots, axes and ellipses."""

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from matplotlib.ticker import (
    FuncFormatter,
    LogFormatterMathtext,
    LogLocator,
    MaxNLocator,
    NullFormatter,
)

from tetractl.core.errors import LogError, UsageError
from tetractl.core.poses import Floats, ellipse
from tetractl.log.read.trial_log import TrialLog

NUMBERED = 8  # least number of robots that are numbered


def one_trial(logs: Sequence[TrialLog]) -> TrialLog:
    """Return the only log; UsageError if there are several."""
    if len(logs) > 1:
        raise UsageError(
            f"this figure shows one trial, not {len(logs)}",
            "give one log, or use --kind trajectory, errors or batch",
        )
    return logs[0]


def by_folder(logs: Sequence[TrialLog], complete: bool = True) -> dict[str, list[TrialLog]]:
    """Return the trials of each folder, only the `complete` ones or all; the key is the folder's
    name, or its path if two folders have the same name.

    Raises UsageError if the trials' errors are in different units, LogError if there is no trial.
    """
    units = {log.start.setup.unit for log in logs}
    if len(units) > 1:
        raise UsageError(f"errors in {' and '.join(sorted(units))} cannot share an axis")
    found: dict[str, list[TrialLog]] = {}
    for log in logs:
        if not complete or not unfinished(log):
            found.setdefault(log.log.rpartition("/")[0], []).append(log)
    if not found:
        raise LogError("no complete trial to plot")
    names = [folder.rpartition("/")[2] or "trials" for folder in found]
    labels = names if len(set(names)) == len(names) else list(found)
    return dict(zip(labels, found.values(), strict=True))


def panels_of(logs: Sequence[TrialLog]) -> dict[str, list[TrialLog]]:
    """Return the trials of each folder, for a panel each; a single folder has the name "".

    Raises UsageError for too many folders, and for trials of unlike robots in a folder.
    """
    found = by_folder(logs, complete=False)
    if len(found) > 12:
        raise UsageError(
            f"{len(found)} folders: this figure has a panel for each of at most 12",
            "give fewer folders, or use --kind batch",
        )
    for arm in found.values():
        check_alike(arm)
    return found if len(found) > 1 else {"": list(logs)}


def robot_labels(names: Sequence[str]) -> list[str]:
    """Return the robots' names for a figure: shortened, and numbered if there are NUMBERED or
    more.
    """
    short = [name if len(name) <= 16 else f"{name[:15]}…" for name in names]
    if len(names) < NUMBERED:
        return short
    return [f"{number} {name}" for number, name in enumerate(short, start=1)]


def unfinished(log: TrialLog) -> str:
    """Return the outcome and reason of a trial that was not completed, "" for a complete one."""
    if log.result is None:
        return "the log breaks off before the end of the trial"
    if log.result.outcome.complete:
        return ""
    return f"{log.result.outcome.value}: {log.result.reason}"


def broken_off(logs: Sequence[TrialLog]) -> str:
    """Return a figure's note on the number of incomplete trials, "" for none."""
    if len(logs) == 1:
        return unfinished(logs[0])
    cut = sum(1 for log in logs if unfinished(log))
    if not cut:
        return ""
    counted = "" if cut == len(logs) else ", not in the means"
    return f"{cut} of {len(logs)} trials did not run to their end{counted}"


def check_alike(logs: Sequence[TrialLog]) -> None:
    """Raise UsageError for logs of different arenas, obstacles, units or robots; robots that each
    trial chose by the same rule are not different.
    """

    def scene(log: TrialLog) -> tuple[object, ...]:
        spec = log.experiment
        return spec.asked, spec.arena, spec.obstacles, spec.units

    for log in logs[1:]:
        if scene(log) != scene(logs[0]):
            raise UsageError(
                f"{logs[0].log} and {log.log} are of different experiments",
                "plot together only trials with the same robots, arena and obstacles",
            )


def final_poses(log: TrialLog) -> Floats:
    """Return the final poses (N, 3) of the result or, without a result, the last measured poses."""
    if log.result is not None:
        return log.result.verdict.final.array()
    poses = log.start.setup.starts.array()
    for robot in range(len(poses)):
        seen = np.flatnonzero(log.valid[:, robot])
        if len(seen):
            poses[robot] = log.mocap[seen[-1], robot]
    return poses


def need_steps(log: TrialLog) -> None:
    """Raise LogError for a log without control steps."""
    if not log.steps:
        raise LogError(f"{log.log}: contains no control steps to plot")


def positive(values: Floats) -> Floats:
    """Return values with NaN in place of values that are not positive and finite."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def log_axis(axes: Axes, values: Floats, below: float, above: float) -> None:
    """Make the y axis logarithmic, to show positive values (others may be NaN).

    It goes beyond them by the fractions `below` and `above` of their range. The ticks are even if
    the limits have a ratio below 5, at 1, 2 and 5 of each decade below 1000, otherwise at each
    decade. All have the same format: decimal if the limits lie between 0.001 and 100,000 or have a
    ratio below 5, else powers of ten.
    """
    seen = values[np.isfinite(values)]
    low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.1, 10.0)
    if high <= 1.1 * low:
        low, high = low / 1.05, high * 1.05
    low, high = low / (high / low) ** below, high * (high / low) ** above
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    if high / low < 5:
        axes.yaxis.set_major_locator(MaxNLocator(4))
    else:
        marks = (1.0, 2.0, 5.0) if high / low < 1000 else (1.0,)
        axes.yaxis.set_major_locator(LogLocator(subs=marks))
    if (low >= 1e-3 and high <= 1e5) or high / low < 5:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    else:
        axes.yaxis.set_major_formatter(LogFormatterMathtext(labelOnlyBase=False))
    axes.yaxis.set_minor_formatter(NullFormatter())


def name_categories(axes: Axes, names: Sequence[str], width_in: float) -> None:
    """Label the x axis, `width_in` wide, with the names of categories, and make the figure higher
    by the labels.

    The names are level, with a line for each field of an arm, or upright if these lines are too
    long.
    """
    char_in = 0.05  # width of a character [inches]
    level = [re.sub(r"-(?=[\w.]+=)", "\n", name) for name in names]
    longest = max(len(line) for label in level for line in label.split("\n"))
    fits = char_in * (longest + 2) < width_in / len(names)
    axes.set_xticks(
        range(len(names)), level if fits else [one.replace("\n", ", ") for one in names]
    )
    axes.tick_params(axis="x", length=0, rotation=0 if fits else 90)
    axes.tick_params(axis="x", labelsize=6 if len(names) < 50 else 4)
    axes.set_xlim(-0.5, len(names) - 0.5)
    lines = max(label.count("\n") for label in level)
    figure = axes.get_figure(root=True)
    assert figure is not None
    below_in = 0.1 * lines if fits else char_in * max(map(len, names))
    figure.set_figheight(figure.get_figheight() + below_in)


def whole_ticks(axes: Axes) -> None:
    """Place the ticks of the x axis at whole numbers."""
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))


def draw_ellipse(axes: Axes, centre: tuple[float, float], covariance: Floats, **look: Any) -> float:
    """Draw the ellipse that contains 95 % of a normal distribution; return its long half axis."""
    long, short, angle = ellipse(covariance)
    axes.add_patch(
        Ellipse(centre, 2 * long, 2 * short, angle=math.degrees(angle), fill=False, **look)
    )
    return long


def separated(wanted: Floats, gap: float) -> Floats:
    """Return increasing heights from 0 to 1, at least `gap` apart, near the increasing heights
    `wanted`.

    Neighbours that would overlap form a block around the mean of their heights, the least-squares
    solution. Then all heights are shifted into the range, as far as they fit.
    """
    blocks: list[tuple[float, int]] = []  # mean of wanted - index * gap, and the number of heights
    for i, height in enumerate(wanted):
        mean, count = float(height) - i * gap, 1
        while blocks and blocks[-1][0] > mean:
            before, many = blocks.pop()
            mean, count = (mean * count + before * many) / (count + many), count + many
        blocks.append((mean, count))
    base = np.repeat([mean for mean, _ in blocks], [count for _, count in blocks])
    rise = gap * np.arange(len(wanted))
    highest = max(1.0 - gap * (len(wanted) - 1), 0.0)
    return np.asarray(np.clip(base, 0.0, highest) + rise, dtype=np.float64)
