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

from tetractl.core.errors import LogError, format_unit
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
from tetractl.statistics.open_batch import is_counted
from tetractl.statistics.tables import GIVEN_DIRECTIONS
from tetractl.view import style
from tetractl.view.figures.axes import name_categories, needs_log_axis, set_log_axis
from tetractl.view.figures.trials import group_by_folder

DOTS_SHIFT = 0.14
"""Shift of dots to the left of their category's centre [categories]."""
MEAN_SHIFT = 1.4 * DOTS_SHIFT
"""Shift of the mean to the right of its category's centre [categories]."""
DOTS_WIDTH = 0.25
"""Width of a batch's dots [categories]."""
GOLDEN = 0.6180339887
"""The golden ratio minus 1: multiples of it, modulo 1, are far from their neighbours."""
LARGE_DOTS_MAX = 100
"""Number of trials beyond which dots are smaller."""
DOT_PT2 = 16
"""Area of a dot [pt^2]."""
SMALL_DOT_PT2 = 4
"""Area of a dot if there are more than LARGE_DOTS_MAX trials [pt^2]."""
SHADED_MAX = 4
"""Maximum number of batches whose bands are shaded: more would hide one another."""
MARGIN = 0.05
"""Room beyond the errors of a logarithmic axis, as a fraction of their range."""
LIMIT_FACTOR = 1.02
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
        given_directions: Whether the directions were given in the spec, without a controller.
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
    for name, trials in group_by_folder(logs).items():
        errors = [(log.log, log.result.total_error) for log in trials if log.result is not None]
        known_errors = [(path, error) for path, error in errors if math.isfinite(error)]
        totals = np.array([error for _, error in known_errors])
        paths = [path for path, _ in known_errors]
        batches.append(BatchErrors(name, totals, paths, trials[0].experiment.gives_directions))
    return _draw_panels(batches, logs[0].experiment, {}, narrow=False)


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
        paths = [trial.log for trial in group.batch.trials if is_counted(trial)]
        no_controller = group.experiment.gives_directions
        batches.append(BatchErrors(group.name, group.totals, paths, no_controller))
    figure = _draw_panels(batches, groups[0].experiment, links or {}, narrow)
    with_errors = [group for group in groups if group.counted]
    plants = sorted({group.origin.value for group in with_errors})
    if len(plants) > 1:
        plants = [f"{group.name}: {group.origin.value}" for group in with_errors]
    style.headline(figure, "; ".join(plants))
    return figure


@style.styled()
def _draw_panels(
    batches: Sequence[BatchErrors], experiment: Experiment, links: Mapping[str, str], narrow: bool
) -> Figure:
    """Draw the two panels of the figure: the errors of each trial, and the distributions.

    Batches without an error are left out.

    Raises:
        LogError: If no batch has an error.
    """
    with_errors = [batch for batch in batches if len(batch.totals)]
    if not with_errors:
        raise LogError("there is no complete trial to plot")
    if narrow:
        figure = style.figure(NARROW_IN, 6.0)
        dots_panel, distributions_panel = figure.subplots(2, 1)
        dots_width_in = 0.8 * NARROW_IN
    else:
        figure = style.figure(style.PAGE_IN, 3.0)
        dots_panel, distributions_panel = figure.subplots(1, 2, width_ratios=[1, 1.1])
        dots_width_in = 0.4 * style.PAGE_IN
    error_label = f"total error [{format_unit(experiment.units.length)}]"
    style.panel(dots_panel, "a", "each trial, and the mean", y=error_label)
    style.panel(distributions_panel, "b", "fraction of trials with at most an error", error_label)
    totals = np.concatenate([batch.totals for batch in with_errors])
    reference = experiment.reference
    if reference is not None:
        totals = np.append(totals, reference.mean)
    is_logarithmic = needs_log_axis(totals)
    labels = _draw_categories(dots_panel, with_errors, links)
    if reference is not None:
        published = published_distribution(reference.n, reference.mean, reference.std)
        _draw_mean(dots_panel, len(labels), published, style.GREY)
        totals = np.append(totals, reference.mean + reference.std)
        labels.append(f"published\nn = {reference.n}")
    name_categories(dots_panel, labels, dots_width_in)
    _draw_distributions(distributions_panel, with_errors)
    if is_logarithmic:
        set_log_axis(dots_panel, totals, MARGIN, MARGIN)
        _share_log_axis(distributions_panel, dots_panel)
    else:
        dots_panel.set_ylim(bottom=0)
    style.grid_of_heights(dots_panel)
    curves, _ = distributions_panel.get_legend_handles_labels()
    _add_legend(figure, curves if len(with_errors) > 1 else [], 2 if narrow else 4)
    return figure


def _share_log_axis(panel: Axes, dots: Axes) -> None:
    """Make the x axis of the distributions logarithmic, with the ticks of the dots' y axis.

    Ticks outside of the range of either axis are left out. The x axis starts where the y axis does.
    """
    panel.set_xscale("log")
    lower_limit, _ = dots.get_ylim()
    _, upper_limit = panel.get_xlim()
    ticks = [tick for tick in dots.get_yticks() if lower_limit <= tick <= upper_limit]
    panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.set_xticks([], minor=True)
    panel.set_xlim(left=lower_limit)


def _add_legend(figure: Figure, curves: Sequence[Artist], columns: int) -> None:
    """Add a legend that explains the signs of both panels, and then lists the batches' curves.

    Args:
        figure: The figure.
        curves: The curves of the batches.
        columns: Number of columns of the legend.
    """
    signs = [
        style.sign("one trial", marker="o", ms=4, alpha=0.7),
        style.sign("mean and its 95 % interval", ls="-", lw=4, marker="o", mfc="white"),
        style.sign("standard deviation", ls="-", lw=1),
        Patch(color=style.GREY, alpha=0.3, lw=0, label="95 % band of a whole curve"),
    ]
    style.legend(figure, [*signs, *curves], columns)


def _draw_categories(
    axes: Axes, batches: Sequence[BatchErrors], links: Mapping[str, str]
) -> list[str]:
    """Draw the errors of each batch at x = 0, 1 and so on, and return the labels of these places.

    The dots of the trials are drawn to the left of the place, and their mean to the right.
    """
    labels: list[str] = []
    for x, batch in enumerate(batches):
        color = style.batch_look(x)["color"]
        _draw_dots(axes, x - DOTS_SHIFT, batch, color, links)
        distribution = distributions(batch.totals[None])[0]
        _draw_mean(axes, x + MEAN_SHIFT, distribution, color)
        name = batch.name if len(batches) > 1 else "this batch"
        labels.append(f"{name}\n{batch.label}")
    return labels


def _draw_dots(
    axes: Axes,
    x: float,
    batch: BatchErrors,
    color: str,
    links: Mapping[str, str],
) -> None:
    """Draw a dot for each trial around a place on the x axis, and link it to its trial if possible.

    Dots of similar errors stand apart.
    """
    rank = np.argsort(np.argsort(batch.totals, kind="stable"))
    dots = axes.scatter(
        x + DOTS_WIDTH * (rank * GOLDEN % 1 - 0.5),
        batch.totals,
        s=DOT_PT2 if len(batch.totals) <= LARGE_DOTS_MAX else SMALL_DOT_PT2,
        color=color,
        linewidths=0,
        alpha=0.55,
        clip_on=False,
        gid="trials",
    )
    addresses = [links.get(path) for path in batch.paths]
    if any(addresses):
        dots.set_urls(addresses)


def _draw_mean(axes: Axes, x: float, errors: Distribution, color: str) -> None:
    """Draw the mean of errors, with two vertical lines around it.

    The thin line is +- one standard deviation, the thick line the mean's 95 % interval.
    """
    mean = errors.mean
    interval = errors.ci95
    if math.isfinite(errors.std):
        lowest = max(mean - errors.std, 0)
        axes.vlines(x, lowest, mean + errors.std, color, linewidth=1)
    if interval.known:
        axes.vlines(x, max(interval.low, 0), interval.high, color, linewidth=4)
    axes.plot(
        x,
        mean,
        "o",
        color="white",
        markeredgecolor=color,
        markersize=5,
        zorder=4,
        clip_on=False,
    )


def compute_band_half_height(count: int) -> float:
    """Compute half the height of the 95 % confidence band of a distribution function.

    The band holds for the whole function at once (Dvoretzky, Kiefer and Wolfowitz).

    Args:
        count: Number of values.

    Returns:
        Half the height, as a fraction of all trials.
    """
    return math.sqrt(math.log(2 / (1 - CONFIDENCE)) / (2 * count))


def _draw_distributions(axes: Axes, batches: Sequence[BatchErrors]) -> None:
    """Draw the empirical distribution function of each batch's total errors.

    Its confidence band is left out if there are more than SHADED_MAX batches, or too few trials for
    it.
    """
    end_error = LIMIT_FACTOR * max(float(batch.totals.max()) for batch in batches)
    for number, batch in enumerate(batches):
        batch_style = style.batch_look(number)
        n_trials = len(batch.totals)
        x = np.concatenate([[0.0], np.sort(batch.totals), [end_error]])
        fraction = np.append(np.arange(n_trials + 1), n_trials) / n_trials
        half_height = compute_band_half_height(n_trials)
        if len(batches) <= SHADED_MAX and half_height < 1:
            lower_curve = np.clip(fraction - half_height, 0, 1)
            upper_curve = np.clip(fraction + half_height, 0, 1)
            axes.fill_between(
                x,
                lower_curve,
                upper_curve,
                step="post",
                color=batch_style["color"],
                alpha=0.18,
                lw=0,
            )
        axes.step(x, fraction, where="post", lw=1.3, label=batch.name, gid="share", **batch_style)
    axes.set(xlim=(0, end_error or 1.0), ylim=(0, LIMIT_FACTOR))
