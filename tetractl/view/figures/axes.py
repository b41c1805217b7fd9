"""Functions shared by figures: selecting trials, names of robots, and axes."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import (
    FuncFormatter,
    LogFormatterMathtext,
    LogLocator,
    MaxNLocator,
    NullFormatter,
)

from tetractl.core.errors import LogError, UsageError
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog

NUMBERED = 8
"""Least number of robots that are numbered."""
NAME_LENGTH = 16
"""Largest length of a robot's name [characters]."""
PANELS_MAX = 12
"""Largest number of panels of a figure with a panel for each folder."""
LOG_FROM = 30
"""Ratio of the largest error to the least from which their axis is logarithmic."""
ROWS = 40
"""Heights of an axis of errors: the dots of one are put side by side."""
GOLDEN = 0.6180339887
"""The golden ratio minus 1: multiples of it, modulo 1, are far from their neighbours."""
EVEN_RATIO = 5
"""Ratio of the limits of a logarithmic axis below which its ticks are even."""
MARKED_RATIO = 1000
"""Ratio below which there are ticks at 1, 2 and 5 of each decade."""
DECIMAL_FROM = 1e-3
DECIMAL_TO = 1e5
"""Limits between which the ticks of a logarithmic axis are decimal numbers."""
FLAT_RATIO = 1.1
"""Ratio of the values up to which they count as one, whose axis goes FLAT_ROOM beyond it."""
FLAT_ROOM = 1.05
NO_VALUES = (0.1, 10.0)
"""Limits of a logarithmic axis without values."""
CHARACTER_IN = 0.05
"""Width of a character of a category's name [in]."""
LINE_IN = 0.1
"""Height of a line of a category's name [in]."""
NAMES_MANY = 50
"""Number of categories from which their names are small."""
NAME_PT = 6
SMALL_NAME_PT = 4
"""Sizes of type of the names of categories [pt]."""


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
    folders: dict[str, list[TrialLog]] = {}
    for log in logs:
        if not complete or not unfinished(log):
            folder, _, _ = log.log.rpartition("/")
            folders.setdefault(folder, []).append(log)
    if not folders:
        raise LogError("no complete trial to plot")
    names = [folder.rpartition("/")[2] or "trials" for folder in folders]
    distinct = len(set(names)) == len(names)
    labels = names if distinct else list(folders)
    return dict(zip(labels, folders.values(), strict=True))


def panels_of(logs: Sequence[TrialLog]) -> dict[str, list[TrialLog]]:
    """Return the trials of each folder, for a panel each; a single folder has the name "".

    Raises UsageError for too many folders, and for trials of unlike robots in a folder.
    """
    folders = by_folder(logs, complete=False)
    if len(folders) > PANELS_MAX:
        raise UsageError(
            f"{len(folders)} folders: this figure has a panel for each of at most {PANELS_MAX}",
            "give fewer folders, or use --kind batch",
        )
    for of_folder in folders.values():
        check_alike(of_folder)
    return folders if len(folders) > 1 else {"": list(logs)}


def robot_labels(names: Sequence[str]) -> list[str]:
    """Return the robots' names for a figure: shortened, and numbered if there are NUMBERED or
    more.
    """
    short = [name if len(name) <= NAME_LENGTH else f"{name[: NAME_LENGTH - 1]}…" for name in names]
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
        frames = np.flatnonzero(log.valid[:, robot])
        if len(frames):
            poses[robot] = log.mocap[frames[-1], robot]
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
    low, high = _log_limits(values, below, above)
    ratio = high / low
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    if ratio < EVEN_RATIO:
        axes.yaxis.set_major_locator(MaxNLocator(4))
    elif ratio < MARKED_RATIO:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    else:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0,)))
    if (low >= DECIMAL_FROM and high <= DECIMAL_TO) or ratio < EVEN_RATIO:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    else:
        axes.yaxis.set_major_formatter(LogFormatterMathtext(labelOnlyBase=False))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _log_limits(values: Floats, below: float, above: float) -> tuple[float, float]:
    """Return the limits of a logarithmic axis: beyond the values by fractions of their range."""
    finite = values[np.isfinite(values)]
    low, high = NO_VALUES
    if len(finite):
        low = float(finite.min())
        high = float(finite.max())
    if high <= FLAT_RATIO * low:
        low = low / FLAT_ROOM
        high = high * FLAT_ROOM
    ratio = high / low
    return low / ratio**below, high * ratio**above


@dataclass(frozen=True, slots=True)
class ErrorScale:
    """The scale of an axis of errors from the `least` to the `greatest` of a figure: from 0, or
    logarithmic where the greatest is LOG_FROM times the least."""

    least: float
    greatest: float

    @classmethod
    def of(cls, errors: Floats) -> "ErrorScale":
        """Return the scale of a figure's errors (n,)."""
        return cls(float(errors.min()), float(errors.max()))

    @property
    def logarithmic(self) -> bool:
        """Whether small errors could not be distinguished next to the greatest one."""
        return 0 < LOG_FROM * self.least <= self.greatest

    def columns(self, errors: Floats) -> Floats:
        """Return the columns (n,) of dots, about 0, that separate dots of similar height."""
        if self.logarithmic:
            heights = np.log(errors / self.least) / math.log(self.greatest / self.least)
        elif self.greatest > 0:
            heights = errors / self.greatest
        else:
            heights = errors
        columns = np.zeros(len(errors))
        row = np.rint(heights * ROWS).astype(int)
        for height in np.unique(row):
            (members,) = np.nonzero(row == height)
            rising = members[np.argsort(errors[members], kind="stable")]
            places = np.arange(len(members))
            separated = np.argsort(places * GOLDEN % 1)  # neighbours in height are far apart
            columns[rising[separated]] = places - (len(members) - 1) / 2
        return columns


def name_categories(axes: Axes, names: Sequence[str], width_in: float) -> None:
    """Label the x axis, `width_in` wide, with the names of categories, and make the figure higher
    by the labels.

    The names are level, with a line for each field of an arm, or upright if these lines are too
    long.
    """
    level = [re.sub(r"-(?=[\w.]+=)", "\n", name) for name in names]
    longest = max(len(line) for label in level for line in label.split("\n"))
    fits = CHARACTER_IN * (longest + 2) < width_in / len(names)
    if fits:
        labels = level
        below_in = LINE_IN * max(label.count("\n") for label in level)
    else:
        labels = [name.replace("\n", ", ") for name in names]
        below_in = CHARACTER_IN * max(map(len, names))
    size = NAME_PT if len(names) < NAMES_MANY else SMALL_NAME_PT
    axes.set_xticks(range(len(names)), labels)
    axes.tick_params(axis="x", length=0, rotation=0 if fits else 90, labelsize=size)
    axes.set_xlim(-0.5, len(names) - 0.5)
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.set_figheight(figure.get_figheight() + below_in)


def whole_ticks(axes: Axes) -> None:
    """Place the ticks of the x axis at whole numbers."""
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))


def separated(wanted: Floats, gap: float) -> Floats:
    """Return increasing heights from 0 to 1, at least `gap` apart, near the increasing heights
    `wanted` (n,), of which the last may be NaN: unknown.

    Less i times the gap, heights that are far enough apart do not decrease. Nearest to the wanted
    ones by least squares are those of the isotonic regression,

        height i = the greatest, over j <= i, of the least, over k >= i, of the means of j to k.

    Then all heights are shifted into the range, as far as they fit.
    """
    rise = gap * np.arange(len(wanted))
    sums = np.concatenate([[0.0], np.cumsum(wanted - rise)])
    first, last = np.indices((len(wanted), len(wanted)))
    means = np.full(first.shape, np.inf)
    np.divide(sums[last + 1] - sums[first], last - first + 1, out=means, where=last >= first)
    least = np.fmin.accumulate(means[:, ::-1], axis=1)[:, ::-1]
    base = np.fmax.accumulate(least, axis=0).diagonal()
    highest = max(1.0 - gap * (len(wanted) - 1), 0.0)
    return np.asarray(np.clip(base, 0.0, highest) + rise, dtype=np.float64)
