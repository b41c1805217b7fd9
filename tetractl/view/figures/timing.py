"""The solve times of the control steps of a trial, against the control period."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tetractl.core.clock import MILLISECOND
from tetractl.core.colors import BLUE, RED
from tetractl.core.poses import Floats
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

BINS = 40
PERCENTILES = (50, 99)


def timing_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the solve time of each control step, the control period and a histogram."""
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
    """Draw how many steps took how long, and mark two percentiles."""
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
