"""Tests of the commands integrated over each step of a robot, against numerical integration."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_identify.driven_steps import (
    ASSUMED_LAG_S,
    STEP_S,
    DrivenTrack,
    choose_steps,
    select_driven_track,
)
from tetractl_identify.identify import INTERVALS_MIN
from tetractl_identify.pose_steps import PoseSteps
from tetractl_identify.tracks import Track

from tetractl.core.errors import UsageError

POSE_S = np.array([1.0, 1.13, 1.3, 1.42, 1.9])
SENT_S = np.array([0.2, 0.9, 1.05, 1.25, 1.6])
COMMANDS = np.array([[100.0, 0.5], [0.0, 0.0], [200.0, -1.0], [150.0, 2.0], [50.0, 0.0]])


def track(pose_s=POSE_S, sent_s=SENT_S, commands=COMMANDS):
    steps = PoseSteps.from_poses(pose_s, np.zeros((len(pose_s), 3)))
    return DrivenTrack(pose_s, steps, sent_s, commands, two_clocks=False)


def followed(acting_s, lag):
    """The integrals of rates that follow the commands with a lag, by small steps from the first."""
    dt = 1e-4
    times = np.arange(SENT_S[0], acting_s.max() + dt, dt)
    rate = COMMANDS[0].copy()
    total = np.zeros((len(times), 2))
    for k in range(1, len(times)):
        command = COMMANDS[np.searchsorted(SENT_S, times[k - 1] + dt / 2, side="right") - 1]
        after = command + (rate - command) * np.exp(-dt / lag)
        total[k] = total[k - 1] + (rate + after) / 2 * dt
        rate = after
    ends = np.column_stack([np.interp(acting_s, times, total[:, i]) for i in range(2)])
    return np.diff(ends, axis=0)


@pytest.mark.parametrize("lag", [0.03, 0.2])
@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_the_integrals_are_those_of_rates_that_follow_with_a_lag(lag, drift):
    dead_time = 0.15
    middle_s = (POSE_S[0] + POSE_S[-1]) / 2
    expected = followed(POSE_S - dead_time + drift * (POSE_S - middle_s), lag)
    assert track().integrals(dead_time, lag, drift) == pytest.approx(expected, abs=0.02)


@given(st.floats(0, 1.5))
def test_without_a_lag_the_integrals_are_of_the_commands_themselves(dead_time):
    acts = track().acts(dead_time)
    integrals = track().integrals(dead_time, 1e-6)
    assert integrals[acts] == pytest.approx(track().sent(dead_time)[acts], abs=1e-3)


def test_a_constant_command_is_its_rate_times_the_time():
    steady = np.tile([[120.0, 0.7]], (len(SENT_S), 1))
    expected = np.outer(np.diff(POSE_S), [120.0, 0.7])
    assert track(commands=steady).integrals(0.1, 0.3) == pytest.approx(expected)
    sent = track(commands=steady).sent(0.1)
    assert sent[:3] == pytest.approx(expected[:3])
    until_the_last_command = SENT_S[-1] + 0.1 - POSE_S[-2]
    assert sent[3] == pytest.approx(until_the_last_command * np.array([120.0, 0.7]))


def test_commands_act_in_the_steps_between_the_first_and_the_last():
    assert track().acts(0.0).tolist() == [True, True, True, False]
    assert track().acts(0.4).tolist() == [True, True, True, True]
    assert track().acts(0.9).tolist() == [False, True, True, True]
    assert track().duration_s == pytest.approx(0.9)


def test_without_commands_nothing_was_sent():
    nothing = track(sent_s=np.empty(0), commands=np.empty((0, 2)))
    assert (nothing.integrals(0.1, 0.1) == 0).all()
    assert (nothing.sent(0.1) == 0).all()
    assert not nothing.acts(0.1).any()
    assert nothing.sent(0.1).shape == (len(POSE_S) - 1, 2)


# which steps of a robot are used

RATE_HZ = 20
SENT_EVERY_S = 0.5
SECONDS = 40.0
TRUE_DELAY_S = 0.25


def commands_of(seed):
    """Speeds and turning rates that jump twice a second."""
    rng = np.random.default_rng(seed)
    sent_s = np.arange(0, SECONDS, SENT_EVERY_S)
    return sent_s, rng.uniform((40, -1.5), (160, 1.5), (len(sent_s), 2))


def driven(seed=1, delay_s=TRUE_DELAY_S, clock_s=0.0, two_clocks=False, change=None, **fields):
    """A robot that follows its commands at once after a delay; poses without noise."""
    sent_s, commands = commands_of(seed)
    dt = 1 / (10 * RATE_HZ)
    times = np.arange(0, SECONDS, dt)
    newest = np.maximum(np.searchsorted(sent_s, times - delay_s, side="right") - 1, 0)
    speed, rate = commands[newest].T
    heading = np.concatenate([[0], np.cumsum(rate * dt)[:-1]])
    middle = heading + rate * dt / 2
    x = np.concatenate([[0], np.cumsum(speed * np.cos(middle) * dt)[:-1]])
    y = np.concatenate([[0], np.cumsum(speed * np.sin(middle) * dt)[:-1]])
    poses = np.column_stack([x, y, heading])[::10, None].copy()
    if change is not None:
        change(poses[:, 0])
    made = {
        "source": "p.csv",
        "origin": "CSV",
        "unit": "mm",
        "names": ("one",),
        "time_s": times[::10],
        "poses": poses,
        "valid": np.ones((len(poses), 1), dtype=bool),
        "sent_s": sent_s + clock_s,
        "direction_rad": np.full(len(sent_s), np.nan),
        "stop_s": SECONDS,
        "twists": commands[:, None],
        "has_two_clocks": two_clocks,
    }
    return select_driven_track(Track(**(made | fields)), 0)


def test_a_robots_track_has_steps_of_a_tenth_of_a_second_and_its_commands():
    one = driven()
    assert np.diff(one.pose_s).min() >= STEP_S - 1e-6
    assert np.diff(one.pose_s).max() == pytest.approx(0.1)
    assert len(one.steps.turn_rad) == len(one.pose_s) - 1
    assert one.commands.shape == (len(one.sent_s), 2)


def test_commands_that_a_robot_did_not_receive_and_poses_that_it_lacks_are_left_out():
    sent_s, commands = commands_of(1)
    commands[3] = np.nan
    commands[5, 1] = np.nan
    valid = np.ones((round(SECONDS * RATE_HZ), 1), dtype=bool)
    valid[100:120] = False
    one = driven(twists=commands[:, None], valid=valid)
    assert set(sent_s) - set(one.sent_s) == {sent_s[3], sent_s[5]}
    assert not ((one.pose_s > 5.0) & (one.pose_s < 5.95)).any()


@pytest.mark.parametrize("delay_s", [0.1, 0.4, 0.9])
def test_the_search_begins_at_the_delay_after_which_commands_explain_the_motion(delay_s):
    steps = choose_steps("one", [driven(delay_s=delay_s)], 0.1)
    assert steps.dead_time == pytest.approx(delay_s - ASSUMED_LAG_S, abs=0.051)


@pytest.mark.parametrize("clock_s", [-4.0, 3.0])
def test_a_clock_that_is_seconds_off_is_found(clock_s):
    one = driven(clock_s=clock_s, two_clocks=True)
    steps = choose_steps("one", [one], 0.1)
    assert steps.dead_time == pytest.approx(TRUE_DELAY_S - clock_s - ASSUMED_LAG_S, abs=0.051)
    assert steps.drift_unit == pytest.approx(2 * 0.05 / one.duration_s)
    assert choose_steps("one", [driven()], 0.1).drift_unit == 0


def test_all_steps_while_commands_act_are_used():
    one = driven()
    steps = choose_steps("one", [one], 0.1)
    acts = one.acts(steps.dead_time)
    assert steps.left_out == 0
    assert steps.rows.tolist() == np.flatnonzero(acts).tolist()
    assert steps.neighbours.all()
    assert steps.turned == pytest.approx(one.steps.turn_rad[steps.rows])
    assert steps.distance_along == pytest.approx(one.steps.displacement.real[steps.rows])
    assert steps.begin_s == pytest.approx(one.pose_s[:-1][steps.rows])
    assert len(set(steps.block)) == 8
    assert steps.speed == pytest.approx(np.median(np.abs(steps.distance_along) / steps.duration_s))


def shifted(poses):
    poses[400:404] += (500.0, 0.0, 0.0)


def turned_round(poses):
    poses[400:404, 2] += 3.0


@pytest.mark.parametrize(
    ("change", "left_out"),
    [(shifted, [199, 201]), (turned_round, [199, 200, 201])],  # one drives backwards meanwhile
)
def test_a_pose_of_another_body_leaves_out_the_steps_there_and_back(change, left_out):
    steps = choose_steps("one", [driven(change=change)], 0.1)
    assert steps.left_out == len(left_out)
    kept = set(steps.rows.tolist())
    assert not set(left_out) & kept
    assert {198, 202} <= kept
    gaps = np.flatnonzero(~steps.neighbours)
    assert steps.rows[gaps].tolist() == [row - 1 for row in left_out if row - 1 not in left_out]


def test_a_gap_leaves_out_its_step_and_no_other():
    valid = np.ones((round(SECONDS * RATE_HZ), 1), dtype=bool)
    valid[400:412] = False
    steps = choose_steps("one", [driven(valid=valid)], 0.1)
    assert steps.left_out == 0
    assert (~steps.neighbours).sum() == 1
    assert steps.duration_s.max() < 0.5


def test_the_last_step_of_a_track_and_the_first_of_the_next_are_no_neighbours():
    parts = [driven(1), driven(2)]
    steps = choose_steps("one", parts, 0.1)
    first = len(parts[0].steps.turn_rad)
    assert (~steps.neighbours).sum() == 1
    border = np.flatnonzero(~steps.neighbours)[0]
    assert steps.rows[border] < first <= steps.rows[border + 1]


def test_a_robot_that_stands_while_commands_are_0_is_not_used_then():
    sent_s, commands = commands_of(1)
    commands[40:] = 0.0
    one = driven()
    halted = replace(one, commands=commands)
    steps = choose_steps("one", [halted], 0.1)
    assert steps.begin_s.max() < sent_s[40] + 1.5


@pytest.mark.parametrize(("count", "is_enough"), [(25, True), (12, False)])
def test_a_robot_needs_enough_steps(count, is_enough):
    valid = np.zeros((round(SECONDS * RATE_HZ), 1), dtype=bool)
    valid[100 : 100 + 2 * count] = True
    if is_enough:
        assert len(choose_steps("one", [driven(valid=valid)], 0.1).rows) >= INTERVALS_MIN
        return
    with pytest.raises(UsageError, match=r"robot one drives in only 1[12] of the steps") as caught:
        choose_steps("one", [driven(valid=valid)], 0.1)
    assert f"at least {INTERVALS_MIN} steps are needed" in caught.value.hint


def test_speeds_and_rates_in_one_ratio_are_noticed():
    _, commands = commands_of(1)
    circle = replace(driven(), commands=np.column_stack([commands[:, 0], commands[:, 0] / 100]))
    assert choose_steps("one", [circle], 0.1).in_one_ratio
    straight = replace(driven(), commands=commands * [1, 0])
    assert not choose_steps("one", [straight], 0.1).in_one_ratio
    assert not choose_steps("one", [driven()], 0.1).in_one_ratio


def test_integrals_of_both_motions_have_their_own_lags():
    steps = choose_steps("one", [driven()], 0.1)
    both = steps.integrals(0.2, 0.05, 0.3)
    assert both[:, 0] == pytest.approx(steps.tracks[0].integrals(0.2, 0.05)[steps.rows, 0])
    assert both[:, 1] == pytest.approx(steps.tracks[0].integrals(0.2, 0.3)[steps.rows, 1])
    sent = steps.driven(both)
    assert sent.distance_sent is not None
    assert (sent.turn_sent == both[:, 1]).all()
