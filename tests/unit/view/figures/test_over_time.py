"""The parts of the figure over time, without drawing all of it: see test_figures for the whole."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from testkit.drawn import lines
from testkit.trials import three_robots

from tetractl.core.errors import LogError
from tetractl.core.motion_estimate import Estimate
from tetractl.view import style
from tetractl.view.figures.over_time import (
    _draw_estimates,
    _draw_signal,
    _draw_solve_times,
    _estimated_quantities,
    _read_true_values,
    _stack_estimates,
    _step_line,
    over_time_figure,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log():
    return three_robots()


def axes():
    return Figure().add_subplot()


def with_estimates(log, *estimates):
    steps = [
        replace(step, plan=replace(step.plan, estimate=estimate))
        for step, estimate in zip(log.steps, estimates, strict=False)
    ]
    return replace(log, steps=tuple(steps))


def with_facts(log, **facts):
    plant = replace(log.start.plant, facts=facts)
    return replace(log, start=replace(log.start, plant=plant))


def test_a_value_is_held_until_the_next_one_and_a_break_follows_it():
    x, y = _step_line(
        np.array([0.0, 1.0, 3.0]), np.array([5.0, 6.0, 7.0]), np.array([0, 1, 0], bool)
    )
    assert x.tolist() == [0, 1, 1, 1, 3, 3, 3, 3, 3]
    assert y[:5].tolist() == [5, 5, 5, 6, 6]
    assert np.isnan(y[5])
    assert y[6:].tolist() == [7, 7, 7]


def test_a_direction_is_drawn_within_half_a_turn_and_broken_where_it_passes_it(log):
    sent = [0.5, 3.0, 3.5, 0.1 + 2 * np.pi]
    steps = tuple(
        replace(
            step, command=replace(step.command, action=replace(step.command.action, direction=u))
        )
        for step, u in zip(log.steps, sent, strict=False)
    )
    panel = axes()
    _draw_signal(panel, replace(log, steps=steps), np.arange(4.0))
    (line,) = lines(panel, gid="direction")
    drawn = line.get_ydata()
    assert drawn[[0, 3, 6, 9]] == pytest.approx([0.5, 3.0, 3.5 - 2 * np.pi, 0.1])
    assert np.flatnonzero(np.isnan(drawn)).tolist() == [5]


def test_solve_times_are_in_ms_and_only_plans_made_while_driving_count(log):
    count = len(log.steps)
    steps = [replace(step, solve_ns=2_000_000, deadline_missed=False) for step in log.steps]
    steps[0] = replace(steps[0], solve_ns=900_000_000)  # made while the robots stand
    steps[5] = replace(steps[5], solve_ns=300_000_000, deadline_missed=True)
    panel = axes()
    time_s = np.arange(count) * 0.2
    _draw_solve_times(panel, replace(log, steps=tuple(steps)), time_s)
    title = panel.get_title(loc="left")
    assert f"1 of {count} deadlines missed" in title
    assert "half within 2 ms, 99 % within 300 ms" in title
    (late,) = lines(panel, color=style.ALARM)
    assert late.get_xydata() == pytest.approx(np.array([[1.0, 300.0]]))
    (label,) = panel.texts
    assert label.get_text() == "first plan"
    assert tuple(label.xy) == pytest.approx((0.0, 900.0))


def test_no_plan_is_called_first_or_late_if_all_are_in_time(log):
    steps = tuple(replace(step, solve_ns=2_000_000, deadline_missed=False) for step in log.steps)
    panel = axes()
    _draw_solve_times(panel, replace(log, steps=steps), np.arange(len(steps)) * 0.2)
    assert not panel.texts
    assert not lines(panel, color=style.ALARM)


def test_quantities_are_those_of_the_last_estimate_relative_to_the_spec(log):
    setup = log.start.setup
    a, v = setup.a, setup.speed
    first = Estimate(a, 0.2 * a, v, 0.1 * v)
    bias = np.array([0.1, 0.2, 0.3])
    last = replace(
        first, a=1.1 * a, speed=0.8 * v, heading_bias=bias, heading_bias_std=0.5 * bias,
        dead_time=0.05, dead_time_std=0.01,
    )  # fmt: skip
    facts = {"true_a": str((1.2 * a).tolist())}
    rate, speed, heading, dead_time = _estimated_quantities(
        with_facts(with_estimates(log, first, last), **facts)
    )
    assert (rate.means[-1] - rate.spec) * rate.factor == pytest.approx(np.full(3, 10.0))
    assert rate.stds[0] * rate.factor == pytest.approx(np.full(3, 20.0))
    assert (speed.means[-1] - speed.spec) * speed.factor == pytest.approx(np.full(3, -20.0))
    assert rate.true == pytest.approx(1.2 * a)
    assert speed.true is None
    assert np.isnan(heading.means[0]).all()
    assert heading.means[1] == pytest.approx(bias)
    assert dead_time.means[1] * dead_time.factor == pytest.approx(50.0)
    assert len(_estimated_quantities(with_estimates(log, last, first))) == 2


def test_the_range_of_an_estimate_contains_its_last_and_true_values(log):
    setup = log.start.setup
    estimates = [Estimate(f * setup.a, 0.01 * setup.a, setup.speed, setup.speed) for f in (1, 1.02)]
    true = (1.5 * setup.a).tolist()
    changed = with_facts(with_estimates(log, *estimates), true_a=str(true))
    quantity = _estimated_quantities(changed)[0]
    panel = axes()
    _draw_estimates(panel, quantity, np.array([0.0, 1.0]), setup)
    low, high = panel.get_ylim()
    assert low < -1.0
    assert high > 50.0
    assert [line.get_ydata()[0] for line in lines(panel, gid="true")] == pytest.approx([50.0] * 3)


def test_what_an_estimate_lacks_is_unknown():
    assert np.isnan(_stack_estimates([None, 0.5])[0])
    stacked = _stack_estimates([None, np.array([1.0, 2.0])])
    assert stacked.shape == (2, 2)
    assert np.isnan(stacked[0]).all()


@pytest.mark.parametrize("fact", ["[1, 2]", "[1, 2, NaN]", "no", "{}", "[[1, 2, 3]]"])
def test_a_fact_that_is_not_a_number_for_each_robot_is_refused(log, fact):
    with pytest.raises(LogError, match="true_a"):
        _read_true_values(with_facts(log, true_a=fact), "a")
    assert _read_true_values(with_facts(log), "a") is None


@pytest.mark.parametrize(("with_estimate", "rows"), [(False, 1), (True, 3)])
def test_the_figure_has_two_panels_a_row_and_a_height_for_each_row(log, with_estimate, rows):
    """Directions and solve times, and a panel for each quantity that was estimated."""
    steps = [replace(step, plan=replace(step.plan, estimate=None)) for step in log.steps]
    shown = replace(log, steps=tuple(steps))
    if with_estimate:
        robots = len(log.start.setup.names)
        each = np.ones(robots)
        estimate = Estimate(each, 0.1 * each, each, 0.1 * each, 0.1 * each, 0.1 * each, 0.1, 0.01)
        shown = with_estimates(shown, *[estimate] * len(steps))
    figure = over_time_figure([shown])
    panels = [axes for axes in figure.axes if axes.axison]
    assert -(-len(panels) // 2) == rows
    bare = over_time_figure([replace(shown, steps=tuple(steps))])
    assert figure.get_figheight() == pytest.approx(rows * bare.get_figheight())
