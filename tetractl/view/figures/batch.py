"""The errors of a batch: a dot for each trial, the means, and the published result."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tetractl.core.colors import BLUE, GREEN, RED
from tetractl.core.errors import LogError
from tetractl.core.poses import Floats
from tetractl.stats.comparison import Comparison
from tetractl.stats.estimate import Distribution, describe_published
from tetractl.stats.summary import Summary
from tetractl.view import style

_ASIDE = 0.14  # how far dots stand left of the centre of their category
_MANY = 100  # more trials than this get small dots
_LABELS = 12  # most categories that get a label


def batch_figure(summary: Summary, comparison: Comparison | None = None) -> Figure:
    """Draw the total errors of the counted trials and, beside them, those of each robot.

    A headline says what was steered.
    """
    if summary.counted == 0:
        raise LogError("no complete trial to plot")
    with style.styled():
        figure = _drawn(summary, comparison)
    origin = summary.origin.value
    if comparison:
        origin = f"this batch: {origin}; against: {comparison.theirs.origin}"
    style.headline(figure, origin)
    return figure


def _drawn(summary: Summary, comparison: Comparison | None) -> Figure:
    figure = style.figure(style.PAGE_IN, 3.3)
    unit = style.unit_of(summary.unit)
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.25], gridspec_kw={"wspace": 0.05})
    _finish(left, _totals(left, summary, comparison))
    left.set_ylabel(f"total error [{unit}]")
    top = float(summary.errors.max())
    for i, (errors, found) in enumerate(zip(summary.errors.T, summary.robots, strict=True)):
        _strip(right, i, errors, found, BLUE, top)
    _finish(right, [robot.name for robot in summary.experiment.robots])
    whose = "each robot, this batch" if comparison else "each robot"
    right.set_ylabel(f"error of {whose} [{unit}]")
    figure.legend(handles=_key(), loc="outside lower center", ncols=3)
    return figure


def _totals(axes: Axes, summary: Summary, comparison: Comparison | None) -> list[str]:
    """Draw the strips of total errors and return their labels."""
    batches = [("this batch", summary, BLUE)]
    if comparison and comparison.theirs.counted:
        batches.append(("against", comparison.theirs, GREEN))
    top = max(float(batch.totals.max()) for _, batch, _ in batches)
    labels = []
    for i, (label, batch, color) in enumerate(batches):
        _strip(axes, i, batch.totals, batch.total, color, top)
        labels.append(f"{label}\nn = {batch.counted}")
    if reference := summary.experiment.reference:
        found = describe_published(reference.n, reference.mean, reference.std)
        _mean(axes, len(labels), found, RED)
        labels.append(f"published\nn = {reference.n}")
    return labels


def _strip(
    axes: Axes, at: float, values: Floats, found: Distribution, color: str, top: float
) -> None:
    """Draw the values of one category left of its centre and their mean right of it."""
    axes.plot(
        at - _ASIDE + _spread(values, top),
        values,
        "o",
        color=color,
        markersize=4 if len(values) <= _MANY else 2,
        markeredgewidth=0,
        alpha=0.55,
        clip_on=False,
    )
    _mean(axes, at + 1.4 * _ASIDE, found, color)


def _spread(values: Floats, top: float) -> Floats:
    """Offsets, at most 0.2 categories, that set dots of nearly equal height side by side."""
    if top <= 0:
        return np.zeros(len(values))
    rows = np.rint(values / top * 40).astype(int)
    _, row, counts = np.unique(rows, return_inverse=True, return_counts=True)
    step = min(0.07, 0.4 / counts.max())
    offsets = np.zeros(len(values))
    for i, count in enumerate(counts):
        (members,) = np.nonzero(row == i)
        golden = np.argsort(np.arange(count) * 0.6180339887 % 1)  # scatters a row's heights
        members = members[np.argsort(values[members], kind="stable")][golden]
        offsets[members] = step * (np.arange(count) - (count - 1) / 2)
    return offsets


def _mean(axes: Axes, at: float, found: Distribution, color: str) -> None:
    """Draw a mean: a thin line for +- one standard deviation, a thick one for its interval."""
    if math.isfinite(found.std):
        axes.vlines(at, max(found.mean - found.std, 0), found.mean + found.std, color, linewidth=1)
    if found.ci95.known:
        axes.vlines(at, max(found.ci95.low, 0), found.ci95.high, color, linewidth=4)
    axes.plot(at, found.mean, "o", color="white", markeredgecolor=color, markersize=5, zorder=4)


def _finish(axes: Axes, labels: Sequence[str]) -> None:
    every = math.ceil(len(labels) / _LABELS)
    axes.set_xticks(range(0, len(labels), every), labels[::every])
    axes.set_xlim(-0.5, len(labels) - 0.5)
    axes.set_ylim(bottom=0)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y", color=style.FAINT, linewidth=0.6)
    axes.set_axisbelow(True)


def _key() -> list[Line2D]:
    def key(label: str, **look: object) -> Line2D:
        return Line2D([], [], color=style.GREY, label=label, **look)  # pyright: ignore[reportArgumentType]

    return [
        key("one trial", linestyle="none", marker="o", markersize=4, alpha=0.7),
        key("mean and its 95 % interval", linewidth=4, marker="o", markerfacecolor="white"),
        key("standard deviation", linewidth=1),
    ]
