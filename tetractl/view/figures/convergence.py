"""The figure of the optimiser: the best cost over the iterations (the paper's Figure 3)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tetractl.core.errors import unit_of
from tetractl.core.trial import Step
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import (
    log_axis,
    need_steps,
    one_trial,
    positive,
    whole_ticks,
)


@style.styled()
def convergence_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the best cost J(u_gb) over the iterations at step 0 (the paper's Figure 3), and by how
    much and in how many iterations the search of each step lowered it.
    """
    log = one_trial(logs)
    need_steps(log)
    cost = f"$J(u_{{gb}})$ [{unit_of(log.start.setup.unit)}]"
    figure = style.figure(style.PAGE_IN, 2.75)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1], height_ratios=[1.6, 1])
    first = figure.add_subplot(grid[:, 0])
    gain = figure.add_subplot(grid[0, 1])
    count = figure.add_subplot(grid[1, 1], sharex=gain)
    _first_plan(first, log.steps[0])
    style.panel(first, "a", f"control step {log.steps[0].k}", "iteration z", cost)
    _later_plans(gain, log.steps)
    style.panel(gain, "b", "chosen search of each control step", y=cost)
    gain.tick_params(labelbottom=False)
    _iterations(count, log.steps, log.start.setup.iterations_max)
    return figure


def _first_plan(axes: Axes, step: Step) -> None:
    best, searches = step.plan.search, step.plan.searches
    for search in searches:
        if search is not best:
            axes.plot(positive(search.history), color=style.FAINT, lw=0.6, zorder=1)
    history = positive(best.history)
    axes.plot(history, "*-", color=style.WHOLE, ms=4, mew=0, lw=1.0, zorder=3)
    last = len(history) - 1
    axes.plot(last, history[-1], "o", ms=8, mfc="none", mec=style.INK, mew=1.2, zorder=4)
    longest = max(len(search.history) for search in searches) - 1
    side = "right" if last > longest / 2 else "left"
    note = f"{best.length} signals: stopped\nat iteration {last} ({best.stopped})"
    axes.annotate(
        note, (last, history[-1]), (0, -9), textcoords="offset points", ha=side, va="top",
        fontsize=6.5, color=style.INK,
    )  # fmt: skip
    log_axis(axes, np.concatenate([positive(search.history) for search in searches]), 0.22, 0.05)
    whole_ticks(axes)
    signs = [style.sign("chosen", color=style.WHOLE, ls="-", marker="*", ms=5, mew=0)]
    if others := len(searches) - 1:
        signs.append(style.sign(f"{others} other horizons", color=style.FAINT, ls="-"))
    place = {"loc": "lower right", "bbox_to_anchor": (1.02, 0.985), "borderaxespad": 0.3}
    axes.legend(handles=signs, ncols=2, **place)


def _later_plans(axes: Axes, steps: Sequence[Step]) -> None:
    k = np.array([step.k for step in steps])
    begin = positive(np.array([step.plan.search.history[0] for step in steps]))
    end = positive(np.array([step.plan.search.history[-1] for step in steps]))
    axes.vlines(k, end, begin, color=style.FAINT, lw=1.6)
    axes.plot(k, begin, "_", color=style.GREY, ms=4, mew=1.0, label="before")
    axes.plot(k, end, ".-", color=style.WHOLE, ms=4, lw=0.8, label="at the stop")
    log_axis(axes, np.concatenate([begin, end]), 0.06, 0.25)
    axes.legend(loc="upper right", ncols=2)


def _iterations(axes: Axes, steps: Sequence[Step], most: int) -> None:
    done = [len(step.plan.search.history) - 1 for step in steps]
    axes.bar([step.k for step in steps], done, width=0.8, color=style.WHOLE, alpha=0.55)
    if max(done) <= most:  # otherwise the limit holds for each of several starts
        limit = axes.axhline(most, **style.LIMIT, label=f"most: {most}")
        axes.legend(handles=[limit], loc="upper right", borderaxespad=0.1)
    axes.set(ylim=(0, max(most, *done) * 1.5), xlabel="control step k", ylabel="iterations")
    whole_ticks(axes)
