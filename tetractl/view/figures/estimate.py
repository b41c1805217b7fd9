"""The figure of the controller's estimates of each robot's values, and of the dead time, over a
trial.
"""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import LogError, unit_of
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.read.validate import LENGTH_MAX
from tetractl.view import style
from tetractl.view.figures.axes import NUMBERED, one_trial
from tetractl.view.figures.curves import (
    LINE_IN,
    SINCE,
    Curve,
    draw_curves,
    name_curves,
    robot_curves,
)

TO_MS = SECOND / MILLISECOND


def estimate_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the estimates of a trial over time, each with a band of +- one standard deviation.

    Each estimated quantity has a panel: turning rate a and speed as differences from the spec's
    values [%], with a cross at a simulation's true value; the heading bias [rad]; the dead time
    [ms]. NUMBERED or more robots have no bands.
    """
    log = one_trial(logs)
    steps = [step for step in log.steps if step.plan.estimate is not None]
    known = [step.plan.estimate for step in steps if step.plan.estimate is not None]
    if not known:
        raise LogError(
            f"{log.path}: contains no estimates to plot",
            "run the trial with --set controller.estimate=true",
        )
    setup = log.start.setup
    unit = unit_of(setup.unit)
    time_s = np.array([log.elapsed_s(step.command.sent_ns) for step in steps])
    shown = [(_relative, "a", "turning rate a, at the end in rad/s")]
    shown += [(_relative, "speed", f"speed, at the end in {unit}/s")]
    shown += [(_bias, "heading_bias", "heading bias")] * (known[-1].heading_bias is not None)
    shown += [(_dead_time, "dead_time", "dead time")] * (known[-1].dead_time is not None)
    with style.styled():
        rows = -(-len(shown) // 2)
        row_in = max(2.3, 0.7 + LINE_IN * len(setup.names))
        figure = style.figure(style.PAGE_IN, rows * row_in)
        panels = [*figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()]
        for spare in panels[len(shown) :]:
            spare.set_axis_off()
        named: list[tuple[Axes, list[Curve]]] = []
        for axes, letter, (draw, what, title) in zip(panels, "abcd", shown, strict=False):
            style.panel(axes, letter, title)
            axes.set_xlabel(SINCE)
            axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
            values, stds = _stack(known, what), _stack(known, f"{what}_std")
            named.append((axes, draw(axes, what, time_s, values, stds, log)))
        figure.legend(handles=_key(log), loc="outside lower center", ncols=3)
        for axes, curves in named:
            if curves:
                name_curves(axes, curves)
    return figure


def _relative(
    axes: Axes, what: str, time_s: Floats, values: Floats, stds: Floats, log: TrialLog
) -> list[Curve]:
    """Draw the difference of turning rate a or speed from the spec's value [%]; labels state the
    last values.
    """
    spec = getattr(log.start.setup, what)
    percent = 100 / spec
    axes.axhline(0, color=style.GREY, lw=0.6)
    axes.set_ylabel("difference from the spec [%]")
    curves = _robots(axes, time_s, (values - spec) * percent, stds * percent, log)
    if (true := _true(log, what)) is not None:
        true = (true - spec) * percent
        for value, curve in zip(true, curves, strict=True):
            axes.plot(
                1, value, "x", color=curve.color, ms=4, mew=1.0, clip_on=False, zorder=5,
                transform=axes.get_yaxis_transform(),
            )  # fmt: skip
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, true.min() - 1), max(high, true.max() + 1))
    return [
        replace(curve, name=f"{curve.name} {value:.3g}")
        for curve, value in zip(curves, values[-1], strict=True)
    ]


def _bias(
    axes: Axes, what: str, time_s: Floats, values: Floats, stds: Floats, log: TrialLog
) -> list[Curve]:
    axes.set_ylabel("heading bias [rad]")
    return _robots(axes, time_s, values, stds, log)


def _dead_time(
    axes: Axes, what: str, time_s: Floats, values: Floats, stds: Floats, log: TrialLog
) -> list[Curve]:
    low, high = TO_MS * (values - stds), TO_MS * (values + stds)
    draw_curves(axes, time_s, [Curve(TO_MS * values, style.INK, "", what, low, high, width=1.2)])
    axes.set_ylabel("dead time [ms]")
    return []


def _robots(axes: Axes, time_s: Floats, values: Floats, stds: Floats, log: TrialLog) -> list[Curve]:
    """Draw values (K, N) of the robots with their bands, and return the curves.

    The axis shows the range from the 1st to the 99th percentile and every last value, so that one
    outlier does not hide the rest.
    """
    curves = robot_curves(log.start.setup, values, values - stds, values + stds)
    draw_curves(axes, time_s, curves)
    spread = stds if len(curves) < NUMBERED else np.zeros_like(stds)
    shown = np.nanpercentile(np.concatenate([values - spread, values + spread]), [1, 99])
    low, high = min(shown[0], values[-1].min()), max(shown[1], values[-1].max())
    margin = max(0.08 * (high - low), 1e-6)
    axes.set_ylim(low - margin, high + margin)
    return curves


def _true(log: TrialLog, what: str) -> Floats | None:
    """Return the true turning rates or speeds (N,) of a simulation, None if the log lacks them.

    Raises LogError for a fact that no simulation states.
    """
    fact = log.start.plant.facts.get(f"true_{what}")
    if fact is None:
        return None
    with suppress(OverflowError, RecursionError, TypeError, ValueError):
        found = np.array(json.loads(fact), dtype=np.float64)
        if found.shape == log.start.setup.a.shape and (np.abs(found) <= LENGTH_MAX).all():
            return found
    raise LogError(f"{log.path}: the fact true_{what} is not a number for each robot")


def _key(log: TrialLog) -> list[Line2D | Patch]:
    """Return the entries of the legend."""
    signs: list[Line2D | Patch] = []
    if len(log.start.setup.names) < NUMBERED:
        signs.append(Patch(color=style.GREY, alpha=0.3, lw=0, label="one standard deviation"))
    if _true(log, "a") is not None:
        look = {"marker": "x", "markersize": 4.0, "linestyle": "none", "color": style.GREY}
        signs.append(Line2D([], [], label="true value", **look))
    return signs


def _stack(known: Sequence[Estimate], name: str) -> Floats:
    """Return a value of every estimate, NaN where an estimate lacks it."""
    unknown = np.full_like(getattr(known[-1], name), np.nan, dtype=np.float64)
    values = (getattr(estimate, name) for estimate in known)
    return np.array([unknown if value is None else value for value in values], dtype=np.float64)
