"""The times of solving of the control steps of a trial, against the control period."""

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


def timing_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the time of solving of each control step, the control period and the distribution."""
    log = one_trial(logs)
    need_steps(log)
    period_ms = 1e3 * log.start.setup.period_s
    solve_ms = np.array([step.solve_ns for step in log.steps]) / MILLISECOND
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    with style.styled():
        figure = style.figure(style.PAGE_IN, 2.5)
        by_step, shares = figure.subplots(1, 2, width_ratios=[1.7, 1], sharey=True)
        k = np.array([step.k for step in log.steps])
        by_step.plot(k, solve_ms, color=style.FAINT, lw=0.8, zorder=1)
        by_step.plot(k[~late], solve_ms[~late], ".", color=BLUE, ms=5, label="in time")
        if late.any():
            by_step.plot(k[late], solve_ms[late], "v", color=style.ALARM, ms=4.5, label="too late")
        for axes in (by_step, shares):
            axes.axhline(period_ms, color=RED, lw=0.9, ls="--")
        by_step.annotate(
            f"control period {period_ms:g} ms", (1, period_ms), (-2, 2), ha="right",
            xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=6.5,
            color=RED,
        )  # fmt: skip
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
        _distribution(shares, solve_ms)
    return figure


def _distribution(axes: Axes, solve_ms: Floats) -> None:
    ordered = np.sort(solve_ms)
    share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
    axes.step(share, ordered, where="pre", color=BLUE, lw=1.2)
    for percent in (50, 99):
        value = float(np.percentile(solve_ms, percent, method="inverted_cdf"))
        axes.plot(percent, value, "o", ms=4, mfc="white", mec=BLUE, zorder=3)
        axes.annotate(
            f"p{percent} {value:.3g} ms", (percent, value), (-5, 4), textcoords="offset points",
            ha="right", va="bottom", fontsize=6.5,
        )  # fmt: skip
    axes.set_xlim(0, 102)
    axes.set_xlabel("share of control steps [%]")
    style.panel(axes, "b", "distribution")
