import io
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from support.trials import cut_short, experiment, three_robots

from tetractl.core.colors import BLUE, GREEN, RED, robot_colors
from tetractl.core.errors import LogError, UsageError
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.kinds import FIGURES, draw
from tetractl.view.figures.trajectory import trajectory_figure


@pytest.fixture
def log() -> TrialLog:
    log = three_robots()
    valid = log.valid.copy()
    valid[100:110, 1] = False  # the cameras lose a robot
    return replace(log, valid=valid)


def words(figure: Figure) -> str:
    """All text of a figure, after drawing it once."""
    figure.savefig(io.BytesIO(), dpi=30)
    found = figure.findobj(matplotlib.text.Text)
    return "\n".join(text.get_text() for text in found if text.get_visible())


def test_the_trajectory_shows_arena_trails_and_errors(log):
    figure = trajectory_figure([log])
    (axes,) = figure.axes
    assert axes.get_aspect() == 1
    assert axes.get_xlim() == (600, 2200)
    assert axes.get_ylim() == (350, 2150)
    for robot in range(3):
        (trail,) = [line for line in axes.lines if line.get_gid() == f"trail-{robot}"]
        seen = log.valid[:, robot]
        assert np.array_equal(trail.get_xydata()[seen], log.mocap[seen, robot, :2])
        assert np.isnan(trail.get_xydata()[~seen]).all()
        assert trail.get_color() == [GREEN, BLUE, RED][robot]
    text = words(figure)
    assert log.result
    for part in ("x [mm]", "y [mm]", f"total {log.result.total_error:.1f}", "start", "target"):
        assert part in text
    for robot, error in zip(log.experiment.robots, log.result.robot_errors, strict=True):
        assert f"{robot.name}: {error:.1f}" in text
    assert "true path" not in text


def test_the_truth_shows_only_where_it_differs(log):
    assert log.truth is not None
    figure = trajectory_figure([replace(log, truth=log.truth + np.array([50, 0, 0]))])
    assert "true path" in words(figure)
    dashed = [line for line in figure.axes[0].lines if line.get_color() == style.INK]
    assert np.array_equal(dashed[0].get_xydata(), log.truth[:, 0, :2] + np.array([50, 0]))


def test_several_trials_lie_over_one_another(log):
    logs = [three_robots(seed) for seed in (1, 2, 3)]
    figure = trajectory_figure(logs)
    trails = [line for line in figure.axes[0].lines if len(line.get_xydata()) > 100]
    assert len(trails) == 9
    totals = np.array([trial.result.total_error for trial in logs if trial.result])
    assert f"3 trials, error at the end [mm], total {totals.mean():.0f}" in words(figure)
    assert f"± {totals.std(ddof=1):.0f}" in words(figure)


def test_trials_of_different_experiments_do_not_mix(log):
    other = replace(log, experiment=experiment(obstacles=[]))
    with pytest.raises(UsageError, match="different experiments"):
        trajectory_figure([log, other])


def test_robots_that_leave_the_arena_stay_in_the_picture(log):
    mocap = log.mocap.copy()
    mocap[200:300, 1, 0] = 100
    low, high = trajectory_figure([replace(log, mocap=mocap)]).axes[0].get_xlim()
    assert low < 100
    assert high == 2200


def test_micrometres_are_written_as_papers_do(log):
    spec = experiment(units={"length": "um"})
    text = words(trajectory_figure([replace(log, start=replace(log.start, setup=spec.setup))]))
    assert "x [µm]" in text


def test_robots_that_end_outside_are_still_in_the_picture(log):
    assert log.result
    final = replace(log.result.verdict.final, y=np.array([800.0, 1200.0, 2600.0]))
    verdict = replace(log.result.verdict, final=final)
    figure = trajectory_figure([replace(log, result=replace(log.result, verdict=verdict))])
    low, high = figure.axes[0].get_ylim()
    assert low == 350
    assert high > 2600


def test_the_convergence_figure_marks_the_stop(log):
    figure = draw("convergence", [log])
    first, gain, count = figure.axes
    best = log.steps[0].plan.search
    (curve,) = [line for line in first.lines if line.get_marker() == "*"]
    assert np.array_equal(curve.get_ydata(), best.history)
    assert first.get_yscale() == "log"
    (stop,) = [line for line in first.lines if line.get_marker() == "o"]
    assert stop.get_xydata().tolist() == [[len(best.history) - 1, best.history[-1]]]
    faint = [line for line in first.lines if line.get_color() == style.FAINT]
    assert len(faint) == len(log.steps[0].plan.searches) - 1
    assert len(gain.lines[-1].get_ydata()) == len(log.steps)
    assert len(count.patches) == len(log.steps)
    assert f"at iteration {len(best.history) - 1} (criterion)" in words(figure)


def test_the_convergence_figure_takes_any_cost(log):
    step = log.steps[0]
    search = replace(step.plan.search, history=np.array([np.inf, 3.0, 0.0]), cost=0.0)
    plan = replace(step.plan, searches=(search,), chosen=0)
    figure = draw("convergence", [replace(log, steps=(replace(step, plan=plan),))])
    text = words(figure)
    assert "at iteration 2" in text
    assert "inf" not in text
    assert "nan" not in text
    (curve,) = [line for line in figure.axes[0].lines if line.get_marker() == "*"]
    assert np.array_equal(curve.get_ydata(), [np.nan, 3.0, np.nan], equal_nan=True)
    assert np.isfinite(figure.axes[0].get_ylim()).all()


def test_the_error_figure_shows_total_robots_tolerance_and_misses(log):
    late = replace(log.steps[7], deadline_missed=True)
    figure = draw("error", [replace(log, steps=(*log.steps[:7], late, *log.steps[8:]))])
    (axes,) = figure.axes
    labels = [line.get_label() for line in axes.lines]
    assert labels == [
        *("total", "green", "blue", "red"),
        *("arrival within 20 mm", "deadline missed"),
    ]
    assert axes.get_ylim()[0] == 0
    misses = axes.lines[-1].get_xdata()
    assert late.command.sent_ns / 1e9 in np.asarray(misses)
    total = np.asarray(axes.lines[0].get_ydata())
    seen = log.valid.all(axis=1)
    gap = np.hypot(*(log.mocap[..., :2] - [(1700, 500), (1700, 1500), (1700, 2000)]).T).T
    assert total[seen] == pytest.approx(gap.sum(axis=1)[seen])


def test_the_timing_figure_counts_misses_against_the_period(log):
    missed = 3
    first = replace(log.steps[0], solve_ns=900_000_000)  # it may take longer than a period
    late = [replace(step, deadline_missed=True) for step in log.steps[1 : 1 + missed]]
    figure = draw("timing", [replace(log, steps=(first, *late, *log.steps[1 + missed :]))])
    text = words(figure)
    assert f"{missed} of {len(log.steps)} deadlines missed" in text
    assert "control period 200 ms" in text
    assert "first plan" in text
    (late,) = [line for line in figure.axes[0].lines if line.get_color() == style.ALARM]
    assert len(late.get_xdata()) == missed


@pytest.mark.slow
@pytest.mark.parametrize("kind", FIGURES.names())
@pytest.mark.parametrize("ending", style.FORMATS)
def test_the_same_log_gives_the_same_bytes(tmp_path, log, kind, ending):
    made = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}.{ending}"
        style.save(draw(kind, [log]), path)
        made.append(path.read_bytes())
    assert made[0] == made[1]
    assert len(made[0]) > 5000


@pytest.mark.parametrize("kind", FIGURES.names())
def test_a_cut_log_is_drawn_as_far_as_it_goes(log, kind):
    assert words(draw(kind, [cut_short(log, 3)]))


@pytest.mark.parametrize("kind", FIGURES.names()[1:])
def test_an_empty_log_says_so(log, kind):
    with pytest.raises(LogError, match="holds no"):
        draw(kind, [cut_short(log, 0)])


def test_an_empty_log_still_shows_the_scene(log):
    assert "target" in words(draw("trajectory", [cut_short(log, 0)]))


@pytest.mark.parametrize("kind", FIGURES.names()[1:])
def test_one_trial_a_figure_but_for_trajectories(log, kind):
    with pytest.raises(UsageError, match="one trial"):
        draw(kind, [log, log])


@pytest.mark.parametrize("name", ["a.foo", "a", "a.png.gz"])
def test_unknown_endings_are_refused(name):
    with pytest.raises(UsageError, match="picture"):
        style.file_format(Path(name))


def test_colours_follow_own_choice_then_name_then_palette():
    robots = experiment().robots
    made = [
        robots[0],
        replace_robot(robots[1], name="r1", color="black"),
        replace_robot(robots[2], name="r2"),
        replace_robot(robots[2], name="r3", color="notacolour"),
    ]
    colors = robot_colors([r.name for r in made], [r.color for r in made])
    assert colors[:2] == [GREEN, "#000000"]
    assert len(set(colors)) == 4


def replace_robot(robot, **changes):
    return robot.model_copy(update={"color": None, **changes})


def test_drawing_leaves_matplotlib_as_it_was_and_opens_no_window(log):
    before = dict(matplotlib.rcParams)
    figure = draw("timing", [log])
    assert dict(matplotlib.rcParams) == before
    assert figure.canvas.manager is None


def robots_figure(logs):
    return Figure(label=f"{len(logs[0].start.setup.names)} robots")


def test_a_figure_of_another_name_is_one_function_and_one_line(log, monkeypatch):
    monkeypatch.setitem(FIGURES.builtin, "robots", f"{__name__}:robots_figure")
    assert draw("robots", [log]).get_label() == "3 robots"
    with pytest.raises(UsageError, match="no figure is called 'pie'") as refused:
        draw("pie", [log])
    assert "robots" in str(refused.value.hint)
