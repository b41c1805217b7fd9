"""Tests of the commands integrated over each step of a robot, against numerical integration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_identify.driven_steps import DrivenTrack
from tetractl_identify.pose_steps import PoseSteps

POSE_S = np.array([1.0, 1.13, 1.3, 1.42, 1.9])
SENT_S = np.array([0.2, 0.9, 1.05, 1.25, 1.6])
COMMANDS = np.array([[100.0, 0.5], [0.0, 0.0], [200.0, -1.0], [150.0, 2.0], [50.0, 0.0]])


def track(pose_s=POSE_S, sent_s=SENT_S, commands=COMMANDS):
    steps = PoseSteps.between(pose_s, np.zeros((len(pose_s), 3)))
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
