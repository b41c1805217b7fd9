"""Tests of the numbers that the figures of errors and of searches show."""

from dataclasses import replace

import numpy as np
import pytest
from testkit import random_trials
from testkit.drawn import lines

from tetractl.core.clock import SECOND
from tetractl.core.errors import UsageError
from tetractl.core.plan import Outcome
from tetractl.view import style
from tetractl.view.figures.convergence import convergence_figure
from tetractl.view.figures.curves import create_robot_curves, end_s
from tetractl.view.figures.errors import compute_errors_at, errors_figure
from tetractl.view.figures.trials import NUMBERED_MIN

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of six control steps, a frame each 0.1 s."""
    made = random_trials.trial(steps=6, robots=2, frames=2, first=3, iterations=4, length=5)
    return random_trials.write_and_read(made, tmp_path_factory.mktemp("log") / "t.mcap")


def distances(log, row):
    return log.start.setup.distances(log.mocap[row, :, :2]).tolist()


def test_the_error_at_a_time_is_the_last_one_measured_until_then(log):
    before_end = log.frames_s[log.frames_s < end_s(log) - 0.15]
    between = before_end + 0.05
    for times in (before_end, between):
        errors = compute_errors_at(log, times)
        assert errors.tolist() == [distances(log, row) for row in range(len(times))]
    assert compute_errors_at(log, np.array([-5.0])).tolist() == [distances(log, 0)]


def test_the_error_of_a_robot_that_is_not_tracked_is_held(log):
    valid = log.valid.copy()
    valid[3:6, 1] = False
    errors = compute_errors_at(replace(log, valid=valid), log.frames_s[:8])
    held = distances(log, 2)[1]
    assert errors[3:6, 1].tolist() == [held] * 3
    assert errors[3:6, 0].tolist() == [distances(log, row)[0] for row in (3, 4, 5)]
    assert errors[6, 1] == distances(log, 6)[1]


def test_from_its_end_on_a_trial_keeps_the_error_of_its_result(log):
    end = end_s(log)
    times = np.array([end - 1e-6, end, end + 1, end + 100])
    errors = compute_errors_at(log, times).tolist()
    assert errors[0] != list(log.result.robot_errors)
    assert errors[1:] == [list(log.result.robot_errors)] * 3
    unfinished = compute_errors_at(replace(log, result=None), times).tolist()
    assert unfinished[-1] == distances(log, -1)


def test_a_trial_ends_so_long_after_its_first_command_and_never_at_once(log):
    stop = replace(log.stop, sent_ns=log.began_ns + 3 * SECOND)
    assert end_s(replace(log, stop=stop)) == 3.0
    at_once = replace(log, steps=(), commands=(), stop=replace(log.stop, sent_ns=0))
    assert 0 < end_s(at_once) < 1e-6


def test_the_figure_of_one_trial_has_its_total_and_each_robots_error_up_to_the_result(log):
    of_total, of_robots = errors_figure([log]).axes
    (total,) = lines(of_total, gid="total")
    gaps = log.start.setup.distances(log.positions)
    assert total.get_ydata().tolist() == gaps.sum(axis=1).tolist()
    for robot in range(2):
        (line,) = lines(of_robots, gid=f"robot-{robot}")
        assert line.get_ydata().tolist() == gaps[:, robot].tolist()
        assert line.get_xdata().tolist() == log.frames_s.tolist()
    texts = [text.get_text() for text in of_total.get_legend().get_texts()]
    assert texts == [f"{log.result.total_error:.1f} mm"] or "mm" in texts[0]
    assert of_total.get_xlim() == of_robots.get_xlim() == (0, end_s(log))
    after = log.frames_s >= 0
    assert of_robots.get_ylim()[0] == 0
    assert of_total.get_ylim()[1] >= gaps.sum(axis=1)[after].max()


@pytest.mark.parametrize("tolerance", [0.0, 25.0])
def test_a_tolerance_is_a_line_if_there_is_one(log, tolerance):
    spec = log.experiment
    control = spec.controller.model_copy(update={"arrival_tolerance": tolerance})
    with_tolerance = replace(log, experiment=spec.model_copy(update={"controller": control}))
    of_robots = errors_figure([with_tolerance]).axes[1]
    labels = of_robots.get_legend_handles_labels()[1]
    assert ("arrival within 25 mm" in labels) == (tolerance == 25.0)


@pytest.mark.parametrize("late", [(), (1, 4)])
def test_steps_that_missed_their_deadline_are_marked(log, late):
    steps = tuple(replace(step, deadline_missed=step.k in late) for step in log.steps)
    of_robots = errors_figure([replace(log, steps=steps)]).axes[1]
    marked = lines(of_robots, label="deadline missed")
    assert len(marked) == bool(late)
    if late:
        assert marked[0].get_xdata().tolist() == [log.steps_s[k] for k in late]


def other(log, error, **fields):
    """The same trial with another final error, in which both robots have half of it."""
    result = replace(log.result, robot_errors=(error / 2, error / 2), total_error=error, **fields)
    return replace(log, result=result)


def test_several_trials_have_a_median_of_those_that_ran_to_their_end(log):
    logs = [other(log, error) for error in (10.0, 20.0, 90.0)]
    aborted = other(log, 5000.0, outcome=Outcome.ABORTED)
    of_total, of_robots = errors_figure([*logs, aborted]).axes
    assert lines(of_total, gid="median")[0].get_ydata()[-1] == 20.0
    assert lines(of_robots, gid="robot-0")[0].get_ydata()[-1] == 10.0
    colors = [line.get_color() for line in lines(of_total, gid="trial")]
    assert colors == [style.GREY] * 3 + [style.ALARM]
    assert of_total.get_title(loc="left").startswith("(a) total error of 4 trials")
    only_aborted = errors_figure([aborted, aborted]).axes[0]
    assert lines(only_aborted, gid="median")[0].get_ydata()[-1] == 5000.0


def in_folder(log, folder):
    return replace(log, log=f"{folder}/{log.log.rpartition('/')[2]}")


def test_each_folder_has_panels_of_its_own_up_to_twelve(log):
    two = [in_folder(other(log, error), f"a/{error}") for error in (10.0, 20.0)]
    figure = errors_figure(two)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert [title[:3] for title in titles] == ["(a)", "(b)", "(c)", "(d)"]
    assert titles[0].startswith("(a) 10.0: total error of 1 trial,")
    many = [in_folder(log, f"a/{number}") for number in range(13)]
    with pytest.raises(UsageError, match="13 folders"):
        errors_figure(many)


@pytest.mark.parametrize(
    ("robots", "has_band"), [(3, True), (NUMBERED_MIN - 1, True), (NUMBERED_MIN, False)]
)
def test_curves_of_very_many_robots_have_no_bands(robots, has_band):
    setup = random_trials.experiment(robots).setup
    values = np.arange(2.0 * robots).reshape(2, robots)
    band = np.stack([values - 1, values + 1])
    curves = create_robot_curves(setup, values, band, "{:.0f}".format)
    assert [curve.values.tolist() for curve in curves] == values.T.tolist()
    assert all((curve.band is not None) == has_band for curve in curves)
    assert curves[1].name.endswith(f" {robots + 1}")
    if has_band:
        assert curves[2].band.tolist() == band[..., 2].tolist()


def test_the_searches_of_the_first_step_are_drawn_with_the_chosen_one_marked_where_it_ended(log):
    axes = convergence_figure([log]).axes[0]
    plan = log.steps[0].plan
    drawn = [line.get_ydata().tolist() for line in axes.lines]
    others = [s.history.tolist() for s in plan.searches if s is not plan.search]
    assert drawn[: len(others)] == others
    assert drawn[len(others)] == plan.search.history.tolist()
    iteration = len(plan.search.history) - 1
    end = axes.lines[-1]
    assert (end.get_xdata()[0], end.get_ydata()[0]) == (iteration, plan.search.history[-1])
    (note,) = axes.texts
    assert note.get_text().startswith(f"{plan.search.length} signals: stopped\nat iteration 4 (")
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["chosen", f"{len(plan.searches) - 1} other horizons"]


def test_one_search_has_no_others(log):
    step = log.steps[0]
    plan = replace(step.plan, searches=(step.plan.search,), chosen=0)
    alone = replace(log, steps=(replace(step, plan=plan), *log.steps[1:]))
    axes = convergence_figure([alone]).axes[0]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["chosen"]


@pytest.mark.parametrize(
    ("longest", "side"), [(4, "right"), (7, "right"), (8, "left"), (20, "left")]
)
def test_the_note_is_on_the_side_with_space(log, longest, side):
    step = log.steps[0]
    chosen = step.plan.search  # of 4 iterations
    long = replace(chosen, history=np.linspace(900, 100, longest + 1))
    plan = replace(step.plan, searches=(chosen, long), chosen=0)
    changed = replace(log, steps=(replace(step, plan=plan), *log.steps[1:]))
    (note,) = convergence_figure([changed]).axes[0].texts
    assert note.get_ha() == side
