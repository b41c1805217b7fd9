"""Draws the best cost that searches found, over their iterations (the paper's Figure 3)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tetractl.core.errors import unit_of
from tetractl.core.plan import Search
from tetractl.core.trial import Step
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import log_axis, positive
from tetractl.view.figures.trials import need_steps, one_trial

HEIGHT_IN = 2.75
"""Height of the figure [in]."""
NOTE_BELOW_PT = 9
"""Distance of the note below the end of the search [pt]."""
FIRST_ROOM = (0.22, 0.05)
"""Room below and above the curves of the first plan, as fractions of their range: for the note."""
LATER_ROOM = (0.06, 0.06)
"""Room below and above those of later plans."""
LEGEND_ROOM = 1.5
"""Height of the panel of iterations, over the greatest number."""
OVER_PANEL = {"loc": "lower right", "bbox_to_anchor": (1.02, 0.985), "borderaxespad": 0.3}
"""Place of a legend next to the title of its panel."""


@style.styled()
def convergence_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the best cost J(u_gb) over the iterations at step 0 (the paper's Figure 3), and by how
    much and in how many iterations the search of each step lowered it.
    """
    log = one_trial(logs)
    need_steps(log)
    setup = log.start.setup
    cost = f"$J(u_{{gb}})$ [{unit_of(setup.unit)}]"
    figure = style.figure(style.PAGE_IN, HEIGHT_IN)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1], height_ratios=[1.6, 1])
    first = figure.add_subplot(grid[:, 0])
    gain = figure.add_subplot(grid[0, 1])
    count = figure.add_subplot(grid[1, 1], sharex=gain)
    _first_plan(first, log.steps[0])
    style.panel(first, "a", f"control step {log.steps[0].k}", "iteration z", cost)
    _later_plans(gain, log.steps)
    style.panel(gain, "b", "every step", y=cost)
    gain.tick_params(labelbottom=False)
    _iterations(count, log.steps, setup.iterations_max)
    return figure


def _first_plan(axes: Axes, step: Step) -> None:
    """Draw the searches of a step, with the chosen one in front and a note where it stopped."""
    chosen = step.plan.search
    others = [search for search in step.plan.searches if search is not chosen]
    for search in others:
        axes.plot(positive(search.history), color=style.FAINT, lw=0.6, zorder=1)
    axes.plot(positive(chosen.history), "*-", color=style.WHOLE, ms=4, mew=0, lw=1.0, zorder=3)
    _mark_stop(axes, chosen, max(len(search.history) for search in step.plan.searches) - 1)
    histories = [positive(search.history) for search in step.plan.searches]
    log_axis(axes, np.concatenate(histories), *FIRST_ROOM)
    _tick_at_whole_numbers(axes)
    signs = [style.sign("chosen", color=style.WHOLE, ls="-", marker="*", ms=5, mew=0)]
    count = len(step.plan.searches) - 1
    if count:
        signs.append(style.sign(f"{count} other horizons", color=style.FAINT, ls="-"))
    axes.legend(handles=signs, ncols=2, **OVER_PANEL)


def _mark_stop(axes: Axes, search: Search, longest: int) -> None:
    """Mark the end of a search, with a note on the side where there is room; `longest` is the
    number of iterations of the longest one."""
    iteration = len(search.history) - 1
    end = (iteration, positive(search.history)[-1])
    axes.plot(*end, "o", ms=8, mfc="none", mec=style.INK, mew=1.2, zorder=4)
    axes.annotate(
        f"{search.length} signals: stopped\nat iteration {iteration} ({search.stopped})",
        end,
        (0, -NOTE_BELOW_PT),
        textcoords="offset points",
        ha="right" if iteration > longest / 2 else "left",
        va="top",
        fontsize=style.NOTE_PT,
        color=style.INK,
    )


def _later_plans(axes: Axes, steps: Sequence[Step]) -> None:
    """Draw by how much the chosen search of each step lowered the cost."""
    k = np.array([step.k for step in steps])
    begin = positive(np.array([step.plan.search.history[0] for step in steps]))
    end = positive(np.array([step.plan.search.history[-1] for step in steps]))
    axes.vlines(k, end, begin, color=style.FAINT, lw=1.6)
    axes.plot(k, begin, "_", color=style.GREY, ms=4, mew=1.0, label="before")
    axes.plot(k, end, ".-", color=style.WHOLE, ms=4, lw=0.8, label="at the stop")
    log_axis(axes, np.concatenate([begin, end]), *LATER_ROOM)
    axes.legend(ncols=2, **OVER_PANEL)


def _iterations(axes: Axes, steps: Sequence[Step], most: int) -> None:
    """Draw the number of iterations of the chosen search of each step, and the limit."""
    done = [len(step.plan.search.history) - 1 for step in steps]
    k = [step.k for step in steps]
    axes.bar(k, done, width=0.8, color=style.WHOLE, alpha=0.55)
    if max(done) <= most:  # otherwise the limit holds for each of several starts
        limit = axes.axhline(most, **style.LIMIT, label=f"most: {most}")
        axes.legend(handles=[limit], loc="upper right", borderaxespad=0.1)
    top = LEGEND_ROOM * max(most, *done)
    axes.set(ylim=(0, top), xlabel="control step k", ylabel="iterations")
    _tick_at_whole_numbers(axes)


def _tick_at_whole_numbers(axes: Axes) -> None:
    """Place the ticks of the x axis at whole numbers."""
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
