"""What the controller estimated of the robots over the time of a trial."""

import json
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats
from tetractl.core.text import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import (
    NUMBERED,
    one_trial,
    robot_labels,
)
from tetractl.view.figures.labels import end_labels

TO_MS = SECOND / MILLISECOND
LINE_IN = 0.1  # height of a robot's label


def estimate_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the estimates of a trial over time, each with a band of one standard deviation.

    a and speed are drawn relative to the spec's values, on one scale for all robots, and a cross
    marks the true value of a simulation; the heading bias in rad, the dead time in ms. A panel is
    only drawn for what was estimated, and no bands where the robots are many.
    """
    log = one_trial(logs)
    steps = [step for step in log.steps if step.plan.estimate is not None]
    known = [step.plan.estimate for step in steps if step.plan.estimate is not None]
    if not known:
        raise LogError(
            f"{log.path}: holds no estimates to plot",
            "the controller estimates with --set controller.estimate=true",
        )
    setup = log.start.setup
    time_s = np.array([log.elapsed_s(step.command.sent_ns) for step in steps])
    biased, delayed = known[-1].heading_bias is not None, known[-1].dead_time is not None
    with style.styled():
        rows = 1 + (biased or delayed)
        row_in = max(2.3, 0.7 + LINE_IN * len(setup.names))
        figure = style.figure(style.PAGE_IN, rows * row_in)
        grid = figure.subplots(rows, 2, squeeze=False, sharex=True)
        panels = [*grid.ravel()]
        _relative(panels[0], "a", time_s, log, known)
        _relative(panels[1], "speed", time_s, log, known)
        if biased:
            values = _stack(known, "heading_bias"), _stack(known, "heading_bias_std")
            panels[2].set_ylabel("heading bias [rad]")
            _curves(panels[2], time_s, *values, log)
        if delayed:
            _dead_time(panels[2 + biased], time_s, known)
        for spare in panels[2 + biased + delayed :]:
            spare.set_axis_off()
        unit = unit_of(setup.unit)
        titles = ["turning rate a, at the end in rad/s", f"speed, at the end in {unit}/s"]
        titles += ["heading bias"] * biased + ["dead time"] * delayed
        for axes, letter, title in zip(panels, "abcd", titles, strict=False):
            style.panel(axes, letter, title)
            axes.set_xlabel("time since the first command [s]")
            axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
        figure.legend(handles=_key(log), loc="outside lower center", ncols=3)
        names = robot_labels(setup.names)
        for axes, values in ((panels[0], known[-1].a), (panels[1], known[-1].speed)):
            texts = [f"{name} {value:.3g}" for name, value in zip(names, values, strict=True)]
            _name(axes, texts, log)
        if biased:
            _name(panels[2], names, log)
    return figure


def _relative(
    axes: Axes, what: str, time_s: Floats, log: TrialLog, known: Sequence[Estimate]
) -> None:
    """Draw a or speed as its difference from the spec's value [%]."""
    spec = getattr(log.start.setup, what)
    percent = 100 / spec
    values, stds = _stack(known, what), _stack(known, f"{what}_std")
    axes.axhline(0, color=style.GREY, lw=0.6)
    axes.set_ylabel("difference from the spec [%]")
    _curves(axes, time_s, (values - spec) * percent, stds * percent, log)
    if (true := _true(log, what)) is None:
        return
    true = (true - spec) * percent
    for value, color in zip(true, _colors(log), strict=True):
        axes.plot(
            1, value, "x", color=color, ms=4, mew=1.0, clip_on=False, zorder=5,
            transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, true.min() - 1), max(high, true.max() + 1))


def _true(log: TrialLog, what: str) -> Floats | None:
    """Return the true a or speed (N,) of a simulation, None where the log does not state it."""
    fact = log.start.plant.facts.get(f"true_{what}")
    return None if fact is None else np.array(json.loads(fact), dtype=np.float64)


def _curves(axes: Axes, time_s: Floats, values: Floats, stds: Floats, log: TrialLog) -> None:
    """Draw values (K, N) with their bands.

    The axis shows what lies between the 1st and the 99th percentile: one wild value would squash
    the rest.
    """
    banded = values.shape[1] < NUMBERED
    for robot, color in enumerate(_colors(log)):
        value, std = values[:, robot], stds[:, robot]
        if banded:
            axes.fill_between(time_s, value - std, value + std, color=color, alpha=0.15, lw=0)
        axes.plot(time_s, value, color=color, lw=1.1, gid=f"robot-{robot}")
    spread = stds if banded else np.zeros_like(stds)
    shown = np.percentile(np.concatenate([values - spread, values + spread]), [1, 99])
    low, high = min(shown[0], values[-1].min()), max(shown[1], values[-1].max())
    room = max(0.08 * (high - low), 1e-6)
    axes.set_ylim(low - room, high + room)


def _dead_time(axes: Axes, time_s: Floats, known: Sequence[Estimate]) -> None:
    value, std = (TO_MS * _stack(known, name) for name in ("dead_time", "dead_time_std"))
    axes.fill_between(time_s, value - std, value + std, color=style.INK, alpha=0.15, lw=0)
    axes.plot(time_s, value, color=style.INK, lw=1.2)
    axes.set_ylabel("dead time [ms]")


def _name(axes: Axes, texts: Sequence[str], log: TrialLog) -> None:
    """Name the robots' curves at their ends."""
    curves = [line for line in axes.get_lines() if str(line.get_gid()).startswith("robot-")]
    ends = [float(np.asarray(line.get_ydata())[-1]) for line in curves]
    end_labels(axes, ends, texts, _colors(log))


def _key(log: TrialLog) -> list[Line2D | Patch]:
    """Return the signs of the legend."""
    signs: list[Line2D | Patch] = []
    if len(log.start.setup.names) < NUMBERED:
        signs.append(Patch(color=style.GREY, alpha=0.3, lw=0, label="one standard deviation"))
    if _true(log, "a") is not None:
        look = {"marker": "x", "markersize": 4.0, "linestyle": "none", "color": style.GREY}
        signs.append(Line2D([], [], label="true value", **look))
    return signs


def _stack(known: Sequence[Estimate], name: str) -> Floats:
    return np.array([getattr(estimate, name) for estimate in known], dtype=np.float64)


def _colors(log: TrialLog) -> list[str]:
    setup = log.start.setup
    return robot_colors(setup.names, setup.colors)
