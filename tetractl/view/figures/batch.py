"""The errors of batches of trials: a dot for each trial, the means, and the distributions.

The band of a distribution is Dvoretzky, Kiefer and Wolfowitz's with Massart's constant (Ann.
Probab. 18, 1990): with the half width sqrt(ln(2 / 0.05) / 2n), it contains the whole true
distribution function with at least 95 % probability.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import Floats
from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import TrialLog
from tetractl.results.describe import BatchStatistics
from tetractl.results.estimate import (
    CONFIDENCE,
    Distribution,
    distributions,
    published_distribution,
)
from tetractl.results.open_batch import GIVEN_DIRECTIONS, counts, directions_given
from tetractl.view import style
from tetractl.view.figures.axes import by_folder, name_categories

_ASIDE = 0.14  # shift of dots to the left of their category's centre [categories]
SHADED = 4  # most batches whose bands are shaded: more would hide one another


@dataclass(frozen=True, slots=True)
class BatchErrors:
    """The total errors (n,) of a batch's counted trials, with the path of each trial; and whether
    no controller decided in them."""

    name: str
    totals: Floats
    paths: Sequence[str]
    given: bool


def figure_of_logs(logs: Sequence[TrialLog]) -> Figure:
    """Draw the final total errors of each folder's trials; only complete trials count."""
    batches = list[BatchErrors]()
    for name, found in by_folder(logs).items():
        known = [
            (log.result.total_error, log.log)
            for log in found
            if log.result is not None and math.isfinite(log.result.total_error)
        ]
        totals = np.array([error for error, _ in known])
        paths = [path for _, path in known]
        batches.append(BatchErrors(name, totals, paths, directions_given(found[0].experiment)))
    return _drawn(batches, logs[0].experiment, {})


def batch_figure(
    groups: Sequence[BatchStatistics], links: Mapping[str, str] | None = None
) -> Figure:
    """Draw the total errors of the counted trials of every batch; a headline names the plants.

    `links` maps the path of a trial to the address that its dot links to in an SVG.
    """
    batches = list[BatchErrors]()
    for group in groups:
        paths = [trial.log for trial in group.batch.trials if counts(trial)]
        given = directions_given(group.experiment)
        batches.append(BatchErrors(group.name, group.totals, paths, given))
    figure = _drawn(batches, groups[0].experiment, links or {})
    shown = [group for group in groups if group.counted]
    plants = sorted({group.origin.value for group in shown})
    if len(plants) > 1:
        plants = [f"{group.name}: {group.origin.value}" for group in shown]
    style.headline(figure, "; ".join(plants))
    return figure


@style.styled()
def _drawn(
    batches: Sequence[BatchErrors], experiment: Experiment, links: Mapping[str, str]
) -> Figure:
    shown = [batch for batch in batches if len(batch.totals)]
    if not shown:
        raise LogError("no complete trial to plot")
    figure = style.figure(style.PAGE_IN, 3.0)
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.1])
    error = f"total error [{unit_of(experiment.units.length)}]"
    style.panel(left, "a", "each trial, and the mean", y=error)
    labels = _dots(left, shown, links)
    if reference := experiment.reference:
        published = published_distribution(reference.n, reference.mean, reference.std)
        _mean(left, len(labels), published, style.GREY)
        labels.append(f"published\nn = {reference.n}")
    name_categories(left, labels, 0.4 * style.PAGE_IN)
    left.set_ylim(bottom=0)
    left.grid(axis="y", color=style.FAINT, linewidth=0.6)
    left.set_axisbelow(True)
    style.panel(right, "b", "fraction of trials with at most an error", error)
    _distributions(right, shown)
    signs = [
        style.sign("one trial", marker="o", ms=4, alpha=0.7),
        style.sign("mean and its 95 % interval", ls="-", lw=4, marker="o", mfc="white"),
        style.sign("standard deviation", ls="-", lw=1),
    ]
    whole = Patch(color=style.GREY, alpha=0.3, lw=0, label="95 % band of a whole curve")
    curves = right.get_legend_handles_labels()[0] if len(shown) > 1 else []
    style.legend(figure, [*signs, whole, *curves], 4)
    return figure


def _dots(axes: Axes, batches: Sequence[BatchErrors], links: Mapping[str, str]) -> list[str]:
    """Draw a category of the x axis for each batch, and return their labels: values to the left
    of the category's centre, their mean to the right.
    """
    top = max(float(batch.totals.max()) for batch in batches)
    labels = list[str]()
    for place, batch in enumerate(batches):
        color = style.batch_look(place)["color"]
        count = len(batch.totals)
        dots = axes.scatter(
            place - _ASIDE + _spread(batch.totals, top), batch.totals, s=16 if count <= 100 else 4,
            color=color, linewidths=0, alpha=0.55, clip_on=False, gid="trials",
        )  # fmt: skip
        addresses = [links.get(path) for path in batch.paths]
        if any(addresses):
            dots.set_urls(addresses)
        _mean(axes, place + 1.4 * _ASIDE, distributions(batch.totals[None])[0], color)
        name = batch.name if len(batches) > 1 else "this batch"
        lines = [name, f"n = {count}"]
        if batch.given:
            lines.append(GIVEN_DIRECTIONS)
        labels.append("\n".join(lines))
    return labels


def _spread(values: Floats, top: float) -> Floats:
    """Return horizontal offsets, at most 0.2 of a category, that separate dots of similar
    height.
    """
    if top <= 0:
        return np.zeros(len(values))
    rows = np.rint(values / top * 40).astype(int)
    _, row, counted = np.unique(rows, return_inverse=True, return_counts=True)
    step = min(0.07, 0.4 / counted.max())
    offsets = np.zeros(len(values))
    for i, count in enumerate(counted):
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
    axes.plot(
        at,
        found.mean,
        "o",
        color="white",
        markeredgecolor=color,
        markersize=5,
        zorder=4,
        clip_on=False,
    )


def band(n: int) -> float:
    """Return half the height of the band for n values, as a fraction of all trials."""
    return math.sqrt(math.log(2 / (1 - CONFIDENCE)) / (2 * n))


def _distributions(axes: Axes, batches: Sequence[BatchErrors]) -> None:
    """Draw the empirical distribution function of each batch, with its band."""
    end = max(float(batch.totals.max()) for batch in batches)
    for number, batch in enumerate(batches):
        look = style.batch_look(number)
        n = len(batch.totals)
        x = np.concatenate([[0.0], np.sort(batch.totals), [1.02 * end]])
        share = np.append(np.arange(n + 1), n) / n
        low = np.clip(share - band(n), 0, 1)
        high = np.clip(share + band(n), 0, 1)
        if len(batches) <= SHADED and band(n) < 1:
            axes.fill_between(x, low, high, step="post", color=look["color"], alpha=0.18, lw=0)
        axes.step(x, share, where="post", lw=1.3, label=batch.name, gid="share", **look)
    axes.set(xlim=(0, 1.02 * end or 1.0), ylim=(0, 1.02))
