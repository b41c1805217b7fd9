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
from tetractl.core.errors import LogError, format_unit
from tetractl.core.poses import Floats, wrap
from tetractl.core.setup import Setup
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import positive, set_log_axis
from tetractl.view.figures.curves import (
    NAME_IN,
    TIME_LABEL,
    Curve,
    create_robot_curves,
    draw_curves,
    end_s,
    name_curves,
)
from tetractl.view.figures.trials import NUMBERED_MIN, one_trial, require_steps

PI_TICKS = {
    "ticks": [-np.pi, -np.pi / 2, 0, np.pi / 2, np.pi],
    "labels": ["−π", "−π/2", "0", "π/2", "π"],
}
ROW_IN = 2.0
"""Height of a row of panels [in]. It is larger if names of robots need it."""
ABOVE_NAMES_IN = 0.7
"""Height of a row of panels in addition to the names of robots [in]."""
TRUE_MARGIN = 1.0
"""Minimum distance between a true value and the edge of its panel [%]."""
SHOWN_PERCENTILES = (1, 99)
"""Percentiles between which values are shown, so that an outlier does not flatten the curves."""


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
    time [ms]. NUMBERED_MIN or more robots have no bands.
    """
    log = one_trial(logs)
    require_steps(log)
    time_s = log.steps_s
    has_estimate = np.array([step.plan.estimate is not None for step in log.steps])
    quantities = _estimated_quantities(log) if has_estimate.any() else []
    row_in = ROW_IN
    if quantities:
        row_in = max(ROW_IN, ABOVE_NAMES_IN + NAME_IN * len(log.start.setup.names))
    n_panels = 2 + len(quantities)
    n_rows = math.ceil(n_panels / 2)
    figure = style.figure(style.PAGE_IN, n_rows * row_in)
    all_axes = list(figure.subplots(n_rows, 2, squeeze=False, sharex=True).ravel())
    for unused in all_axes[n_panels:]:
        unused.set_axis_off()
    all_axes[0].set_xlim(0, end_s(log))
    _draw_signal(all_axes[0], log, time_s)
    _draw_solve_times(all_axes[1], log, time_s)
    for axes, letter, quantity in zip(all_axes[2:], "cdef", quantities, strict=False):
        style.panel(axes, letter, quantity.title, TIME_LABEL, quantity.label)
        _draw_estimates(axes, quantity, time_s[has_estimate], log.start.setup)
    legend_signs: list[Artist] = []
    for axes in all_axes[:n_panels]:
        handles, _ = axes.get_legend_handles_labels()
        legend_signs += handles
    if quantities and len(log.start.setup.names) < NUMBERED_MIN:
        legend_signs.append(
            Patch(color=style.GREY, alpha=0.3, lw=0, label="one standard deviation")
        )
    if quantities and _read_true_values(log, "a") is not None:
        legend_signs.append(style.sign("true value", ls=":", lw=0.9))
    style.legend(figure, legend_signs, 4)
    return figure


def _draw_signal(axes: Axes, log: TrialLog, time_s: Floats) -> None:
    """Draw the direction sent at each control step, as a line that holds until the next step.

    Steps without a direction, in which robots stand still, leave a gap.

    Args:
        axes: The axes.
        log: The trial.
        time_s: Times of the steps [s], shape (K,).
    """
    style.panel(axes, "a", "direction sent", TIME_LABEL, "direction $u$ [rad]")
    directions = np.array([step.command.direction for step in log.steps], dtype=float)
    wrapped_directions = wrap(directions)
    is_wrap = np.abs(np.diff(wrapped_directions, append=wrapped_directions[-1])) > np.pi
    axes.plot(
        *_step_line(time_s, wrapped_directions, is_wrap), color=style.WHOLE, lw=1.0, gid="direction"
    )
    axes.set_ylim(-1.08 * np.pi, 1.08 * np.pi)
    axes.set_yticks(**PI_TICKS)


def _step_line(time_s: Floats, values: Floats, breaks: np.ndarray) -> tuple[Floats, Floats]:
    """Compute x and y of a line that holds each value until the time of the next one.

    Args:
        time_s: Times of the values [s], shape (K,).
        values: The values, shape (K,).
        breaks: Whether the line is interrupted after each value, shape (K,).
    """
    until_s = np.append(time_s[1:], time_s[-1])
    x = np.column_stack([time_s, until_s, until_s])
    y = np.column_stack([values, values, np.where(breaks, np.nan, values)])
    return x.ravel(), y.ravel()


def _draw_solve_times(axes: Axes, log: TrialLog, time_s: Floats) -> None:
    """Draw how long each plan took to compute, next to the control period.

    The title states percentiles of the solve times while robots drove. Only these times had to be
    short enough.
    """
    period_ms = 1e3 * log.start.setup.period_s
    solve_ms = np.array([step.solve_ns for step in log.steps]) / MILLISECOND
    is_late = np.array([step.deadline_missed for step in log.steps], dtype=bool)
    was_driving = np.array([False, *(not step.plan.pauses for step in log.steps[:-1])])
    title = f"solve time: {is_late.sum()} of {len(is_late)} deadlines missed"
    if was_driving.any():
        median_ms, p99_ms = np.percentile(solve_ms[was_driving], (50, 99), method="inverted_cdf")
        title += f",\ndriving: half within {median_ms:.3g} ms, 99 % within {p99_ms:.3g} ms"
    style.panel(axes, "b", title, TIME_LABEL, "solve time [ms]")
    axes.plot(time_s, solve_ms, color=style.FAINT, lw=0.8, zorder=1)
    axes.plot(time_s[~is_late], solve_ms[~is_late], ".", color=style.WHOLE, ms=4)
    if is_late.any():
        late_style = {"color": style.ALARM, "ms": 4.5, "label": "too late", "clip_on": False}
        axes.plot(time_s[is_late], solve_ms[is_late], "v", **late_style)
    axes.axhline(period_ms, **style.LIMIT, label=f"control period {period_ms:g} ms")
    set_log_axis(axes, np.append(positive(solve_ms), period_ms), 0.08, 0.1)
    if not is_late[0] and solve_ms[0] > period_ms:
        axes.annotate(
            "first plan", (time_s[0], solve_ms[0]), (6, 0), textcoords="offset points",
            va="center", fontsize=6.5,
        )  # fmt: skip


def _estimated_quantities(log: TrialLog) -> list[_Quantity]:
    """Collect the quantities to draw, which are those of the controller's last estimate.

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
            _stack_estimates([estimate.a for estimate in estimates]),
            _stack_estimates([estimate.a_std for estimate in estimates]),
            factor=100 / setup.a,
            spec=setup.a,
            true=_read_true_values(log, "a"),
        ),
        _Quantity(
            f"speed, at the end in {format_unit(setup.unit)}/s",
            difference,
            _stack_estimates([estimate.speed for estimate in estimates]),
            _stack_estimates([estimate.speed_std for estimate in estimates]),
            factor=100 / setup.speed,
            spec=setup.speed,
            true=_read_true_values(log, "speed"),
        ),
    ]
    if estimates[-1].heading_bias is not None:
        quantities.append(
            _Quantity(
                "heading bias",
                "heading bias [rad]",
                _stack_estimates([estimate.heading_bias for estimate in estimates]),
                _stack_estimates([estimate.heading_bias_std for estimate in estimates]),
            )
        )
    if estimates[-1].dead_time is not None:
        quantities.append(
            _Quantity(
                "dead time, from the sending of a direction",
                "dead time [ms]",
                _stack_estimates([estimate.dead_time for estimate in estimates]),
                _stack_estimates([estimate.dead_time_std for estimate in estimates]),
                factor=1e3,
            )
        )
    if estimates[-1].lag is not None:
        quantities.append(
            _Quantity(
                "lag of the wheels",
                "lag [ms]",
                _stack_estimates([estimate.lag for estimate in estimates]),
                _stack_estimates([estimate.lag_std for estimate in estimates]),
                factor=1e3,
            )
        )
    return quantities


def _draw_estimates(axes: Axes, quantity: _Quantity, time_s: Floats, setup: Setup) -> None:
    """Draw the estimates of a quantity over their times (K,), one named curve for each robot.

    The axis shows the range between SHOWN_PERCENTILES, and every last value.
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
    curves = create_robot_curves(setup, values, band)
    draw_curves(axes, time_s, curves)
    lower_limit, upper_limit = np.nanpercentile(
        values if curves[0].band is None else band, SHOWN_PERCENTILES
    )
    lower_limit = min(lower_limit, values[-1].min())
    upper_limit = max(upper_limit, values[-1].max())
    margin = max(0.08 * (upper_limit - lower_limit), 1e-6)
    lower_limit -= margin
    upper_limit += margin
    if quantity.spec is not None:
        curves = _append_to_names(
            curves, [f"{final_mean:.3g}" for final_mean in quantity.means[-1]]
        )
    if quantity.true is not None:
        true_values = (quantity.true - spec) * quantity.factor
        for value, curve in zip(true_values, curves, strict=True):
            axes.axhline(value, color=curve.color, lw=0.9, ls=":", zorder=5, gid="true")
        curves = _append_to_names(curves, [f"(true {value:.3g})" for value in quantity.true])
        lower_limit = min(lower_limit, true_values.min() - TRUE_MARGIN)
        upper_limit = max(upper_limit, true_values.max() + TRUE_MARGIN)
    axes.set_ylim(lower_limit, upper_limit)
    name_curves(axes, curves)


def _append_to_names(curves: Sequence[Curve], suffixes: Sequence[str]) -> list[Curve]:
    """Copy curves, and append a text to the name of each. There is one text for each curve."""
    return [
        replace(curve, name=f"{curve.name} {suffix}")
        for curve, suffix in zip(curves, suffixes, strict=True)
    ]


def _stack_estimates(values: Sequence[Floats | float | None]) -> Floats:
    """Convert the values of all estimates to one array, with NaN for an estimate without values.

    The last estimate must have values.
    """
    unknown = np.full_like(values[-1], np.nan, dtype=np.float64)
    return np.array([unknown if value is None else value for value in values], dtype=np.float64)


def _read_true_values(log: TrialLog, parameter: str) -> Floats | None:
    """Read the true turning rates or speeds of a simulation.

    Args:
        log: The trial.
        parameter: "a" or "speed".

    Returns:
        The values, shape (N,). None if the log does not contain them.

    Raises:
        LogError: If the log states them in a form that no simulation writes.
    """
    fact = log.start.plant.facts.get(f"true_{parameter}")
    if fact is None:
        return None
    with suppress(OverflowError, RecursionError, TypeError, ValueError):
        values = np.array(json.loads(fact), dtype=np.float64)
        if values.shape == log.start.setup.a.shape and np.isfinite(values).all():
            return values
    raise LogError(
        f"{log.log}: the plant's fact true_{parameter} must be a list with one finite number for "
        "each robot"
    )
