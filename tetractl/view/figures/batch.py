"""The errors of a batch: a dot for each trial, the means, and the published result."""

import math
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.core.colors import BLUE, PALETTE, RED
from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import Floats
from tetractl.results.describe import BatchStatistics
from tetractl.results.estimate import Distribution, published_distribution
from tetractl.results.open_batch import counts
from tetractl.view import style

COLORS = [BLUE, *(color for color in PALETTE if color not in (BLUE, RED))]
_ASIDE = 0.14  # shift of dots to the left of their category's centre [categories]


def batch_figure(
    groups: Sequence[BatchStatistics], links: Mapping[str, str] | None = None
) -> Figure:
    """Draw the total error of each counted trial by batch, and the errors of the first batch's
    robots.

    `links` maps the path of a trial to the address that its dot links to in an SVG. A headline
    names the plants.
    """
    drawn = [group for group in groups if group.counted]
    if not drawn:
        raise LogError("no complete trial to plot")
    figure = _drawn(drawn, links or {})
    plants = [group.origin.value for group in drawn]
    if len(drawn) > 1:
        plants = [f"{group.name}: {group.origin.value}" for group in drawn]
    style.headline(figure, "; ".join(plants))
    return figure


@style.styled()
def _drawn(groups: Sequence[BatchStatistics], links: Mapping[str, str]) -> Figure:
    figure = style.figure(style.PAGE_IN, 3.3)
    first = groups[0]
    unit = unit_of(first.unit)
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.25], gridspec_kw={"wspace": 0.05})
    _finish(left, _totals(left, groups, links))
    left.set_ylabel(f"total error [{unit}]")
    top = float(first.errors.max())
    for i, (errors, found) in enumerate(zip(first.errors.T, first.robots, strict=True)):
        _strip(right, i, errors, found, BLUE, top)
    _finish(right, [robot.name for robot in first.experiment.robots])
    whose = f"each robot, {first.name}" if len(groups) > 1 else "each robot"
    right.set_ylabel(f"error of {whose} [{unit}]")
    signs = [
        style.sign("one trial", marker="o", ms=4, alpha=0.7),
        style.sign("mean and its 95 % interval", ls="-", lw=4, marker="o", mfc="white"),
        style.sign("standard deviation", ls="-", lw=1),
    ]
    style.legend(figure, signs)
    return figure


def _totals(axes: Axes, groups: Sequence[BatchStatistics], links: Mapping[str, str]) -> list[str]:
    """Draw the total errors of each batch and return the labels of the batches."""
    top = max(float(group.totals.max()) for group in groups)
    labels = []
    for i, group in enumerate(groups):
        paths = [trial.path for trial in group.batch.trials if counts(trial)]
        color = COLORS[i % len(COLORS)]
        _strip(axes, i, group.totals, group.total, color, top, [links.get(p) for p in paths])
        name = textwrap.fill(group.name, 18) if len(groups) > 1 else "this batch"
        labels.append(f"{name}\nn = {group.counted}")
    if reference := groups[0].experiment.reference:
        found = published_distribution(reference.n, reference.mean, reference.std)
        _mean(axes, len(labels), found, RED)
        labels.append(f"published\nn = {reference.n}")
    return labels


def _strip(
    axes: Axes,
    at: float,
    values: Floats,
    found: Distribution,
    color: str,
    top: float,
    links: Sequence[str | None] = (),
) -> None:
    """Draw one category of the x axis: values to the left of its centre `at`, their mean to the
    right.
    """
    dots = axes.scatter(
        at - _ASIDE + _spread(values, top), values, s=16 if len(values) <= 100 else 4, color=color,
        linewidths=0, alpha=0.55, clip_on=False, gid="trials",
    )  # fmt: skip
    if any(links):
        dots.set_urls(list(links))
    _mean(axes, at + 1.4 * _ASIDE, found, color)


def _spread(values: Floats, top: float) -> Floats:
    """Return horizontal offsets, at most 0.2 of a category, that separate dots of similar
    height.
    """
    if top <= 0:
        return np.zeros(len(values))
    rows = np.rint(values / top * 40).astype(int)
    _, row, counts = np.unique(rows, return_inverse=True, return_counts=True)
    step = min(0.07, 0.4 / counts.max())
    offsets = np.zeros(len(values))
    for i, count in enumerate(counts):
        (members,) = np.nonzero(row == i)
        golden = np.argsort(np.arange(count) * 0.6180339887 % 1)  # separates neighbours
        members = members[np.argsort(values[members], kind="stable")][golden]
        offsets[members] = step * (np.arange(count) - (count - 1) / 2)
    return offsets


def _mean(axes: Axes, at: float, found: Distribution, color: str) -> None:
    """Draw a mean, a thin line over +- one standard deviation, and a thick line over the mean's 95
    % interval.
    """
    if math.isfinite(found.std):
        axes.vlines(at, max(found.mean - found.std, 0), found.mean + found.std, color, linewidth=1)
    if found.ci95.known:
        axes.vlines(at, max(found.ci95.low, 0), found.ci95.high, color, linewidth=4)
    axes.plot(at, found.mean, "o", color="white", markeredgecolor=color, markersize=5, zorder=4)


def _finish(axes: Axes, labels: Sequence[str]) -> None:
    every = math.ceil(len(labels) / 12)
    axes.set_xticks(range(0, len(labels), every), labels[::every])
    axes.set(xlim=(-0.5, len(labels) - 0.5), ylim=(0, None))
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y", color=style.FAINT, linewidth=0.6)
    axes.set_axisbelow(True)
