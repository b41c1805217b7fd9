"""Figures of the optimiser: the best cost over the iterations (the paper's Figure 3), and the solve
times next to the control period.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tetractl.core.clock import MILLISECOND
from tetractl.core.colors import BLUE, RED
from tetractl.core.errors import unit_of
from tetractl.core.poses import Floats
from tetractl.core.trial import Step
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import (
    log_axis,
    need_steps,
    one_trial,
    positive,
    separated,
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
    axes.plot(history, "*-", color=BLUE, ms=4, mew=0, lw=1.0, zorder=3)
    last = len(history) - 1
    axes.plot(last, history[-1], "o", ms=8, mfc="none", mec=RED, mew=1.2, zorder=4)
    longest = max(len(search.history) for search in searches) - 1
    side = "right" if last > longest / 2 else "left"
    note = f"{best.length} signals: stopped\nat iteration {last} ({best.stopped})"
    axes.annotate(
        note, (last, history[-1]), (0, -9), textcoords="offset points", ha=side, va="top",
        fontsize=6.5, color=RED,
    )  # fmt: skip
    log_axis(axes, np.concatenate([positive(search.history) for search in searches]), 0.22, 0.05)
    whole_ticks(axes)
    signs = [style.sign("chosen", color=BLUE, ls="-", marker="*", ms=5, mew=0)]
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
    axes.plot(k, end, ".-", color=BLUE, ms=4, lw=0.8, label="at the stop")
    log_axis(axes, np.concatenate([begin, end]), 0.06, 0.25)
    axes.legend(loc="upper right", ncols=2)


def _iterations(axes: Axes, steps: Sequence[Step], most: int) -> None:
    done = [len(step.plan.search.history) - 1 for step in steps]
    axes.bar([step.k for step in steps], done, width=0.8, color=BLUE, alpha=0.55)
    if max(done) <= most:  # otherwise the limit holds for each of several starts
        limit = axes.axhline(most, color=style.GREY, lw=0.6, ls="--", label=f"most: {most}")
        axes.legend(handles=[limit], loc="upper right", borderaxespad=0.1)
    axes.set(ylim=(0, max(most, *done) * 1.5), xlabel="control step k", ylabel="iterations")
    whole_ticks(axes)


@style.styled()
def timing_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the solve times over the control steps, next to the control period, and their
    histogram.
    """
    log = one_trial(logs)
    need_steps(log)
    period_ms = 1e3 * log.start.setup.period_s
    solve_ms = np.array([step.solve_ns for step in log.steps]) / MILLISECOND
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    k = np.array([step.k for step in log.steps])
    figure = style.figure(style.PAGE_IN, 2.7)
    by_step, shares = figure.subplots(1, 2, width_ratios=[1.7, 1], sharey=True)
    by_step.plot(k, solve_ms, color=style.FAINT, lw=0.8, zorder=1)
    by_step.plot(k[~late], solve_ms[~late], ".", color=BLUE, ms=5, label="in time")
    if late.any():
        by_step.plot(k[late], solve_ms[late], "v", color=style.ALARM, ms=4.5, label="too late")
    for axes in (by_step, shares):
        label = f"deadline: control period {period_ms:g} ms"
        axes.axhline(period_ms, color=RED, lw=0.9, ls="--", label=label)
    log_axis(by_step, np.append(positive(solve_ms), period_ms), 0.08, 0.1)
    whole_ticks(by_step)
    missed = f"{late.sum()} of {len(late)} deadlines missed"
    style.panel(by_step, "a", missed, "control step k", "solve time [ms]")
    small: dict[str, Any] = {"va": "center", "fontsize": 6.5}
    if not late[0] and solve_ms[0] > period_ms:
        first = (k[0], solve_ms[0])
        by_step.annotate("first plan", first, (6, 0), textcoords="offset points", **small)
    _histogram(shares, solve_ms, period_ms, small)
    style.legend(figure, by_step.get_legend_handles_labels()[0])
    return figure


def _histogram(axes: Axes, solve_ms: Floats, period_ms: float, small: dict[str, Any]) -> None:
    """Draw a histogram of the solve times, and mark two percentiles."""
    low, high = axes.get_ylim()
    late = solve_ms > period_ms
    axes.hist(
        [solve_ms[~late], solve_ms[late]], bins=np.geomspace(low, high, 41).tolist(), alpha=0.6,
        stacked=True, color=[BLUE, style.ALARM], orientation="horizontal",
    )  # fmt: skip
    most = axes.get_xlim()[1]
    axes.set_xlim(0, 1.45 * most)
    marked = {q: float(np.percentile(solve_ms, q, method="inverted_cdf")) for q in (50, 99)}
    heights = separated(np.log(np.array([*marked.values()]) / low) / math.log(high / low), 0.06)
    for (q, value), height in zip(marked.items(), heights, strict=True):
        axes.plot([0, 1.04 * most], [value, value], color=style.INK, lw=0.6, zorder=3)
        text = f"p{q} {value:.3g} ms"
        axes.text(0.98, float(height), text, transform=axes.transAxes, ha="right", **small)
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    style.panel(axes, "b", "histogram", "control steps")
