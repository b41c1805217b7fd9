"""The figure of a trial over time: the signal, the solve times, and the controller's estimates of
each robot's values and of the dead time.
"""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.clock import MILLISECOND
from tetractl.core.errors import LogError, unit_of
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats, wrap
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import NUMBERED, log_axis, need_steps, one_trial, positive
from tetractl.view.figures.curves import (
    NAME_IN,
    SINCE,
    Curve,
    draw_curves,
    end_s,
    name_curves,
    robot_curves,
)

PI_TICKS = {
    "ticks": [-np.pi, -np.pi / 2, 0, np.pi / 2, np.pi],
    "labels": ["−π", "−π/2", "0", "π/2", "π"],
}
LETTERS = "abcdefgh"


@dataclass(frozen=True, slots=True)
class _Panel:
    """A panel: its title, the label of its y axis, and the function that draws into it at the
    times (K,) of the control steps; that returns the curves to name at their ends.
    """

    title: str
    label: str
    draw: Callable[[Axes, Floats], list[Curve]]


@dataclass(frozen=True, slots=True)
class _Quantity:
    """An estimated quantity: title, label of its axis, what an estimate states of it and of its
    standard deviation, and the factor from that to what is drawn.

    For a quantity that the spec states too, `spec` (N,), the difference from it is drawn, and a
    dotted line at the `true` value (N,) of a simulation.
    """

    title: str
    label: str
    of: Callable[[Estimate], tuple[Floats | float | None, Floats | float | None]]
    factor: Floats | float = 1.0
    spec: Floats | None = None
    true: Floats | None = None


@style.styled()
def over_time_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw a trial over time: the direction sent, the solve times next to the control period, and
    the estimates, if there are any.

    Each estimated quantity has a panel, with a band of +- one standard deviation: turning rate a
    and speed as differences from the spec's values [%], with a dotted line at a simulation's true
    value; the heading bias [rad]; the dead time [ms]. NUMBERED or more robots have no bands.
    """
    log = one_trial(logs)
    need_steps(log)
    estimated = any(step.plan.estimate is not None for step in log.steps)
    panels = [_signal(log), _solve_times(log), *(_estimates(log) if estimated else [])]
    time_s = np.array([log.elapsed_s(step.command.sent_ns) for step in log.steps])
    rows = -(-len(panels) // 2)
    row_in = max(2.0, 0.7 + NAME_IN * len(log.start.setup.names)) if estimated else 2.0
    figure = style.figure(style.PAGE_IN, rows * row_in)
    places = [*figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()]
    for spare in places[len(panels) :]:
        spare.set_axis_off()
    named: list[tuple[Axes, list[Curve]]] = []
    for axes, letter, panel in zip(places, LETTERS, panels, strict=False):
        style.panel(axes, letter, panel.title, SINCE, panel.label)
        axes.set_xlim(0, end_s(log))
        named.append((axes, panel.draw(axes, time_s)))
    handles = [one for axes in places for one in axes.get_legend_handles_labels()[0]]
    style.legend(figure, [*handles, *_signs_of_estimates(log, estimated)], 4)
    for axes, curves in named:  # the limits are set
        if curves:
            name_curves(axes, curves)
    return figure


def _signs_of_estimates(log: TrialLog, estimated: bool) -> list[Artist]:
    if not estimated:
        return []
    signs: list[Artist] = []
    if len(log.start.setup.names) < NUMBERED:
        signs.append(Patch(color=style.GREY, alpha=0.3, lw=0, label="one standard deviation"))
    if _true(log, "a") is not None:
        signs.append(style.sign("true value", ls=":", lw=0.9))
    return signs


def _signal(log: TrialLog) -> _Panel:
    """Return the panel of the direction, held until the next step; steps without a direction, in
    which robots stand, leave a gap.
    """

    def direction(axes: Axes, time_s: Floats) -> list[Curve]:
        sent = np.array([step.command.direction for step in log.steps], dtype=float)
        u = wrap(sent)
        wraps = np.abs(np.diff(u, append=u[-1])) > np.pi
        axes.plot(*_held(time_s, u, wraps), color=style.WHOLE, lw=1.0, gid="direction")
        axes.set_ylim(-1.08 * np.pi, 1.08 * np.pi)
        axes.set_yticks(**PI_TICKS)
        return []

    return _Panel("direction sent", "direction $u$ [rad]", direction)


def _held(time_s: Floats, values: Floats, breaks: np.ndarray) -> tuple[Floats, Floats]:
    """Return x and y of a line that holds each value until the next time; after a value where
    `breaks` is true the line is interrupted.
    """
    until = np.append(time_s[1:], time_s[-1])
    x = np.column_stack([time_s, until, until])
    y = np.column_stack([values, values, np.where(breaks, np.nan, values)])
    return x.ravel(), y.ravel()


def _solve_times(log: TrialLog) -> _Panel:
    """Return the panel of the solve times next to the control period."""
    period_ms = 1e3 * log.start.setup.period_s
    solve_ms = np.array([step.solve_ns for step in log.steps]) / MILLISECOND
    late = np.array([step.deadline_missed for step in log.steps], dtype=bool)

    def draw(axes: Axes, time_s: Floats) -> list[Curve]:
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
        shares = {"half within": 50, "99 % within": 99}
        return [
            Curve(
                np.array([np.percentile(solve_ms, share, method="inverted_cdf")]), style.INK,
                f"{text}\n{np.percentile(solve_ms, share, method='inverted_cdf'):.3g} ms", "share",
            )
            for text, share in shares.items()
        ]  # fmt: skip

    return _Panel(
        f"solve time: {late.sum()} of {len(late)} deadlines missed", "solve time [ms]", draw
    )


def _estimates(log: TrialLog) -> list[_Panel]:
    """Return a panel for each quantity that the controller estimated."""
    estimates = [step.plan.estimate for step in log.steps]
    last = next(one for one in reversed(estimates) if one is not None)

    def panel(quantity: _Quantity) -> _Panel:
        def draw(axes: Axes, time_s: Floats) -> list[Curve]:
            known = [k for k, one in enumerate(estimates) if one is not None]
            shown = [one for one in estimates if one is not None]
            return _draw(axes, quantity, time_s[known], shown, log)

        return _Panel(quantity.title, quantity.label, draw)

    return [panel(quantity) for quantity in _quantities(log, last)]


def _quantities(log: TrialLog, last: Estimate) -> list[_Quantity]:
    """Return the panels for what the last estimate states."""
    setup = log.start.setup
    unit, off = unit_of(setup.unit), "difference from the spec [%]"
    a, speed, rate = setup.a, setup.speed, "turning rate a, at the end in rad/s"
    rate += f", at {setup.strength:g} {setup.strength_unit}" if setup.strength else ""
    shown = [
        _Quantity(rate, off, lambda e: (e.a, e.a_std), 100 / a, a, _true(log, "a")),
        _Quantity(
            f"speed, at the end in {unit}/s", off, lambda e: (e.speed, e.speed_std), 100 / speed,
            speed, _true(log, "speed"),
        ),
    ]  # fmt: skip
    if last.heading_bias is not None:
        bias = "heading bias"
        shown.append(
            _Quantity(bias, f"{bias} [rad]", lambda e: (e.heading_bias, e.heading_bias_std))
        )
    if last.dead_time is not None:
        dead = "dead time, from the sending of a direction"
        shown.append(
            _Quantity(dead, "dead time [ms]", lambda e: (e.dead_time, e.dead_time_std), 1e3)
        )
    return shown


def _draw(
    axes: Axes,
    quantity: _Quantity,
    time_s: Floats,
    estimates: Sequence[Estimate],
    log: TrialLog,
) -> list[Curve]:
    """Draw a quantity over time, and return the curves to name at their ends: those of robots.

    The axis shows the range from the 1st to the 99th percentile and every last value, so that one
    outlier does not hide the rest.
    """
    found = [quantity.of(estimate) for estimate in estimates]
    ends, stds = (_stack([pair[i] for pair in found]) for i in (0, 1))
    spec, factor = 0.0 if quantity.spec is None else quantity.spec, quantity.factor
    values, stds = (ends - spec) * factor, stds * factor
    band = np.stack([values - stds, values + stds])
    if values.ndim == 1:
        draw_curves(axes, time_s, [Curve(values, style.INK, "", "all", band, width=1.2)])
        return []
    if quantity.spec is not None:
        axes.axhline(0, color=style.GREY, lw=0.6)
    curves = robot_curves(log.start.setup, values, band)
    draw_curves(axes, time_s, curves)
    low, high = np.nanpercentile(band if curves[0].band is not None else values, [1, 99])
    low, high = min(low, values[-1].min()), max(high, values[-1].max())
    margin = max(0.08 * (high - low), 1e-6)
    low, high = low - margin, high + margin
    if quantity.spec is not None:
        texts = [f"{curve.name} {end:.3g}" for curve, end in zip(curves, ends[-1], strict=True)]
        curves = [replace(one, name=text) for one, text in zip(curves, texts, strict=True)]
    if quantity.true is not None:
        true = (quantity.true - spec) * factor
        for value, curve in zip(true, curves, strict=True):
            axes.axhline(value, color=curve.color, lw=0.9, ls=":", zorder=5, gid="true")
        texts = [
            f"{curve.name} (true {value:.3g})"
            for curve, value in zip(curves, quantity.true, strict=True)
        ]
        curves = [replace(one, name=text) for one, text in zip(curves, texts, strict=True)]
        low, high = min(low, true.min() - 1), max(high, true.max() + 1)
    axes.set_ylim(low, high)
    return curves


def _stack(values: Sequence[Floats | float | None]) -> Floats:
    """Return the values of all estimates, NaN where an estimate lacks them, but the last does
    not."""
    unknown = np.full_like(values[-1], np.nan, dtype=np.float64)
    return np.array([unknown if one is None else one for one in values], dtype=np.float64)


def _true(log: TrialLog, what: str) -> Floats | None:
    """Return the true turning rates or speeds (N,) of a simulation, None if the log lacks them.

    Raises LogError for a fact that no simulation states.
    """
    fact = log.start.plant.facts.get(f"true_{what}")
    if fact is None:
        return None
    with suppress(OverflowError, RecursionError, TypeError, ValueError):
        found = np.array(json.loads(fact), dtype=np.float64)
        if found.shape == log.start.setup.a.shape and np.isfinite(found).all():
            return found
    raise LogError(f"{log.log}: the fact true_{what} is not a number for each robot")
