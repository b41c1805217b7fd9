"""Tests of the figures of trials: their contents, and that no text hides another."""

from dataclasses import replace
from inspect import cleandoc

import matplotlib
import numpy as np
import pytest
from testkit.drawn import end_of, lines, overlapping, words
from testkit.marked_robots import MarkedRobots
from testkit.trials import THREE_M3PI, cut_short, experiment, three_robots

from tetractl.core.clock import SECOND
from tetractl.core.colors import BLUE, GREEN, RED
from tetractl.core.commands import Steer
from tetractl.core.errors import LogError, UsageError
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.registries import FIGURES
from tetractl.core.trial import PlantInfo
from tetractl.view import figures, style
from tetractl.view.figures.draw import draw
from tetractl.view.figures.errors import compute_errors_at
from tetractl.view.figures.trajectory import trajectory_figure

pytestmark = pytest.mark.slow

SEVERAL = ("trajectory", "errors", "batch")  # kinds that show several trials
ALONE = tuple(kind for kind in FIGURES.builtin if kind not in SEVERAL)
COURSES = tuple(kind for kind in FIGURES.builtin if kind != "batch")
TARGETS = np.array([robot["target"] for robot in THREE_M3PI["robots"]])


def test_an_error_at_the_time_of_a_frame_is_that_of_the_frame():
    log = replace(three_robots(), result=None)
    time_s = (log.mocap_ns - log.began_ns) / SECOND
    distances = np.hypot(*(log.mocap[:, :, :2] - TARGETS).T).T
    assert compute_errors_at(log, time_s[:9]) == pytest.approx(distances[:9])


@pytest.fixture(scope="module")
def log():
    log = three_robots()
    valid = log.valid.copy()
    valid[100:110, 1] = False  # the cameras lose a robot
    return estimated(replace(log, valid=valid))


def estimated(log, **more):
    """The trial with an estimate at each step that comes nearer to 5 % above the spec."""
    setup = log.start.setup

    def estimate(k):
        share = 0.05 * (1 - 0.5**k)
        a = setup.a * (1 + share)
        speed = setup.speed * (1 + share)
        return Estimate(a, 0.1 * a / (k + 1), speed, 0.1 * speed / (k + 1), **more)

    steps = tuple(
        replace(step, plan=replace(step.plan, estimate=estimate(step.k))) for step in log.steps
    )
    return replace(log, steps=steps)


def test_a_robot_that_was_never_seen_has_no_times(log):
    (axes,) = trajectory_figure([log]).axes
    poses = log.mocap.copy()
    poses[:, 0] = np.nan
    unseen = replace(log, mocap=poses, valid=np.isfinite(poses[..., 0]))
    (axes_without,) = trajectory_figure([unseen]).axes
    assert len(axes.texts) > 0
    assert len(axes_without.texts) == 2 / 3 * len(axes.texts)  # of two robots of three


def test_the_trajectory_shows_arena_trails_and_errors(log):
    figure = trajectory_figure([log])
    (axes,) = figure.axes
    assert axes.get_aspect() == 1
    assert axes.get_xlim() == (600, 2200)
    assert axes.get_ylim() == (350, 2150)
    for robot in range(3):
        (trail,) = lines(axes, gid=f"trail-{robot}")
        tracked = log.valid[:, robot]
        assert np.array_equal(trail.get_xydata()[tracked], log.mocap[tracked, robot, :2])
        assert np.isnan(trail.get_xydata()[~tracked]).all()
        assert trail.get_color() == [GREEN, BLUE, RED][robot]
    text = words(figure)
    for part in ("x [mm]", "y [mm]", f"total {log.result.total_error:.1f}", "start", "target"):
        assert part in text
    for robot, error in zip(log.experiment.robots, log.result.robot_errors, strict=True):
        assert f"{robot.name}: {error:.1f}" in text
    assert "true path" not in text


def test_robots_that_leave_the_arena_or_end_outside_stay_in_the_picture(log):
    mocap = log.mocap.copy()
    mocap[200:300, 1, 0] = 100
    final = replace(log.result.verdict.final, y=np.array([800.0, 1200.0, 2600.0]))
    result = replace(log.result, verdict=replace(log.result.verdict, final=final))
    cells = experiment(units={"length": "um"}).setup
    start = replace(log.start, setup=cells)
    figure = trajectory_figure([replace(log, mocap=mocap, result=result, start=start)])
    (axes,) = figure.axes
    assert axes.get_xlim()[0] < 100
    assert axes.get_xlim()[1] == 2200
    assert axes.get_ylim()[0] == 350
    assert axes.get_ylim()[1] > 2600
    assert "x [µm]" in words(figure)


def test_the_convergence_figure_marks_the_stop(log):
    figure = draw("convergence", [log])
    (first,) = figure.axes
    best = log.steps[0].plan.search
    (curve,) = lines(first, marker="*")
    assert np.array_equal(curve.get_ydata(), best.history)
    assert first.get_yscale() == "log"
    (stop,) = lines(first, marker="o")
    assert stop.get_xydata().tolist() == [[len(best.history) - 1, best.history[-1]]]
    faint = lines(first, color=style.FAINT)
    assert len(faint) == len(log.steps[0].plan.searches) - 1
    assert f"at iteration {len(best.history) - 1} (criterion)" in words(figure)


def test_the_error_figure_shows_total_robots_tolerance_and_misses(log):
    late = replace(log.steps[7], deadline_missed=True)
    figure = draw("errors", [replace(log, steps=(*log.steps[:7], late, *log.steps[8:]))])
    of_total, of_robots = figure.axes
    assert [line.get_gid() for line in of_robots.lines[:3]] == [f"robot-{i}" for i in range(3)]
    labels = [line.get_label() for line in of_robots.lines[3:]]
    assert labels == ["arrival within 20 mm", "deadline missed"]
    assert (of_total.get_ylim()[0], of_robots.get_ylim()[0]) == (0, 0)
    misses = of_robots.lines[-1].get_xdata()
    assert late.command.sent_ns / 1e9 in np.asarray(misses)
    total = np.asarray(of_total.lines[0].get_ydata())
    tracked = log.valid.all(axis=1)
    gap = np.linalg.norm(log.mocap[..., :2] - TARGETS, axis=-1)
    assert total[tracked] == pytest.approx(gap.sum(axis=1)[tracked])


@pytest.mark.long
def test_solve_times_are_shown_next_to_the_period_and_only_misses_as_alarms(log):
    missed = 3
    first = replace(log.steps[0], solve_ns=900_000_000)  # it may take longer than a period
    late = [replace(step, deadline_missed=True) for step in log.steps[1 : 1 + missed]]
    rest = [replace(step, deadline_missed=False) for step in log.steps[1 + missed :]]
    figure = draw("over-time", [replace(log, steps=(first, *late, *rest))])
    text = words(figure)
    assert f"{missed} of {len(log.steps)} deadlines missed" in text
    assert "half within" in text
    assert "control period 200 ms" in text
    assert "first plan" in text
    (late,) = lines(figure.axes[1], color=style.ALARM)
    assert len(late.get_xdata()) == missed
    in_time = draw("over-time", [replace(log, steps=(first, *rest))])
    assert style.ALARM not in {line.get_color() for axes in in_time.axes for line in axes.lines}
    assert f"0 of {1 + len(rest)} deadlines missed" in words(in_time)


@pytest.mark.long
def test_the_direction_turns_through_pi_without_a_line_across(log):
    sent = (3.0, -3.0, -0.5)  # rad: from the first to the second it turns by 0.28
    steps = tuple(
        replace(step, command=replace(step.command, action=Steer(direction)))
        for step, direction in zip(log.steps, sent, strict=False)
    )
    direction = draw("over-time", [replace(log, steps=steps)]).axes[0]
    (line,) = direction.lines
    drawn = np.asarray(line.get_ydata())
    assert np.flatnonzero(np.isnan(drawn)).tolist() == [2]  # after the first is held
    assert [tick.get_text() for tick in direction.get_yticklabels()][::2] == ["−π", "0", "π"]


@pytest.mark.long
def test_over_time_shows_what_was_estimated(log):
    figure = draw("over-time", [log])
    _, _, a, speed = figure.axes
    (green,) = lines(a, gid="robot-0")
    assert np.asarray(green.get_ydata())[[0, 1]] == pytest.approx([0, 2.5])
    assert len(green.get_ydata()) == len(log.steps)
    assert len(speed.collections) == 3  # bands
    text = words(figure)
    assert "green 6.3 (true " in text
    assert "true value" in text
    assert "one standard deviation" in text


@pytest.mark.long
@pytest.mark.parametrize("kind", FIGURES.builtin)
def test_no_text_hides_another_dashes_are_in_the_legend_and_the_plant_is_named(log, kind):
    info = PlantInfo("lab", False, 120.0, {"emulated": "camera"})
    figure = draw(kind, [replace(log, start=replace(log.start, plant=info))])
    assert overlapping(figure) == []
    text = words(figure)
    assert "emulated lab" in text
    assert "aborted" not in text
    dashed = [line for axes in figure.axes for line in axes.lines if line.is_dashed()]
    legends = [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]
    keys = {line.get_linestyle() for legend in legends for line in legend.get_lines()}
    assert {line.get_linestyle() for line in dashed} <= keys


def test_names_stand_beside_their_panel_in_the_order_of_the_last_values(log):
    _, of_robots = draw("errors", [log]).axes
    names = [text.get_text().split()[0] for text in of_robots.get_legend().get_texts()]
    falling = np.argsort(log.result.robot_errors)[::-1]
    assert names == [log.start.setup.names[robot] for robot in falling]


def test_the_figure_by_which_the_folder_explains_itself_can_be_drawn(log, monkeypatch, tmp_path):
    text = figures.__doc__.partition("This is a whole figure:\n")[2].partition("\n`TrialLog`")[0]
    (tmp_path / "apart.py").write_text(cleandoc(text))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(FIGURES.builtin, "apart", "apart:apart_figure")
    figure = draw("apart", [log])
    (axes,) = figure.axes
    (second,) = lines(axes, gid="robot-1")
    gaps = np.hypot(*(log.mocap[:, 1, :2] - log.mocap[:, 0, :2]).T)
    seen = log.valid[:, 1]
    assert np.asarray(second.get_ydata())[seen] == pytest.approx(gaps[seen])
    assert not np.isfinite(np.asarray(second.get_ydata())[~seen]).any()
    assert overlapping(figure) == []


def refusals():
    """What cannot be drawn: the kind, the logs that a log becomes, the error and its text."""

    def moved(log, **fields):
        return [replace(log, result=replace(log.result, **fields))]

    def in_um(log):
        cells = experiment(units={"length": "um"})
        start = replace(log.start, setup=cells.setup)
        return [log, replace(log, experiment=cells, start=start)]

    def other(log, **fields):
        return replace(log, experiment=experiment(**fields))

    def arms(log):
        return [replace(log, log=f"arm-{i}/trial-000.mcap") for i in range(13)]

    for kind in COURSES:
        if kind != "trajectory":
            yield kind, lambda log: [cut_short(log, 0)], LogError, "contains no"
    for kind in ALONE:
        yield kind, lambda log: [log, log], UsageError, "single trial"
    for kind in ("trajectory", "errors"):
        yield kind, lambda log: [log, other(log, obstacles=[])], UsageError, "different experiments"
    yield "errors", arms, UsageError, "there are 13 folders, but this figure"
    yield "batch", lambda log: moved(log, outcome=Outcome.ABORTED), LogError, "no complete trial"
    yield "batch", in_um, UsageError, "mm and um"


def chose(log, order):
    """The trial as one that chose its robots by a rule, which assigns the targets in some order."""
    goals = [robot["target"] for robot in THREE_M3PI["robots"]]
    rule = MarkedRobots(marks=goals, found=True)
    robots = [
        {**robot, "target": goals[i]} for robot, i in zip(THREE_M3PI["robots"], order, strict=True)
    ]
    spec = experiment(robots=robots, chosen=rule)
    return replace(log, experiment=spec, start=replace(log.start, setup=spec.setup))


@pytest.mark.long
def test_trials_that_chose_their_robots_by_one_rule_are_drawn_together(log):
    logs = [chose(log, (0, 1, 2)), chose(log, (1, 0, 2))]
    for kind in SEVERAL:
        draw(kind, logs)
    figure = draw("trajectory", logs)
    totals = [log.start.setup.distances(log.result.verdict.final.xy).sum() for log in logs]
    mean_and_spread = f"total {np.mean(totals):.0f} ± {np.std(totals, ddof=1):.0f}"
    assert mean_and_spread in words(figure)
    (axes,) = figure.axes
    targets = lines(axes, marker="s")
    assert [len(line.get_xydata()) for line in targets] == [2, 2, 2]
    assert {line.get_markeredgecolor() for line in targets} == {style.GREY}
    with pytest.raises(UsageError, match="different experiments"):
        draw("trajectory", [logs[0], log])


@pytest.mark.parametrize(("kind", "changed", "error", "why"), list(refusals()))
def test_what_cannot_be_drawn_is_told(log, kind, changed, error, why):
    with pytest.raises(error, match=why):
        draw(kind, changed(log))


@pytest.mark.long
def test_drawing_leaves_matplotlib_as_it_was_and_opens_no_window(log):
    before = dict(matplotlib.rcParams)
    figure = draw("over-time", [log])
    assert dict(matplotlib.rcParams) == before
    assert figure.canvas.manager is None


@pytest.mark.long
def test_the_errors_of_a_batch_end_as_the_results_say():
    logs = [three_robots(seed) for seed in (1, 2, 3)]
    of_total, of_robots = draw("errors", logs).axes
    trials = lines(of_total, gid="trial")
    ends = [end_of(line) for line in trials]
    assert ends == pytest.approx([trial.result.total_error for trial in logs if trial.result])
    (median,) = lines(of_total, gid="median")
    assert end_of(median) == pytest.approx(np.median(ends))
    assert len(of_total.collections) == 1
    assert len(of_robots.collections) == 3  # a band a robot
    starts = [float(np.asarray(line.get_ydata())[0]) for line in trials]
    assert starts == pytest.approx([sum(np.hypot([800] * 3, [300, 300, 400]))] * 3, rel=0.01)


def test_the_convergence_figures_legends_cover_no_data(log):
    """Regression: that of the searches of each step stood over the last steps."""
    figure = draw("convergence", [log])
    figure.canvas.draw()
    for axes in figure.axes[:2]:
        assert axes.get_legend().get_window_extent().y0 >= axes.get_window_extent().y1 - 2


@pytest.mark.parametrize(("error_mm", "is_drawn"), [(20.0, False), (200.0, True)])
def test_an_error_is_dotted_where_the_signs_of_end_and_target_do_not_cover_it(
    log, error_mm, is_drawn
):
    """Regression: the legend named a dotted line that was covered."""
    final = Poses(TARGETS[:, 0] + error_mm, TARGETS[:, 1], np.zeros(3))
    result = replace(log.result, verdict=replace(log.result.verdict, final=final))
    figure = trajectory_figure([replace(log, result=result)])
    dotted = lines(figure.axes[0], linestyle=":")
    assert len(dotted) == 3 * is_drawn
    assert ("error: end to target" in words(figure)) == is_drawn
