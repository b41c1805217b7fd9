"""The parts of the trajectory figure: its limits, times, ticks, true paths and title."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from testkit.trials import cut_short, three_robots

from tetractl.core.clock import SECOND
from tetractl.core.setup import Bounds
from tetractl.view.figures.trajectory import (
    FAR_OUTSIDE_MAX,
    MARGIN,
    MARKED_FRACTION_MAX,
    NAMED_MAX,
    TICK,
    TIMES_MAX,
    TRUTH_DISTANCE_MIN,
    _choose_marked_times,
    _compose_heading,
    _create_titled_figure,
    _find_visible_truth,
    _mark_time,
    _mean_and_std,
    _round_step,
    _set_limits,
)
from tetractl.view.figures.trials import find_final_poses

pytestmark = pytest.mark.slow

ARENA = Bounds(100.0, 200.0, 600.0, 500.0)
SIDE = 500.0


@pytest.fixture(scope="module")
def log():
    return three_robots()


@given(st.floats(1e-3, 1e6), st.integers(2, 12))
def test_a_step_is_the_smallest_round_number_that_gives_few_parts(length, parts_max):
    step = _round_step(length, parts_max)
    assert length / step <= parts_max * (1 + 1e-9)
    power = 10.0 ** math.floor(math.log10(step) + 1e-9)
    digit = step / power
    assert digit == pytest.approx(round(digit))
    assert round(digit) in (1, 2, 5)
    smaller = step * {1: 0.5, 2: 0.5, 5: 0.4}[round(digit)]
    assert length / smaller > parts_max * (1 - 1e-9)


@pytest.mark.parametrize(
    ("errors", "text"),
    [
        ([3.0], "3.00"),
        ([9.0, 10.0, 10.0], "9.67 ± 0.58"),
        ([9.0, 11.0], "10.0 ± 1.4"),
        ([99.0, 101.0], "100 ± 1"),
        ([250.0], "250"),
    ],
)
def test_a_mean_has_three_digits_and_the_deviation_of_a_sample(errors, text):
    assert _mean_and_std(np.array(errors)) == text


@pytest.mark.parametrize(
    ("path", "limits"),
    [
        ([[100, 200], [600, 500]], (100, 600, 200, 500)),
        ([[90, 300], [np.nan, -900]], (90 - MARGIN * SIDE, 600, 200, 500)),
        ([[300, 510]], (100, 600, 200, 510 + MARGIN * SIDE)),
        ([[1e6, 150]], (100, 600 + FAR_OUTSIDE_MAX * SIDE, 150 - MARGIN * SIDE, 500)),
        (
            [[300, -1e6], [300, 1e6]],
            (100, 600, 200 - FAR_OUTSIDE_MAX * SIDE, 500 + FAR_OUTSIDE_MAX * SIDE),
        ),
    ],
)
def test_the_limits_contain_the_arena_and_all_paths_but_no_outlier(path, limits):
    axes = Figure().add_subplot()
    leaves = _set_limits(axes, ARENA, [np.array([[300.0, 300.0]]), np.array(path, float)])
    assert (*axes.get_xlim(), *axes.get_ylim()) == pytest.approx(limits)
    assert leaves == (limits != (100, 600, 200, 500))
    assert len(axes.patches) == leaves  # the arena's edge


def test_few_round_times_are_marked_before_the_end(log):
    times_s = _choose_marked_times(log)
    end_s = log.elapsed_s(int(log.mocap_ns[-1]))
    assert 2 <= len(times_s) <= TIMES_MAX
    assert np.diff(times_s) == pytest.approx(times_s[0])
    assert times_s[-1] < MARKED_FRACTION_MAX * end_s <= times_s[-1] + times_s[0]


def test_no_time_is_marked_without_a_frame_after_the_first_direction(log):
    assert _choose_marked_times(replace(log, mocap_ns=log.mocap_ns[:0])) == []
    before = log.mocap_ns[:5] - log.mocap_ns[5] + log.began_ns
    assert _choose_marked_times(replace(log, mocap_ns=before)) == []


def test_a_tick_points_along_the_heading_and_its_time_is_to_the_left(log):
    axes = Figure().add_subplot()
    time_s = 1.0
    _mark_time(axes, log, 1, "red", time_s)
    frame = np.flatnonzero(log.mocap_ns >= log.began_ns + time_s * SECOND - 1)[0]
    x, y, heading = log.mocap[frame, 1]
    tick, dot = axes.lines
    ahead = TICK * log.start.setup.arena.longer_side
    tip = [x + ahead * math.cos(heading), y + ahead * math.sin(heading)]
    assert tick.get_xydata() == pytest.approx(np.array([[x, y], tip]))
    assert dot.get_xydata() == pytest.approx(np.array([[x, y]]))
    (label,) = axes.texts
    assert label.get_text() == "1 s"
    aside = np.array(label.xyann)
    along = np.array([math.cos(heading), math.sin(heading)])
    assert aside @ along == pytest.approx(0)
    assert along[0] * aside[1] - along[1] * aside[0] > 0


def test_no_tick_is_drawn_where_a_robot_was_not_seen(log):
    axes = Figure().add_subplot()
    unseen = replace(log, valid=np.zeros_like(log.valid))
    _mark_time(axes, unseen, 1, "red", 1.0)
    assert not axes.lines
    assert not axes.texts


@pytest.mark.parametrize(("share", "is_shown"), [(0.9, False), (1.1, True)])
def test_a_true_path_is_shown_if_one_pose_is_visibly_elsewhere(log, share, is_shown):
    truth = log.mocap.copy()
    truth[7, 2, 1] -= share * TRUTH_DISTANCE_MIN * log.start.setup.arena.longer_side
    shown = _find_visible_truth(replace(log, truth=truth))
    assert (shown is not None) == is_shown
    if is_shown:
        assert np.array_equal(shown, truth[..., :2])
    assert _find_visible_truth(replace(log, truth=None)) is None


def test_the_means_of_a_title_leave_out_trials_that_were_not_completed(log):
    far = find_final_poses(log)[:, :2]
    off = far + [[300.0, 0.0]] * 3
    error = log.start.setup.distances(far)
    cut = replace(cut_short(log, 5), log=log.log)
    title, entries = _compose_heading([log, cut], np.array([far, off]))
    assert title.startswith("2 trials")
    assert title.endswith(f"total {_mean_and_std(error.sum(keepdims=True))}")
    pairs = zip(log.start.setup.names, error, strict=True)
    assert entries == [f"{n}: {e:.{1 if e >= 10 else 2}f}" for n, e in pairs]


def test_trials_of_several_folders_have_no_mean(log):
    logs = [replace(log, log=f"{folder}/0.mcap") for folder in "ab"]
    ends = np.array([find_final_poses(log)[:, :2]] * 2)
    title, entries = _compose_heading(logs, ends)
    assert title == "2 trials of 2 folders"
    assert entries == list(log.start.setup.names)


def test_the_axes_keep_the_shape_of_the_arena_within_limits_and_entries_find_room():
    def height(arena, entries=()):
        return _create_titled_figure(arena, "title", list(entries), ["red"] * 40).get_figheight()

    square = height(Bounds(0, 0, 100, 100))
    tall = height(Bounds(0, 0, 100, 150))
    assert tall > square > height(Bounds(0, 0, 150, 100))
    assert height(Bounds(0, 0, 1, 900)) == height(Bounds(0, 0, 1, 1800))
    assert height(Bounds(0, 0, 900, 1)) == height(Bounds(0, 0, 1800, 1))
    arena = Bounds(0, 0, 100, 100)
    few = height(arena, ["green: 1.0"] * 3)
    many = height(arena, ["green: 1.0"] * NAMED_MAX)
    assert few < many < height(arena, ["a name of some length: 1.0"] * NAMED_MAX)
