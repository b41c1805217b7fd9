"""Tests of videos of a trial: their length, their motion, and formats that cannot be written."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from testkit import random_trials
from testkit.trials import cut_short, three_robots

from tetractl.core.commands import Stop
from tetractl.core.errors import LogError, UsageError
from tetractl.core.setup import Bounds
from tetractl.view.player import Recording
from tetractl.view.video import (
    LAST_IMAGE_S,
    SCENE_HEIGHT_IN,
    SCENE_WIDTH_IN,
    VideoFrames,
    _choose_speed,
    _create_figure,
    _ErrorCurve,
    _Numbers,
    _Scene,
    check_video_file,
    write_video,
)

pytestmark = pytest.mark.slow

WIDTH = 320
LASTS_S = 1.0  # of the trial


@pytest.fixture(scope="module")
def log():
    return cut_short(three_robots(), 5)


def milliseconds(path):
    """How long each picture of a video stands."""
    with Image.open(path) as video:
        durations_ms = []
        for frame in range(video.n_frames):
            video.seek(frame)
            video.load()
            durations_ms.append(video.info["duration"])
        return durations_ms


@pytest.mark.long
@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_a_video_lasts_as_long_as_the_trial(tmp_path, log, ending):
    said = []
    path = tmp_path / f"video.{ending}"
    assert write_video(log, path, lambda *done: said.append(done), WIDTH) == 1
    total = sum(milliseconds(path)) / 1000
    assert total == pytest.approx(LASTS_S + LAST_IMAGE_S, abs=0.1)
    with Image.open(path) as video:
        assert video.size[0] == WIDTH
        assert video.size[1] % 2 == 0
    assert said[0][0] == 1
    assert said[-1][0] == said[-1][1] == len(said)
    again = tmp_path / f"again.{ending}"
    write_video(log, again, width=WIDTH)
    assert again.read_bytes() == path.read_bytes()


def test_each_picture_shows_its_instant(log):
    frames = VideoFrames(log, WIDTH)
    start, later, start_again = (frames.draw_at(t).copy() for t in (0.0, 0.9, 0.0))
    assert start.shape[1:] == (WIDTH, 3)
    assert np.array_equal(start, start_again)
    assert (start != later).any()
    still = VideoFrames(replace(log, steps=log.steps[:1]), WIDTH)
    assert still.draw_at(0.0).any()


def test_a_long_trial_plays_faster(tmp_path, log, monkeypatch):
    monkeypatch.setattr("tetractl.view.video.DURATION_MAX_S", 0.6)
    path = tmp_path / "video.gif"
    assert write_video(log, path, width=WIDTH) == 2
    assert sum(milliseconds(path)) / 1000 == pytest.approx(LASTS_S / 2 + LAST_IMAGE_S, abs=0.1)


def test_an_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda program: None)
    with pytest.raises(UsageError, match="needs ffmpeg, which is not installed"):
        check_video_file(tmp_path / "video.mp4")


def test_a_video_that_fails_leaves_no_file(tmp_path, log, monkeypatch):
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(LogError, match="No space left"):
        write_video(log, tmp_path / "video.gif", width=WIDTH)
    assert list(tmp_path.iterdir()) == []


# ---- What a picture is composed of ----


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    made = random_trials.trial(steps=6, **random_trials.SMALL)
    return random_trials.write_and_read(made, tmp_path_factory.mktemp("log") / "t.mcap")


@pytest.mark.parametrize(
    ("duration_s", "speed"),
    [(0.0, 1), (60.0, 1), (60.1, 2), (120.0, 2), (121.0, 5), (300.0, 5), (301.0, 10), (601.0, 20)],
)
def test_a_video_lasts_a_minute_at_most(duration_s, speed):
    assert _choose_speed(duration_s) == speed


@pytest.mark.parametrize("sides", [(1600, 1800), (1000, 100), (100, 1000), (7, 7)])
@pytest.mark.parametrize("width", [320, 321, 960])
def test_a_picture_has_even_sides_and_the_arena_its_shape_without_overlapping_the_rest(
    sides, width
):
    arena = Bounds(0.0, 0.0, *map(float, sides))
    figure, scene, curve, words = _create_figure(arena, width)
    pixels = np.array(figure.get_size_inches()) * figure.dpi
    assert pixels == pytest.approx(np.round(pixels))
    assert (np.round(pixels) % 2 == 0).all()
    assert abs(pixels[0] - width) <= 1
    places = [axes.get_position() for axes in (scene, curve, words)]
    inches = figure.get_size_inches()
    shape = [(box.width * inches[0], box.height * inches[1]) for box in places]
    assert shape[0][0] / shape[0][1] == pytest.approx(sides[0] / sides[1])
    assert shape[0][0] <= SCENE_WIDTH_IN + 1e-9 and shape[0][1] <= SCENE_HEIGHT_IN + 1e-9
    assert max(shape[0][0] / SCENE_WIDTH_IN, shape[0][1] / SCENE_HEIGHT_IN) == pytest.approx(1)
    assert places[0].x1 < places[1].x0
    assert places[1].x0 == places[2].x0
    assert places[2].y1 < places[1].y0
    for box in places:
        assert 0 < box.x0 < box.x1 < 1
        assert 0 < box.y0 < box.y1 < 1


def scene_of(log):
    _, axes, _, _ = _create_figure(log.start.setup.arena, WIDTH)
    return _Scene(axes, log, ["red", "blue"])


def test_robots_are_drawn_at_their_poses_with_their_trail_and_plan(made_up):
    scene = scene_of(made_up)
    recording = Recording(made_up)
    moment = recording.moment_at(int(recording.step_ns[3]))
    scene.show(moment)
    for robot, (x, y, heading) in enumerate(moment.poses):
        corners = scene._bodies[robot].get_xy()[:4]
        half = 0.014 * 1800  # of the arena's longer side
        front = corners[0] - (x, y)
        assert np.hypot(*front) == pytest.approx(1.2 * half)
        assert np.arctan2(*front[::-1]) == pytest.approx(math.remainder(heading, math.tau))
        trail = np.column_stack(scene._trails[robot].get_data())
        assert trail[:-1].tolist() == moment.trail[:, robot].tolist()
        assert trail[-1].tolist() == [x, y]
        plan = np.column_stack(scene._plans[robot].get_data())
        assert plan.tolist() == moment.step.plan.path[:, robot, :2].tolist()


def test_at_the_end_no_plan_is_drawn(made_up):
    scene = scene_of(made_up)
    recording = Recording(made_up)
    scene.show(recording.moment_at(recording.end_ns))
    assert [len(plan.get_xdata()) for plan in scene._plans] == [0, 0]


@pytest.mark.parametrize(("radius", "half"), [(None, 25.2), (10.0, 25.2), (90.0, 90.0)])
def test_a_robot_is_as_large_as_its_wheels_are_apart_and_never_invisible(made_up, radius, half):
    setup = replace(made_up.start.setup, wheel_radius=radius)
    scene = scene_of(replace(made_up, start=replace(made_up.start, setup=setup)))
    assert scene._half_length == pytest.approx(half)


def test_long_trails_are_thinned_to_some_hundred_points(made_up):
    scene = scene_of(made_up)
    moment = Recording(made_up).moment_at(int(made_up.mocap_ns[5]))
    for count, shown in ((600, 600), (1199, 1199), (1200, 600), (6000, 600)):
        long = replace(moment, trail=np.zeros((count, 2, 2)))
        scene.show(long)
        assert len(scene._trails[0].get_xdata()) == shown + 1


def test_the_curve_is_coloured_up_to_the_instant(made_up):
    _, _, axes, _ = _create_figure(made_up.start.setup.arena, WIDTH)
    recording = Recording(made_up)
    curve = _ErrorCurve(axes, recording)
    whole = axes.lines[0]
    assert whole.get_xdata().tolist() == made_up.steps_s.tolist()
    assert whole.get_ydata().tolist() == recording.totals.tolist()
    assert axes.get_ylim() == (0, pytest.approx(1.05 * recording.totals.max()))
    assert axes.get_xlim() == (0, made_up.elapsed_s(recording.end_ns))
    moment = recording.moment_at(int(recording.step_ns[2]))
    curve.show(moment)
    x, y = curve.line.get_data()
    assert x.tolist() == [*made_up.steps_s[:3], moment.time_s]
    assert y.tolist() == [*recording.totals[:3], moment.distances.sum()]


def words_at(log, time_ns):
    _, _, _, axes = _create_figure(log.start.setup.arena, WIDTH)
    words = _Numbers(axes, log.start.setup.names, ["red", "blue"])
    moment = Recording(log).moment_at(time_ns)
    words.show(moment)
    return [line.get_text() for line in words.lines], words.arrow.get_data(), moment


def test_the_words_are_the_time_the_plan_and_the_errors(made_up):
    step = made_up.steps[2]
    lines, (x, y), moment = words_at(made_up, step.command.sent_ns)
    time, plan, total, *robots = lines
    assert time == f"{moment.time_s:.1f} s, step 2"
    signals = len(step.plan.signals)
    assert plan == f"{signals} signals planned, J {step.plan.cost:.3g} mm"
    assert total == f"total error {moment.distances.sum():.1f} mm, measured"
    assert [text.rpartition(" mm")[0] for text in robots] == [
        f"{name} {distance:.1f}"
        for name, distance in zip(made_up.start.setup.names, moment.distances, strict=True)
    ]
    tip = x[1] + 1j * y[1]  # of the arrow
    assert tip == pytest.approx(np.exp(1j * step.plan.direction))
    lines, (x, _), _ = words_at(made_up, Recording(made_up).end_ns)
    assert lines[2].endswith("true")
    assert len(x) == 0


def test_before_the_first_step_and_in_a_pause_there_is_no_plan(made_up):
    lines, (x, _), _ = words_at(made_up, made_up.steps[0].command.sent_ns - 1)
    assert lines[1] == ""
    assert "step" not in lines[0]
    assert len(x) == 0
    steps = list(made_up.steps)
    steps[2] = replace(steps[2], plan=replace(steps[2].plan, instead=Stop()))
    paused = replace(made_up, steps=tuple(steps))
    lines, (x, _), _ = words_at(paused, steps[2].command.sent_ns)
    assert lines[1] == ""
    assert lines[0].endswith("step 2")
    assert len(x) == 0
