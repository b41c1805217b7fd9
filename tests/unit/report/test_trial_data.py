"""Tests of which numbers of a trial the player of a page gets."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.random_trials import SMALL, trial, write_and_read

from tetractl.core.clock import SECOND
from tetractl.core.setup import Bounds
from tetractl.log.write.encoder import SHOWN_HZ
from tetractl.report.trial_data import round_to_lists, trial_data
from tetractl.view.player import find_end_ns


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A simulated log of six control steps with a frame every 8.3 ms."""
    made = trial(steps=6, **SMALL | {"frames": 24})
    return write_and_read(made, tmp_path_factory.mktemp("log") / "t.mcap")


@given(st.lists(st.floats(-1e4, 1e4) | st.sampled_from([np.nan, np.inf, -np.inf]), max_size=6))
def test_numbers_are_rounded_and_what_is_not_finite_is_missing(values):
    for value, number in zip(values, round_to_lists(values, 2), strict=True):
        if np.isfinite(value):
            assert abs(number - value) <= 0.005 + 1e-9
            assert number == float(f"{number:.2f}")
        else:
            assert number is None
    assert round_to_lists([values], 2) == [round_to_lists(values, 2)]


def test_frames_are_shown_at_most_15_times_a_second_with_the_first_and_the_last(log):
    data = trial_data(log, "t")["frames"]
    shown = [time for time in log.frames_s.round(3) if time in data["t"]]
    assert data["t"] == shown
    assert data["t"][0] == pytest.approx(log.frames_s[0], abs=1e-3)
    until = log.mocap_ns <= find_end_ns(log)
    assert data["t"][-1] == pytest.approx(log.frames_s[until][-1], abs=1e-3)
    slots = np.floor((np.array(data["t"]) - data["t"][0]) * SHOWN_HZ + 1e-6)
    assert len(set(slots[:-1])) == len(slots) - 1
    assert len(slots) >= np.ptp(log.frames_s[until]) * SHOWN_HZ
    assert len(data["xy"]) == len(data["heading"]) == len(data["t"])


def test_a_lab_is_shown_from_a_period_before_its_first_direction(log):
    """Before, its robots are placed."""
    placing_ns = 20 * SECOND
    later = replace(
        log,
        commands=tuple(replace(c, sent_ns=c.sent_ns + placing_ns) for c in log.commands),
        steps=tuple(
            replace(s, command=replace(s.command, sent_ns=s.command.sent_ns + placing_ns))
            for s in log.steps
        ),
        mocap_ns=log.mocap_ns + placing_ns,
        received_ns=log.received_ns + placing_ns,
        stop=replace(log.stop, sent_ns=log.stop.sent_ns + placing_ns),
    )
    before_ns = np.arange(0, placing_ns, SECOND // 10)
    waiting = replace(
        later,
        mocap_ns=np.concatenate([before_ns, later.mocap_ns]),
        mocap=np.concatenate([np.zeros((len(before_ns), 2, 3)), later.mocap]),
        valid=np.concatenate([np.ones((len(before_ns), 2), bool), later.valid]),
        frames=np.arange(len(before_ns) + len(later.frames)),
    )
    times = trial_data(waiting, "t")["frames"]["t"]
    period_s = log.start.setup.period_s
    began_s = (later.began_ns - placing_ns) / SECOND
    assert -period_s - began_s - 0.001 <= times[0] <= -period_s + 0.1


def test_a_robot_that_was_not_tracked_has_no_place_and_no_heading(log):
    valid = log.valid.copy()
    valid[0, 1] = False
    data = trial_data(replace(log, valid=valid), "t")["frames"]
    assert data["xy"][0][1] == [None, None]
    assert data["heading"][0][1] is None
    assert data["xy"][0][0] == pytest.approx(log.mocap[0, 0, :2], abs=1e-3)
    assert data["heading"][0][0] == pytest.approx(log.mocap[0, 0, 2], abs=1e-3)


@pytest.mark.parametrize(
    ("side", "decimals"), [(1800.0, 3), (1000.0, 4), (999.0, 4), (1.5, 6), (0.2, 7)]
)
def test_lengths_have_seven_digits_of_the_arena_and_plans_four(log, side, decimals):
    setup = log.start.setup
    arena = Bounds(3.0, 4.0, 3.0 + side / 2, 4.0 + side)
    small = replace(log, start=replace(log.start, setup=replace(setup, arena=arena)))
    data = trial_data(small, "t")
    final = log.result.verdict.final.xy
    assert data["final"]["xy"] == [[round(x, decimals) for x in row] for row in final.tolist()]
    (path,) = data["plan"][:1]
    expected = np.round(log.steps[0].plan.path[..., :2], decimals - 3)
    assert np.array(path) == pytest.approx(expected)


def test_robots_have_their_colour_start_way_points_and_target(log):
    setup = log.start.setup
    way_points = np.stack([setup.targets - 9, setup.targets - 5])
    routed = replace(log, start=replace(log.start, setup=replace(setup, way_points=way_points)))
    for i, robot in enumerate(trial_data(routed, "t")["robots"]):
        assert robot["name"] == setup.names[i]
        assert robot["target"] == setup.targets[i].tolist()
        assert robot["via"] == [(setup.targets[i] - 9).tolist(), (setup.targets[i] - 5).tolist()]
        assert robot["color"].startswith("#")
        assert robot["start"] == log.positions[0, i].tolist()


def test_a_log_that_ends_early_says_so_and_has_no_final_poses(log):
    data = trial_data(replace(log, result=None), "t")
    assert data["outcome"] == "the log ends early"
    assert data["final"] is None
    assert data["reason"] is None
    whole = trial_data(log, "t")
    assert whole["outcome"] == "sequence completed"
    assert whole["reason"] == "no signal left"
    unexplained = replace(log, result=replace(log.result, reason=""))
    assert trial_data(unexplained, "t")["reason"] == "every signal was sent"


def test_without_plans_a_page_has_neither_plans_nor_searches_nor_pictures(log):
    data = trial_data(log, "t", plans=False)
    assert data["plan"] is data["history"] is data["dish"] is None
    whole = trial_data(log, "t")
    assert len(whole["plan"]) == len(whole["history"]) == len(log.steps)
    assert whole["dish"] is None  # only a microscope has pictures


def test_steps_have_times_directions_and_solve_times_in_milliseconds(log):
    steps = trial_data(log, "t")["steps"]
    assert steps["t"] == pytest.approx(log.steps_s, abs=1e-3)
    assert steps["u"] == [step.command.direction for step in log.steps]
    assert steps["solve_ms"] == pytest.approx([s.solve_ns / 1e6 for s in log.steps], rel=1e-3)
    assert steps["signals"] == [len(step.plan.signals) for step in log.steps]
    assert steps["cost"] == pytest.approx([step.plan.cost for step in log.steps], rel=1e-3)


def test_the_hold_has_its_radius_and_no_hold_has_none(log):
    assert trial_data(log, "t")["hold"] == 0
