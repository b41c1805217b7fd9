"""The figure of one trial over time: directions sent, solve times, and estimates.

The solve time is how long the search for a plan took. The estimates are those of the controller, of
each robot's parameters and of the dead time, the time from a command to its effect.
"""

import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.clock import MILLISECOND
from tetractl.core.errors import LogError, unit_of
from tetractl.core.poses import Floats, wrap
from tetractl.core.setup import Setup
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import log_axis, positive
from tetractl.view.figures.curves import (
    NAME_IN,
    SINCE,
    Curve,
    draw_curves,
    end_s,
    name_curves,
    robot_curves,
)
from tetractl.view.figures.trials import NUMBERED, need_steps, one_trial

PI_TICKS = {
    "ticks": [-np.pi, -np.pi / 2, 0, np.pi / 2, np.pi],
    "labels": ["−π", "−π/2", "0", "π/2", "π"],
}
ROW_IN = 2.0
"""Height of a row of panels [in]. It is larger if names of robots need it."""
ABOVE_NAMES_IN = 0.7
TRUE_MARGIN = 1.0
"""Minimum distance between a true value and the edge of its panel [%]."""
OUTLIERS = (1, 99)
"""Percentiles between which values are shown, so that one outlier does not hide the rest."""


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A quantity that the controller estimated during a trial, as one panel of the figure shows it.

    If the spec also states the quantity, the panel shows the difference from the spec's value, with
    a dotted line at the true value of a simulation.

    Attributes:
        title: Title of its axes.
        label: Label of its axis.
        means: The estimates, for all robots (K,) or for each robot (K, N).
        stds: Their standard deviations.
        factor: Factor from these to what is drawn.
        spec: The spec's values, shape (N,). None if it states none.
        true: The true values, shape (N,). None if they are unknown.
    """

    title: str
    label: str
    means: Floats
    stds: Floats
    factor: Floats | float = 1.0
    spec: Floats | None = None
    true: Floats | None = None


@style.styled()
def over_time_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw one trial over time: the direction sent, the solve times, and the estimates.

    Solve times are shown next to the control period. Each estimated quantity has a panel, with a
    band of +- one standard deviation: turning rate a and speed as differences from the spec's
    values [%], with a dotted line at a simulation's true value; the heading bias [rad]; the dead
    time [ms]. NUMBERED or more robots have no bands.
    """
    log = one_trial(logs)
    need_steps(log)
    time_s = log.steps_s
    estimated = np.array([step.plan.estimate is not None for step in log.steps])
    quantities = _quantities(log) if estimated.any() else []
    row_in = ROW_IN
    if quantities:
        row_in = max(ROW_IN, ABOVE_NAMES_IN + NAME_IN * len(log.start.setup.names))
    panels = 2 + len(quantities)
    rows = math.ceil(panels / 2)
    figure = style.figure(style.PAGE_IN, rows * row_in)
    places = list(figure.subplots(rows, 2, squeeze=False, sharex=True).ravel())
    for spare in places[panels:]:
        spare.set_axis_off()
    places[0].set_xlim(0, end_s(log))
    _draw_signal(places[0], log, time_s)
    _draw_solve_times(places[1], log, time_s)
    for axes, letter, quantity in zip(places[2:], "cdef", quantities, strict=False):
        style.panel(axes, letter, quantity.title, SINCE, quantity.label)
        _draw_estimates(axes, quantity, time_s[estimated], log.start.setup)
    signs: list[Artist] = []
    for axes in places[:panels]:
        handles, _ = axes.get_legend_handles_labels()
        signs += handles
    if quantities and len(log.start.setup.names) < NUMBERED:
        signs.append(Patch(color=style.GREY, alpha=0.3, lw=0, label="one standard deviation"))
    if quantities and _true(log, "a") is not None:
        signs.append(style.sign("true value", ls=":", lw=0.9))
    style.legend(figure, signs, 4)
    return figure


def _draw_signal(axes: Axes, log: TrialLog, time_s: Floats) -> None:
    """Draw the direction sent at each control step, as a line that holds until the next step.

    `time_s` (K,) are the times of the steps. Steps without a direction, in which robots stand
    still, leave a gap.
    """
    style.panel(axes, "a", "direction sent", SINCE, "direction $u$ [rad]")
    sent = np.array([step.command.direction for step in log.steps], dtype=float)
    u = wrap(sent)
    wraps = np.abs(np.diff(u, append=u[-1])) > np.pi
    axes.plot(*_held(time_s, u, wraps), color=style.WHOLE, lw=1.0, gid="direction")
    axes.set_ylim(-1.08 * np.pi, 1.08 * np.pi)
    axes.set_yticks(**PI_TICKS)


def _held(time_s: Floats, values: Floats, breaks: np.ndarray) -> tuple[Floats, Floats]:
    """Return x and y of a line that holds each value until the time of the next one.

    The line is interrupted after a value where `breaks` is True.
    """
    until = np.append(time_s[1:], time_s[-1])
    x = np.column_stack([time_s, until, until])
    y = np.column_stack([values, values, np.where(breaks, np.nan, values)])
    return x.ravel(), y.ravel()


def _draw_solve_times(axes: Axes, log: TrialLog, time_s: Floats) -> None:
    """Draw how long each plan took to compute, next to the control period.

    The title states percentiles of the times that had to be short enough: those of plans made while
    robots drove.
    """
    period_ms = 1e3 * log.start.setup.period_s
    solve_ms = np.array([step.solve_ns for step in log.steps]) / MILLISECOND
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    drove = np.array([False, *(not step.plan.pauses for step in log.steps[:-1])])
    title = f"solve time: {late.sum()} of {len(late)} deadlines missed"
    if drove.any():
        half_ms, most_ms = np.percentile(solve_ms[drove], (50, 99), method="inverted_cdf")
        title += f",\ndriving: half within {half_ms:.3g} ms, 99 % within {most_ms:.3g} ms"
    style.panel(axes, "b", title, SINCE, "solve time [ms]")
    axes.plot(time_s, solve_ms, color=style.FAINT, lw=0.8, zorder=1)
    axes.plot(time_s[~late], solve_ms[~late], ".", color=style.WHOLE, ms=4)
    if late.any():
        look = {"color": style.ALARM, "ms": 4.5, "label": "too late", "clip_on": False}
        axes.plot(time_s[late], solve_ms[late], "v", **look)
    axes.axhline(period_ms, **style.LIMIT, label=f"control period {period_ms:g} ms")
    log_axis(axes, np.append(positive(solve_ms), period_ms), 0.08, 0.1)
    if not late[0] and solve_ms[0] > period_ms:
        axes.annotate(
            "first plan", (time_s[0], solve_ms[0]), (6, 0), textcoords="offset points",
            va="center", fontsize=6.5,
        )  # fmt: skip


def _quantities(log: TrialLog) -> list[_Quantity]:
    """Return the quantities to draw, which are those of the controller's last estimate.

    The log must contain at least one estimate.
    """
    setup = log.start.setup
    estimates = [step.plan.estimate for step in log.steps if step.plan.estimate is not None]
    difference = "difference from the spec [%]"
    rate = "turning rate a, at the end in rad/s"
    if setup.strength:
        rate += f", at {setup.strength:g} {setup.strength_unit}"
    quantities = [
        _Quantity(
            rate,
            difference,
            _stack([estimate.a for estimate in estimates]),
            _stack([estimate.a_std for estimate in estimates]),
            factor=100 / setup.a,
            spec=setup.a,
            true=_true(log, "a"),
        ),
        _Quantity(
            f"speed, at the end in {unit_of(setup.unit)}/s",
            difference,
            _stack([estimate.speed for estimate in estimates]),
            _stack([estimate.speed_std for estimate in estimates]),
            factor=100 / setup.speed,
            spec=setup.speed,
            true=_true(log, "speed"),
        ),
    ]
    if estimates[-1].heading_bias is not None:
        quantities.append(
            _Quantity(
                "heading bias",
                "heading bias [rad]",
                _stack([estimate.heading_bias for estimate in estimates]),
                _stack([estimate.heading_bias_std for estimate in estimates]),
            )
        )
    if estimates[-1].dead_time is not None:
        quantities.append(
            _Quantity(
                "dead time, from the sending of a direction",
                "dead time [ms]",
                _stack([estimate.dead_time for estimate in estimates]),
                _stack([estimate.dead_time_std for estimate in estimates]),
                factor=1e3,
            )
        )
    if estimates[-1].lag is not None:
        quantities.append(
            _Quantity(
                "lag of the wheels",
                "lag [ms]",
                _stack([estimate.lag for estimate in estimates]),
                _stack([estimate.lag_std for estimate in estimates]),
                factor=1e3,
            )
        )
    return quantities


def _draw_estimates(axes: Axes, quantity: _Quantity, time_s: Floats, setup: Setup) -> None:
    """Draw the estimates of a quantity over their times (K,), one named curve for each robot.

    The axis shows the range between OUTLIERS and every last value.
    """
    spec = 0.0 if quantity.spec is None else quantity.spec
    values = (quantity.means - spec) * quantity.factor
    stds = quantity.stds * quantity.factor
    band = np.stack([values - stds, values + stds])
    if values.ndim == 1:
        draw_curves(axes, time_s, [Curve(values, style.INK, "", "all", band, width=1.2)])
        return
    if quantity.spec is not None:
        axes.axhline(0, color=style.GREY, lw=0.6)
    curves = robot_curves(setup, values, band)
    draw_curves(axes, time_s, curves)
    low, high = np.nanpercentile(values if curves[0].band is None else band, OUTLIERS)
    low = min(low, values[-1].min())
    high = max(high, values[-1].max())
    margin = max(0.08 * (high - low), 1e-6)
    low -= margin
    high += margin
    if quantity.spec is not None:
        curves = _named(curves, [f"{end:.3g}" for end in quantity.means[-1]])
    if quantity.true is not None:
        true = (quantity.true - spec) * quantity.factor
        for value, curve in zip(true, curves, strict=True):
            axes.axhline(value, color=curve.color, lw=0.9, ls=":", zorder=5, gid="true")
        curves = _named(curves, [f"(true {value:.3g})" for value in quantity.true])
        low = min(low, true.min() - TRUE_MARGIN)
        high = max(high, true.max() + TRUE_MARGIN)
    axes.set_ylim(low, high)
    name_curves(axes, curves)


def _named(curves: Sequence[Curve], texts: Sequence[str]) -> list[Curve]:
    """Return copies of curves, in which a text follows the name of each.

    Both have the same length.
    """
    return [
        replace(curve, name=f"{curve.name} {text}")
        for curve, text in zip(curves, texts, strict=True)
    ]


def _stack(values: Sequence[Floats | float | None]) -> Floats:
    """Convert the values of all estimates to one array, with NaN where an estimate lacks them.

    The last estimate must have them.
    """
    unknown = np.full_like(values[-1], np.nan, dtype=np.float64)
    return np.array([unknown if value is None else value for value in values], dtype=np.float64)


def _true(log: TrialLog, what: str) -> Floats | None:
    """Return the true turning rates or speeds (N,) of a simulation. None if the log lacks them.

    Raises LogError for a fact that no simulation states.
    """
    fact = log.start.plant.facts.get(f"true_{what}")
    if fact is None:
        return None
    with suppress(OverflowError, RecursionError, TypeError, ValueError):
        values = np.array(json.loads(fact), dtype=np.float64)
        if values.shape == log.start.setup.a.shape and np.isfinite(values).all():
            return values
    raise LogError(f"{log.log}: the fact true_{what} must be a number for each robot")
