"""Tests of measured turns, and of the turns that directions ask for, against plain integration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_identify.tracks import SETTLING_S, Track
from tetractl_identify.turn_samples import GAP_MIN_S, TURN_MIN_S, TurnSamples

RATE_RAD_S = 0.7


def track(times, headings, sent=(0.0,), u=(0.0,), until=100.0, **more):
    """A track of one robot with these headings."""
    times = np.asarray(times, dtype=float)
    poses = np.zeros((len(times), 1, 3))
    poses[:, 0, 2] = np.angle(np.exp(1j * np.asarray(headings)))
    fields = {
        "source": "p.csv",
        "origin": "CSV",
        "unit": "mm",
        "names": ("one",),
        "time_s": times,
        "poses": poses,
        "valid": np.ones((len(times), 1), dtype=bool),
        "sent_s": np.asarray(sent, dtype=float),
        "direction_rad": np.asarray(u, dtype=float),
        "stop_s": until,
    }
    return Track(**(fields | more))


def turning(times, **more):
    times = np.asarray(times, dtype=float)
    return track(times, RATE_RAD_S * times, **more)


TIMES = np.arange(0, 400) * 0.03


def test_the_turns_of_a_robot_that_turns_evenly_are_its_rate_times_their_durations():
    turns = TurnSamples.from_track(turning(TIMES), 0)
    assert len(turns.turn_rad) > 150
    assert turns.turn_rad == pytest.approx(RATE_RAD_S * (turns.end_s - turns.begin_s))
    assert (turns.begin_s[1:] == turns.end_s[:-1]).all()
    assert turns.grid_heading_rad[50:100] == pytest.approx(
        RATE_RAD_S * turns.grid_s[50:100], abs=1e-9
    )


def test_turns_begin_when_the_robot_has_settled_and_end_at_the_stop():
    turns = TurnSamples.from_track(turning(TIMES, sent=(2.0,), until=7.0), 0)
    assert turns.begin_s[0] >= 2.0 + SETTLING_S
    assert turns.begin_s[0] == pytest.approx(2.0 + SETTLING_S, abs=0.06)
    assert turns.end_s[-1] <= 7.0
    assert turns.end_s[-1] == pytest.approx(7.0, abs=0.07)


def test_turns_last_no_less_than_their_minimum():
    fast = TurnSamples.from_track(turning(np.arange(0, 2000) * 0.008), 0)
    durations_s = fast.end_s - fast.begin_s
    assert durations_s.min() >= TURN_MIN_S - 1e-6
    assert durations_s.max() < 2 * TURN_MIN_S


def test_measured_turns_and_headings_come_from_different_poses():
    """Noise of every second pose changes the turns, and noise of the others the headings."""
    plain = TurnSamples.from_track(turning(TIMES), 0)
    used = TIMES >= SETTLING_S
    first = np.flatnonzero(used)[0]
    for offset in (0, 1):
        headings = RATE_RAD_S * TIMES
        headings[first + offset :: 2] += 0.01 * np.sin(
            np.arange(len(headings[first + offset :: 2]))
        )
        noisy = TurnSamples.from_track(track(TIMES, headings), 0)
        assert np.allclose(noisy.turn_rad, plain.turn_rad) == (offset == 1)
        assert np.allclose(noisy.grid_heading_rad, plain.grid_heading_rad) == (offset == 0)


def test_a_turn_during_which_the_robot_was_not_seen_is_left_out():
    for gap_s, is_left_out in ((GAP_MIN_S - 0.1, False), (GAP_MIN_S + 0.1, True)):
        seen = (TIMES < 5.0) | (5.0 + gap_s < TIMES)
        turns = TurnSamples.from_track(turning(TIMES[seen]), 0)
        across = (turns.begin_s < 5.0 + gap_s / 2) & (turns.end_s > 5.0 + gap_s / 2)
        assert across.any() != is_left_out


def test_a_slow_camera_has_no_gaps():
    slow = np.arange(0, 60) * 0.2
    turns = TurnSamples.from_track(turning(slow), 0)
    assert turns.end_s - turns.begin_s == pytest.approx(np.full(len(turns.end_s), 0.4))


def test_poses_in_which_the_robot_was_not_tracked_or_silent_are_not_used():
    lost = np.ones((len(TIMES), 1), dtype=bool)
    lost[(TIMES > 5) & (TIMES < 6)] = False
    for turns in (
        TurnSamples.from_track(turning(TIMES, valid=lost), 0),
        TurnSamples.from_track(turning(TIMES, is_silent=~lost), 0),
    ):
        assert not ((turns.begin_s > 5.1) & (turns.end_s < 5.9)).any()
        assert ((turns.begin_s > 6.1) & (turns.end_s < 6.9)).any()


def test_the_poses_of_each_robot_have_their_own_times():
    later = (TIMES + 0.01)[:, None]
    turns = TurnSamples.from_track(turning(TIMES, exposed_by_robot_s=later), 0)
    assert set(np.round((turns.begin_s - 0.01) / 0.03 % 1, 6)) <= {0.0, 1.0}


def test_only_the_directions_that_a_robot_received_count():
    received = np.array([[True], [False], [True]])
    turns = TurnSamples.from_track(
        turning(TIMES, sent=(0.0, 1.0, 2.0), u=(0.1, 0.2, 0.3), is_received=received), 0
    )
    assert turns.sent_s.tolist() == [0.0, 2.0]
    assert turns.direction_rad.tolist() == [0.1, 0.3]


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_poses_give_no_turns(count):
    times = 1.0 + np.arange(count) * 0.1
    turns = TurnSamples.from_track(turning(times), 0)
    assert len(turns.turn_rad) == len(turns.begin_s) == len(turns.end_s) <= 1
    assert len(turns.integrate_pull(0.1, 0.1)) == len(turns.turn_rad)


def asked_slowly(turns, lag_s, dead_time_s, heading):
    """The integral over each turn of exp(i (u - h)), which follows with a lag, in small steps."""
    dt = 1e-3
    times = np.arange(turns.grid_s[0], turns.grid_s[-1], dt)
    newest = np.maximum(np.searchsorted(turns.sent_s, times - dead_time_s, side="right") - 1, 0)
    pull = np.exp(1j * (turns.direction_rad[newest] - heading(times)))
    rate = np.zeros(len(times), dtype=complex)
    now = 0j
    for k, asked in enumerate(pull):
        now += (asked - now) * (1 - np.exp(-dt / lag_s)) if lag_s else asked - now
        rate[k] = now
    total = np.concatenate([[0], np.cumsum(rate) * dt])
    ends = [
        np.interp(at, np.append(times, times[-1] + dt), total)
        for at in (turns.begin_s, turns.end_s)
    ]
    return ends[1] - ends[0]


@pytest.mark.parametrize("lag_s", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("dead_time_s", [0.0, 0.13])
def test_what_directions_ask_for_is_the_integral_of_their_pull(lag_s, dead_time_s):
    sent = np.arange(0, 12, 0.35)
    u = np.random.default_rng(3).uniform(-2, 2, len(sent))
    headings = 0.4 * np.sin(TIMES)
    turns = TurnSamples.from_track(track(TIMES, headings, sent, u), 0)
    expected = asked_slowly(turns, lag_s, dead_time_s, lambda times: 0.4 * np.sin(times))
    after_the_start = turns.begin_s > turns.grid_s[0] + 8 * lag_s
    asked = turns.integrate_pull(lag_s, dead_time_s)
    assert asked[after_the_start] == pytest.approx(expected[after_the_start], abs=3e-3)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0, 0.4))
def test_a_robot_at_a_constant_angle_to_its_direction_is_pulled_evenly(direction, heading, dead):
    turns = TurnSamples.from_track(track(TIMES, np.full(len(TIMES), heading), u=(direction,)), 0)
    expected = np.exp(1j * (direction - heading)) * (turns.end_s - turns.begin_s)
    assert turns.integrate_pull(0.0, dead) == pytest.approx(expected, abs=1e-9)


def test_without_directions_nothing_is_asked():
    turns = TurnSamples.from_track(turning(TIMES, is_received=np.array([[False]])), 0)
    assert len(turns.turn_rad) > 0
    assert (turns.integrate_pull(0.1, 0.1) == 0).all()
