"""The figures of one trial over its control steps: convergence (Figure 3), error, timing."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.colors import BLUE, RED, robot_colors
from tetractl.core.errors import LogError, UsageError
from tetractl.core.poses import Floats
from tetractl.core.trial import Step
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.frame import tracked
from tetractl.view import style
from tetractl.view.figures.trajectory import trajectory_figure

LABELLED = 8  # most robots that get a line of the legend each


def convergence_figure(log: TrialLog) -> Figure:
    """Draw J(u_gb) against the iteration for step 0 (Figure 3), and what later searches gained."""
    _need_steps(log)
    unit = style.unit_of(log.start.setup.unit)
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
            axes.plot(_positive(search.history), color=style.FAINT, lw=0.6, zorder=1)
    best = step.plan.search
    history = _positive(best.history)
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
    finite = np.concatenate([_positive(search.history) for search in step.plan.searches])
    low, high = _span(finite)
    axes.set_ylim(low * (low / high) ** 0.22, high * (high / low) ** 0.05)
    _plain_log(axes)
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
    begin = _positive(np.array([step.plan.search.history[0] for step in steps]))
    end = _positive(np.array([step.plan.search.history[-1] for step in steps]))
    axes.vlines(k, end, begin, color=style.FAINT, lw=1.6)
    axes.plot(k, begin, "_", color=style.GREY, ms=4, mew=1.0, label="before")
    axes.plot(k, end, ".-", color=BLUE, ms=4, lw=0.8, label="at the stop")
    axes.set_yscale("log")
    low, high = _span(np.concatenate([begin, end]))
    axes.set_ylim(low / (high / low) ** 0.06, high * (high / low) ** 0.25)
    _plain_log(axes)
    axes.set_ylabel(f"$J(u_{{gb}})$ [{unit}]")
    axes.legend(loc="upper right", ncols=2)
    style.panel(axes, "b", "chosen search of each control step")


def _iterations(axes: Axes, steps: Sequence[Step], most: int) -> None:
    done = [len(step.plan.search.history) - 1 for step in steps]
    axes.bar([step.k for step in steps], done, width=0.8, color=BLUE, alpha=0.55)
    axes.axhline(most, color=style.GREY, lw=0.6, ls="--")
    axes.set_ylim(0, most * 1.12)
    axes.set_ylabel("iterations")
    axes.set_xlabel("control step k")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))


def error_figure(log: TrialLog) -> Figure:
    """Draw the total error and each robot's distance to its target over the trial's time."""
    if not len(log.mocap_ns):
        raise LogError(f"{log.path}: holds no camera frames to plot")
    setup = log.start.setup
    unit = style.unit_of(setup.unit)
    time_s = log.mocap_ns / SECOND
    gaps = setup.distances(tracked(log.mocap, log.valid))
    with style.styled():
        figure = style.figure(style.PAGE_IN, 2.6)
        axes = figure.subplots()
        axes.plot(time_s, gaps.sum(axis=1), color=style.INK, lw=1.4, label="total")
        named = len(setup.names) <= LABELLED
        for robot, color in enumerate(robot_colors(setup.names, setup.colors)):
            name = setup.names[robot] if named else None
            axes.plot(time_s, gaps[:, robot], color=color, lw=1.1, label=name)
        if tolerance := log.experiment.controller.arrival_tolerance:
            label = f"arrival within {tolerance:g} {unit}"
            axes.axhline(tolerance, color=style.GREY, lw=0.8, ls="--", label=label)
        sent_s = np.array([step.command.sent_ns for step in log.steps]) / SECOND
        late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
        rug = axes.get_xaxis_transform()
        axes.vlines(
            sent_s, 0, 0.025, color=style.GREY, lw=0.6, transform=rug, label="control steps"
        )
        if late.any():
            axes.plot(
                sent_s[late], np.full(late.sum(), 0.04), "v", color=style.ALARM, ms=4, mew=0,
                transform=rug, label="deadline missed",
            )  # fmt: skip
        axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
        axes.set_ylim(0, float(np.nanmax(gaps.sum(axis=1), initial=1e-9)) * 1.04)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"distance to target [{unit}]")
        _end_total(axes, log, unit)
        figure.legend(loc="outside upper center", ncols=min(len(axes.get_lines()) + 1, 7))
    return figure


def _end_total(axes: Axes, log: TrialLog, unit: str) -> None:
    if log.result is None:
        return
    text = f"{log.result.total_error:.1f} {unit}"
    axes.annotate(
        text, (1, log.result.total_error), (4, 0), xycoords=("axes fraction", "data"),
        textcoords="offset points", va="center", color=style.INK, annotation_clip=False,
    )  # fmt: skip


def timing_figure(log: TrialLog) -> Figure:
    """Draw the time each control step took to solve against the control period."""
    _need_steps(log)
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
        low, high = _span(np.append(_positive(solve_ms), period_ms))
        by_step.set_ylim(low / (high / low) ** 0.08, high * (high / low) ** 0.1)
        _plain_log(by_step)
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


def _need_steps(log: TrialLog) -> None:
    if not log.steps:
        raise LogError(f"{log.path}: holds no control steps to plot")


def _positive(values: Floats) -> Floats:
    """Values that a log scale can show; others become NaN."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def _span(values: Floats) -> tuple[float, float]:
    """Least and largest of positive values, at least 10 % apart."""
    seen = values[np.isfinite(values)]
    if not len(seen):
        return 0.1, 10.0
    low, high = float(seen.min()), float(seen.max())
    return (low, high) if high > 1.1 * low else (low / 1.05, high * 1.05)


def _plain_log(axes: Axes) -> None:
    """Write 100 rather than 10^2, and mark 1, 2 and 5 of each decade where there are few."""
    low, high = axes.get_ylim()
    marks = (1.0, 2.0, 5.0) if high / low < 1000 else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=marks))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


_OF_ONE_TRIAL: dict[str, Callable[[TrialLog], Figure]] = {
    "convergence": convergence_figure,
    "error": error_figure,
    "timing": timing_figure,
}
KINDS = ("trajectory", *_OF_ONE_TRIAL)


def draw(kind: str, logs: Sequence[TrialLog]) -> Figure:
    """Draw the figure of a kind; only trajectories of several trials fit into one."""
    if kind == "trajectory":
        return trajectory_figure(logs)
    if len(logs) > 1:
        raise UsageError(
            f"a {kind} figure shows one trial, not {len(logs)}",
            "give one log, or use --kind trajectory",
        )
    return _OF_ONE_TRIAL[kind](logs[0])
