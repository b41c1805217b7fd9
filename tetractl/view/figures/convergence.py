"""Draws the best cost that searches found, over their iterations (the paper's Figure 3)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tetractl.core.errors import format_unit
from tetractl.core.plan import Search
from tetractl.core.trial import Step
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import positive, set_log_axis
from tetractl.view.figures.trials import one_trial, require_steps

HEIGHT_IN = 2.75
"""Height of the figure [in]."""
NOTE_BELOW_PT = 9
"""Distance of the note below the end of the search [pt]."""
RANGE_MARGINS = (0.22, 0.05)
"""Room below and above the curves, as fractions of their range: for the note."""
LEGEND_PLACEMENT = {"loc": "lower right", "bbox_to_anchor": (1.02, 0.985), "borderaxespad": 0.3}
"""Place of the legend next to the title."""


@style.styled()
def convergence_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the best cost over the iterations of each search at the first control step.

    This is J(u_gb) in the paper's Figure 3.
    """
    log = one_trial(logs)
    require_steps(log)
    step = log.steps[0]
    figure = style.figure(style.COLUMN_IN, HEIGHT_IN)
    axes = figure.subplots()
    _draw_searches(axes, step)
    axes.set_title(f"control step {step.k}", loc="left")
    axes.set(xlabel="iteration z", ylabel=f"$J(u_{{gb}})$ [{format_unit(log.start.setup.unit)}]")
    return figure


def _draw_searches(axes: Axes, step: Step) -> None:
    """Draw the costs of a control step's searches, the chosen one in front.

    A note marks where the chosen search stopped.
    """
    chosen = step.plan.search
    other_searches = [search for search in step.plan.searches if search is not chosen]
    for search in other_searches:
        axes.plot(positive(search.history), color=style.FAINT, lw=0.6, zorder=1)
    axes.plot(positive(chosen.history), "*-", color=style.WHOLE, ms=4, mew=0, lw=1.0, zorder=3)
    _mark_stop(axes, chosen, max(len(search.history) for search in step.plan.searches) - 1)
    histories = [positive(search.history) for search in step.plan.searches]
    set_log_axis(axes, np.concatenate(histories), *RANGE_MARGINS)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    signs = [style.sign("chosen", color=style.WHOLE, ls="-", marker="*", ms=5, mew=0)]
    n_others = len(step.plan.searches) - 1
    if n_others:
        signs.append(style.sign(f"{n_others} other horizons", color=style.FAINT, ls="-"))
    axes.legend(handles=signs, ncols=2, **LEGEND_PLACEMENT)


def _mark_stop(axes: Axes, search: Search, iterations_max: int) -> None:
    """Mark the end of a search, with a note on the side where there is space.

    `longest` is the number of iterations of the longest search.
    """
    iteration = len(search.history) - 1
    end_point = (iteration, positive(search.history)[-1])
    axes.plot(*end_point, "o", ms=8, mfc="none", mec=style.INK, mew=1.2, zorder=4)
    axes.annotate(
        f"{search.length} signals: stopped\nat iteration {iteration} ({search.stopped})",
        end_point,
        (0, -NOTE_BELOW_PT),
        textcoords="offset points",
        ha="right" if iteration > iterations_max / 2 else "left",
        va="top",
        fontsize=style.NOTE_PT,
        color=style.INK,
    )
