"""The figure of the controller's estimates of each robot's values, and of the dead time, over a
trial.
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

from tetractl.core.errors import LogError, unit_of
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.read.validate import VALUE_MAX
from tetractl.view import style
from tetractl.view.figures.axes import NUMBERED, one_trial
from tetractl.view.figures.curves import (
    NAME_IN,
    SINCE,
    Curve,
    draw_curves,
    name_curves,
    robot_curves,
)


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A panel: title, label of its axis, what an estimate states of the quantity and of its
    standard deviation, and the factor from that to what is drawn.

    For a quantity that the spec states too, `spec` (N,), the difference from it is drawn, and a
    cross at the `true` value (N,) of a simulation.
    """

    title: str
    label: str
    of: Callable[[Estimate], tuple[Floats | float | None, Floats | float | None]]
    factor: Floats | float = 1.0
    spec: Floats | None = None
    true: Floats | None = None


@style.styled()
def estimate_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the estimates of a trial over time, each with a band of +- one standard deviation.

    Each estimated quantity has a panel: turning rate a and speed as differences from the spec's
    values [%], with a cross at a simulation's true value; the heading bias [rad]; the dead time
    [ms]. NUMBERED or more robots have no bands.
    """
    log = one_trial(logs)
    steps = [(step, one) for step in log.steps if (one := step.plan.estimate) is not None]
    if not steps:
        raise LogError(
            f"{log.path}: contains no estimates to plot",
            "run the trial with --set controller.estimate=true",
        )
    setup, last = log.start.setup, steps[-1][1]
    time_s = np.array([log.elapsed_s(step.command.sent_ns) for step, _ in steps])
    estimates = [estimate for _, estimate in steps]
    shown = _quantities(log, last)
    rows = -(-len(shown) // 2)
    figure = style.figure(style.PAGE_IN, rows * max(2.3, 0.7 + NAME_IN * len(setup.names)))
    panels = [*figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()]
    for spare in panels[len(shown) :]:
        spare.set_axis_off()
    named: list[tuple[Axes, list[Curve]]] = []
    for axes, letter, quantity in zip(panels, "abcd", shown, strict=False):
        style.panel(axes, letter, quantity.title, SINCE, quantity.label)
        axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
        named.append((axes, _draw(axes, quantity, time_s, estimates, log)))
    signs: list[Artist] = []
    if len(setup.names) < NUMBERED:
        signs.append(Patch(color=style.GREY, alpha=0.3, lw=0, label="one standard deviation"))
    if shown[0].true is not None:
        signs.append(style.sign("true value", marker="x", ms=4))
    style.legend(figure, signs)
    for axes, curves in named:
        if curves:
            name_curves(axes, curves)
    return figure


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
        dead = "dead time"
        shown.append(_Quantity(dead, f"{dead} [ms]", lambda e: (e.dead_time, e.dead_time_std), 1e3))
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
            axes.plot(
                1, value, "x", color=curve.color, ms=4, mew=1.0, clip_on=False, zorder=5,
                transform=axes.get_yaxis_transform(),
            )  # fmt: skip
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
        if found.shape == log.start.setup.a.shape and (np.abs(found) <= VALUE_MAX).all():
            return found
    raise LogError(f"{log.path}: the fact true_{what} is not a number for each robot")
