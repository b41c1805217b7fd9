"""The total errors of batches as empirical distribution functions, each with its 95 % band.

The band is Dvoretzky, Kiefer and Wolfowitz's with Massart's constant (Ann. Probab. 18, 1990): with
the half width sqrt(ln(2 / 0.05) / 2n), it contains the whole true distribution function with at
least 95 % probability.
"""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.colors import PALETTE
from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.results.describe import BatchStatistics
from tetractl.results.estimate import CONFIDENCE
from tetractl.view import style
from tetractl.view.figures.axes import by_folder


def band(n: int) -> float:
    """Return half the height of the band for n values, as a fraction of all trials."""
    return math.sqrt(math.log(2 / (1 - CONFIDENCE)) / (2 * n))


def ecdf_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the final total errors of trials, one curve per folder; only complete trials count."""
    batches = by_folder(logs)
    errors = [
        np.array([log.result.total_error for log in found if log.result is not None])
        for found in batches.values()
    ]
    return _drawn(list(batches), errors, logs[0].start.setup.unit)


def distributions_figure(groups: Sequence[BatchStatistics]) -> Figure:
    """Draw the errors of the counted trials of every batch; a headline names the plants."""
    figure = _drawn(
        [group.name for group in groups], [group.totals for group in groups], groups[0].unit
    )
    style.headline(figure, ", ".join(sorted({group.origin.value for group in groups})))
    return figure


@style.styled()
def _drawn(labels: Sequence[str], errors: Sequence[Floats], unit: str) -> Figure:
    every = zip(labels, errors, strict=True)
    drawn = [(label, np.sort(values)) for label, values in every if len(values)]
    if not drawn:
        raise LogError("no complete trial to plot")
    figure = style.figure(style.PAGE_IN, 3.3)
    axes = figure.subplots()
    end = max(float(values[-1]) for _, values in drawn)
    for i, (label, values) in enumerate(drawn):
        color, n = PALETTE[i % len(PALETTE)], len(values)
        x = np.concatenate([[0.0], values, [1.02 * end]])
        share = np.append(np.arange(n + 1), n) / n
        low, high = np.clip(share - band(n), 0, 1), np.clip(share + band(n), 0, 1)
        if len(drawn) <= 4:
            axes.fill_between(x, low, high, step="post", color=color, alpha=0.15, lw=0)
        else:  # shaded bands would hide one another
            for edge in (low, high):
                axes.step(x, edge, where="post", color=color, lw=0.4, ls=":")
        axes.step(x, share, where="post", color=color, lw=1.3, label=f"{label}, n = {n}")
    axes.set(xlim=(0, 1.02 * end or 1.0), ylim=(0, 1.02))
    axes.set(xlabel=f"total error [{unit_of(unit)}]", ylabel="fraction of trials")
    whole = Patch(color=style.GREY, alpha=0.3, lw=0, label="95 % band of a whole curve")
    style.legend(figure, [*axes.get_legend_handles_labels()[0], whole])
    return figure
