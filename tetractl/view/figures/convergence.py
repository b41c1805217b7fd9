"""Figures of the optimiser: the best cost over the iterations (the paper's Figure 3), and the solve
times next to the control period.
"""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from tetractl.core.clock import MILLISECOND
from tetractl.core.colors import BLUE, RED
from tetractl.core.errors import unit_of
from tetractl.core.poses import Floats
from tetractl.core.trial import Step
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import (
    need_steps,
    one_trial,
    plain_log,
    positive,
    span,
)
from tetractl.view.figures.labels import separated


def convergence_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the best cost J(u_gb) over the iterations at step 0 (the paper's Figure 3), and by how
    much and in how many iterations the search of each step lowered it.
    """
    log = one_trial(logs)
    need_steps(log)
    unit = unit_of(log.start.setup.unit)
    with style.styled():
        figure = style.figure(style.PAGE_IN, 2.75)
        grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1], height_ratios=[1.6, 1])
        first = figure.add_subplot(grid[:, 0])
        gain = figure.add_subplot(grid[0, 1])
        count = figure.add_subplot(grid[1, 1], sharex=gain)
        _first_plan(first, log.steps[0], unit)
        _later_plans(gain, log.steps, unit)
        _iterations(count, log.steps, log.start.setup.iterations_max)
        gain.tick_params(labelbottom=False)
    return figure


def _first_plan(axes: Axes, step: Step, unit: str) -> None:
    for search in step.plan.searches:
        if search is not step.plan.search:
            axes.plot(positive(search.history), color=style.FAINT, lw=0.6, zorder=1)
    best = step.plan.search
    history = positive(best.history)
    axes.plot(history, "*-", color=BLUE, ms=4, mew=0, lw=1.0, zorder=3)
    last = len(history) - 1
    axes.plot(last, history[-1], "o", ms=8, mfc="none", mec=RED, mew=1.2, zorder=4)
    longest = max(len(search.history) for search in step.plan.searches) - 1
    side = "right" if last > longest / 2 else "left"
    note = f"{best.length} signals: stopped\nat iteration {last} ({best.stopped})"
    axes.annotate(
        note, (last, history[-1]), (0, -9), textcoords="offset points", ha=side, va="top",
        fontsize=6.5, color=RED,
    )  # fmt: skip
    axes.set_yscale("log")
    finite = np.concatenate([positive(search.history) for search in step.plan.searches])
    low, high = span(finite)
    axes.set_ylim(low * (low / high) ** 0.22, high * (high / low) ** 0.05)
    plain_log(axes)
    axes.set_xlabel("iteration z")
    axes.set_ylabel(f"$J(u_{{gb}})$ [{unit}]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    others = len(step.plan.searches) - 1
    style.panel(axes, "a", f"control step {step.k}")
    axes.legend(
        handles=[
            Line2D([], [], color=BLUE, marker="*", ms=5, mew=0, label="chosen"),
            *(
                [Line2D([], [], color=style.FAINT, label=f"{others} other horizons")]
                if others
                else []
            ),
        ],
        loc="lower right",
        bbox_to_anchor=(1.02, 0.985),
        ncols=2,
        borderaxespad=0.3,
    )


def _later_plans(axes: Axes, steps: Sequence[Step], unit: str) -> None:
    k = np.array([step.k for step in steps])
    begin = positive(np.array([step.plan.search.history[0] for step in steps]))
    end = positive(np.array([step.plan.search.history[-1] for step in steps]))
    axes.vlines(k, end, begin, color=style.FAINT, lw=1.6)
    axes.plot(k, begin, "_", color=style.GREY, ms=4, mew=1.0, label="before")
    axes.plot(k, end, ".-", color=BLUE, ms=4, lw=0.8, label="at the stop")
    axes.set_yscale("log")
    low, high = span(np.concatenate([begin, end]))
    axes.set_ylim(low / (high / low) ** 0.06, high * (high / low) ** 0.25)
    plain_log(axes)
    axes.set_ylabel(f"$J(u_{{gb}})$ [{unit}]")
    axes.legend(loc="upper right", ncols=2)
    style.panel(axes, "b", "chosen search of each control step")


def _iterations(axes: Axes, steps: Sequence[Step], most: int) -> None:
    done = [len(step.plan.search.history) - 1 for step in steps]
    axes.bar([step.k for step in steps], done, width=0.8, color=BLUE, alpha=0.55)
    if max(done) <= most:  # otherwise the limit holds for each of several starts
        limit = axes.axhline(most, color=style.GREY, lw=0.6, ls="--", label=f"most: {most}")
        axes.legend(handles=[limit], loc="upper right", borderaxespad=0.1)
    axes.set_ylim(0, max(most, *done) * 1.5)
    axes.set_ylabel("iterations")
    axes.set_xlabel("control step k")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))


BINS = 40
PERCENTILES = (50, 99)


def timing_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the solve times over the control steps, next to the control period, and their
    histogram.
    """
    log = one_trial(logs)
    need_steps(log)
    period_ms = 1e3 * log.start.setup.period_s
    solve_ms = np.array([step.solve_ns for step in log.steps]) / MILLISECOND
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    with style.styled():
        figure = style.figure(style.PAGE_IN, 2.7)
        by_step, shares = figure.subplots(1, 2, width_ratios=[1.7, 1], sharey=True)
        k = np.array([step.k for step in log.steps])
        by_step.plot(k, solve_ms, color=style.FAINT, lw=0.8, zorder=1)
        by_step.plot(k[~late], solve_ms[~late], ".", color=BLUE, ms=5, label="in time")
        if late.any():
            by_step.plot(k[late], solve_ms[late], "v", color=style.ALARM, ms=4.5, label="too late")
        for axes in (by_step, shares):
            label = f"deadline: control period {period_ms:g} ms"
            axes.axhline(period_ms, color=RED, lw=0.9, ls="--", label=label)
        by_step.set_yscale("log")
        low, high = span(np.append(positive(solve_ms), period_ms))
        by_step.set_ylim(low / (high / low) ** 0.08, high * (high / low) ** 0.1)
        plain_log(by_step)
        by_step.set_xlabel("control step k")
        by_step.set_ylabel("solve time [ms]")
        by_step.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
        words = f"{late.sum()} of {len(late)} deadlines missed"
        style.panel(by_step, "a", words)
        if not late[0] and solve_ms[0] > period_ms:
            by_step.annotate(
                "first plan", (k[0], solve_ms[0]), (6, 0), textcoords="offset points",
                va="center", fontsize=6.5,
            )  # fmt: skip
        _distribution(shares, solve_ms, period_ms)
        figure.legend(*by_step.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _distribution(axes: Axes, solve_ms: Floats, period_ms: float) -> None:
    """Draw a histogram of the solve times, and mark two percentiles."""
    low, high = axes.get_ylim()
    edges = np.geomspace(low, high, BINS + 1)
    late = solve_ms > period_ms
    axes.hist(
        [solve_ms[~late], solve_ms[late]], bins=edges.tolist(), stacked=True, alpha=0.6,
        color=[BLUE, style.ALARM], orientation="horizontal",
    )  # fmt: skip
    most = axes.get_xlim()[1]
    axes.set_xlim(0, 1.45 * most)
    places = [float(np.percentile(solve_ms, q, method="inverted_cdf")) for q in PERCENTILES]
    texts = [f"p{q} {value:.3g} ms" for q, value in zip(PERCENTILES, places, strict=True)]
    heights = np.log(np.array(places) / low) / math.log(high / low)
    for text, value, height in zip(texts, places, separated(heights, 0.06), strict=True):
        axes.plot([0, 1.04 * most], [value, value], color=style.INK, lw=0.6, zorder=3)
        axes.annotate(
            text, (1.04 * most, value), (0.98, float(height)), textcoords="axes fraction",
            ha="right", va="center", fontsize=6.5,
        )  # fmt: skip
    axes.set_xlabel("control steps")
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    style.panel(axes, "b", "histogram")
