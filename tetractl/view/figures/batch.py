"""The errors of batches of trials: a dot for each trial, the means, and the distributions.

Each distribution has a confidence band, Dvoretzky, Kiefer and Wolfowitz's with Massart's constant
(Ann. Probab. 18, 1990): with the half width sqrt(ln(2 / 0.05) / 2n), it contains the whole true
distribution function with at least 95 % probability.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.spec.experiment import Experiment
from tetractl.statistics.describe import BatchStatistics
from tetractl.statistics.estimate import (
    CONFIDENCE,
    Distribution,
    distributions,
    published_distribution,
)
from tetractl.statistics.open_batch import counts
from tetractl.statistics.tables import GIVEN_DIRECTIONS
from tetractl.view import style
from tetractl.view.figures.axes import log_axis, name_categories, spans_orders
from tetractl.view.figures.trials import by_folder

DOTS_ASIDE = 0.14
"""Shift of dots to the left of their category's centre [categories]."""
MEAN_ASIDE = 1.4 * DOTS_ASIDE
"""Shift of the mean to the right of its category's centre [categories]."""
DOTS_WIDTH = 0.25
"""Width of a batch's dots [categories]."""
GOLDEN = 0.6180339887
"""The golden ratio minus 1: multiples of it, modulo 1, are far from their neighbours."""
MANY = 100
"""Number of trials beyond which dots are smaller."""
DOT_PT2 = 16
"""Area of a dot [pt^2]."""
SMALL_DOT_PT2 = 4
"""Area of a dot if there are more than MANY trials [pt^2]."""
SHADED = 4
"""Maximum number of batches whose bands are shaded: more would hide one another."""
ROOM = 0.05
"""Room beyond the errors of a logarithmic axis, as a fraction of their range."""
BEYOND = 1.02
"""Upper limits of the axes of a distribution, relative to the largest values."""
NARROW_IN = 4.2
"""Width of the figure with its panels one above the other, for a page that a phone shows [in]."""


@dataclass(frozen=True, slots=True)
class BatchErrors:
    """The total errors of those trials of a batch that count in its statistics.

    Attributes:
        name: Name of the batch.
        totals: The errors, shape (n,).
        paths: The log of each trial.
        given_directions: Whether no controller decided in them.
    """

    name: str
    totals: Floats
    paths: Sequence[str]
    given_directions: bool

    @property
    def label(self) -> str:
        """The batch's label in the figure: the number of trials as "n = 20".

        A second line says if directions were given instead of chosen by a controller.
        """
        lines = [f"n = {len(self.totals)}"]
        if self.given_directions:
            lines.append(GIVEN_DIRECTIONS)
        return "\n".join(lines)


def figure_of_logs(logs: Sequence[TrialLog]) -> Figure:
    """Draw the final total errors of the trials in each folder.

    Trials without a result or with an unknown error are left out.

    Raises:
        LogError: If no trial has a known error.
    """
    batches: list[BatchErrors] = []
    for name, trials in by_folder(logs).items():
        errors = [(log.log, log.result.total_error) for log in trials if log.result is not None]
        finite = [(path, error) for path, error in errors if math.isfinite(error)]
        totals = np.array([error for _, error in finite])
        paths = [path for path, _ in finite]
        batches.append(BatchErrors(name, totals, paths, trials[0].experiment.directions_given))
    return _drawn(batches, logs[0].experiment, {}, narrow=False)


def batch_figure(
    groups: Sequence[BatchStatistics],
    links: Mapping[str, str] | None = None,
    narrow: bool = False,
) -> Figure:
    """Draw the total errors of every batch, one dot for each trial that counts.

    Args:
        groups: The batches.
        links: For the path of a trial, the address that its dot links to in an SVG. None for no
            links.
        narrow: Whether one panel is above the other.
    """
    batches: list[BatchErrors] = []
    for group in groups:
        paths = [trial.log for trial in group.batch.trials if counts(trial)]
        no_controller = group.experiment.directions_given
        batches.append(BatchErrors(group.name, group.totals, paths, no_controller))
    figure = _drawn(batches, groups[0].experiment, links or {}, narrow)
    drawn = [group for group in groups if group.counted]
    plants = sorted({group.origin.value for group in drawn})
    if len(plants) > 1:
        plants = [f"{group.name}: {group.origin.value}" for group in drawn]
    style.headline(figure, "; ".join(plants))
    return figure


@style.styled()
def _drawn(
    batches: Sequence[BatchErrors], experiment: Experiment, links: Mapping[str, str], narrow: bool
) -> Figure:
    """Draw those batches that have at least one error.

    Raises:
        LogError: If no batch has one.
    """
    drawn = [batch for batch in batches if len(batch.totals)]
    if not drawn:
        raise LogError("there is no complete trial to plot")
    if narrow:
        figure = style.figure(NARROW_IN, 6.0)
        dots, distributions_panel = figure.subplots(2, 1)
        dots_width_in = 0.8 * NARROW_IN
    else:
        figure = style.figure(style.PAGE_IN, 3.0)
        dots, distributions_panel = figure.subplots(1, 2, width_ratios=[1, 1.1])
        dots_width_in = 0.4 * style.PAGE_IN
    error = f"total error [{unit_of(experiment.units.length)}]"
    style.panel(dots, "a", "each trial, and the mean", y=error)
    style.panel(distributions_panel, "b", "fraction of trials with at most an error", error)
    totals = np.concatenate([batch.totals for batch in drawn])
    reference = experiment.reference
    if reference is not None:
        totals = np.append(totals, reference.mean)
    is_logarithmic = spans_orders(totals)
    labels = _categories(dots, drawn, links)
    if reference is not None:
        published = published_distribution(reference.n, reference.mean, reference.std)
        _mean(dots, len(labels), published, style.GREY)
        totals = np.append(totals, reference.mean + reference.std)
        labels.append(f"published\nn = {reference.n}")
    name_categories(dots, labels, dots_width_in)
    _distributions(distributions_panel, drawn)
    if is_logarithmic:
        log_axis(dots, totals, ROOM, ROOM)
        _share_log_axis(distributions_panel, dots)
    else:
        dots.set_ylim(bottom=0)
    style.grid_of_heights(dots)
    curves, _ = distributions_panel.get_legend_handles_labels()
    _legend(figure, curves if len(drawn) > 1 else [], 2 if narrow else 4)
    return figure


def _share_log_axis(panel: Axes, dots: Axes) -> None:
    """Make the x axis of the distributions logarithmic, with the ticks of the dots' y axis.

    Only the ticks in the range of both axes are taken, and the x axis starts where the y axis does.
    """
    panel.set_xscale("log")
    low, _ = dots.get_ylim()
    _, end = panel.get_xlim()
    ticks = [tick for tick in dots.get_yticks() if low <= tick <= end]
    panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.set_xticks([], minor=True)
    panel.set_xlim(left=low)


def _legend(figure: Figure, curves: Sequence[Artist], columns: int) -> None:
    """Add a legend that explains the signs of both panels.

    `curves` are the batches' curves; they are listed after the signs in `columns` columns.
    """
    signs = [
        style.sign("one trial", marker="o", ms=4, alpha=0.7),
        style.sign("mean and its 95 % interval", ls="-", lw=4, marker="o", mfc="white"),
        style.sign("standard deviation", ls="-", lw=1),
        Patch(color=style.GREY, alpha=0.3, lw=0, label="95 % band of a whole curve"),
    ]
    style.legend(figure, [*signs, *curves], columns)


def _categories(axes: Axes, batches: Sequence[BatchErrors], links: Mapping[str, str]) -> list[str]:
    """Draw the errors of each batch at its place on the x axis. Return the places' labels.

    Values are drawn to the left of the place, and their mean to the right.
    """
    labels: list[str] = []
    for place, batch in enumerate(batches):
        color = style.batch_look(place)["color"]
        _dots(axes, place - DOTS_ASIDE, batch, color, links)
        distribution = distributions(batch.totals[None])[0]
        _mean(axes, place + MEAN_ASIDE, distribution, color)
        name = batch.name if len(batches) > 1 else "this batch"
        labels.append(f"{name}\n{batch.label}")
    return labels


def _dots(
    axes: Axes,
    place: float,
    batch: BatchErrors,
    color: str,
    links: Mapping[str, str],
) -> None:
    """Draw a dot for each trial around a place on the x axis, and link it to its trial if possible.

    Dots of similar errors stand apart.
    """
    rank = np.argsort(np.argsort(batch.totals, kind="stable"))
    dots = axes.scatter(
        place + DOTS_WIDTH * (rank * GOLDEN % 1 - 0.5),
        batch.totals,
        s=DOT_PT2 if len(batch.totals) <= MANY else SMALL_DOT_PT2,
        color=color,
        linewidths=0,
        alpha=0.55,
        clip_on=False,
        gid="trials",
    )
    addresses = [links.get(path) for path in batch.paths]
    if any(addresses):
        dots.set_urls(addresses)


def _mean(axes: Axes, place: float, errors: Distribution, color: str) -> None:
    """Draw the mean of errors, with two vertical lines around it.

    The thin line is +- one standard deviation, the thick line the mean's 95 % interval.
    """
    mean = errors.mean
    interval = errors.ci95
    if math.isfinite(errors.std):
        lowest = max(mean - errors.std, 0)
        axes.vlines(place, lowest, mean + errors.std, color, linewidth=1)
    if interval.known:
        axes.vlines(place, max(interval.low, 0), interval.high, color, linewidth=4)
    axes.plot(
        place,
        mean,
        "o",
        color="white",
        markeredgecolor=color,
        markersize=5,
        zorder=4,
        clip_on=False,
    )


def band(n: int) -> float:
    """Return half the height of the 95 % confidence band for n values, as a fraction of all trials.

    The band holds for the whole distribution at once (Dvoretzky, Kiefer and Wolfowitz).
    """
    return math.sqrt(math.log(2 / (1 - CONFIDENCE)) / (2 * n))


def _distributions(axes: Axes, batches: Sequence[BatchErrors]) -> None:
    """Draw the empirical distribution function of each batch's total errors.

    Its confidence band is left out if there are more than SHADED batches, or too few trials for
    it.
    """
    end = BEYOND * max(float(batch.totals.max()) for batch in batches)
    for number, batch in enumerate(batches):
        look = style.batch_look(number)
        n = len(batch.totals)
        x = np.concatenate([[0.0], np.sort(batch.totals), [end]])
        share = np.append(np.arange(n + 1), n) / n
        half = band(n)
        if len(batches) <= SHADED and half < 1:
            low = np.clip(share - half, 0, 1)
            high = np.clip(share + half, 0, 1)
            axes.fill_between(x, low, high, step="post", color=look["color"], alpha=0.18, lw=0)
        axes.step(x, share, where="post", lw=1.3, label=batch.name, gid="share", **look)
    axes.set(xlim=(0, end or 1.0), ylim=(0, BEYOND))
