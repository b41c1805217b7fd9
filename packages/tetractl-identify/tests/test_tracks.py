"""What a track takes from a log: each value from the right place, and nothing that is not known."""

import json
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.trials import three_robots
from tetractl_identify.tracks import (
    SETTLING_S,
    extract_track,
    extract_wheel_track,
    find_stop_ns,
    integrate_held_rates,
    select_rows_apart,
)

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.errors import UsageError

pytestmark = pytest.mark.slow

MS = SECOND // 1000


@pytest.fixture(scope="module")
def log():
    return three_robots()


def with_lags(log, lags_s):
    """The log with a lag sent with some of its steps, by step."""
    steps = [
        replace(
            step,
            command=replace(step.command, action=replace(step.command.action, lag_s=lags_s.get(k))),
        )
        for k, step in enumerate(log.steps)
    ]
    return replace(log, steps=tuple(steps))


def with_commands(log, *commands):
    """The log with commands of these actions at these times [ms]."""
    sent = log.commands[0]
    made = [replace(sent, action=action, sent_ns=at_ms * MS) for action, at_ms in commands]
    return replace(log, commands=tuple(made))


@pytest.mark.parametrize(
    ("lags_s", "lag_s"),
    [
        ({0: 0.05}, 0.05),
        ({0: 0.05, 3: 0.09}, 0.09),
        ({2: 0.09, 7: 0.0}, 0.0),
        ({0: 0.3, 1: 0.2, 40: 0.1}, 0.1),
    ],
)
def test_the_lag_is_the_last_one_sent(log, lags_s, lag_s):
    """A host keeps the lag that it has until a command states another one."""
    assert extract_track(with_lags(log, lags_s)).lag_s == lag_s


def test_without_a_lag_sent_it_is_that_of_the_spec(log):
    stops = tuple(
        replace(step, command=replace(step.command, action=Stop())) for step in log.steps[:3]
    )
    setup = replace(log.start.setup, lag_s=0.07)
    stated = replace(log, start=replace(log.start, setup=setup))
    assert extract_track(stated).lag_s == 0.07
    assert extract_track(replace(stated, steps=())).lag_s == 0.07
    assert extract_track(replace(stated, steps=stops)).lag_s == 0.07


def test_commands_are_those_with_a_direction_at_the_times_they_were_sent(log):
    track = extract_track(
        with_commands(log, (Steer(0.1), 100), (Stop(), 300), (Turn(2.0), 400), (Steer(0.3), 700))
    )
    assert track.direction_rad.tolist() == [0.1, 0.3]
    assert track.sent_s.tolist() == [0.1, 0.7]
    assert track.is_received.shape == (2, 3)


def test_a_log_without_commands_has_those_of_its_steps(log):
    track = extract_track(replace(log, commands=()))
    assert track.direction_rad.tolist() == [step.command.direction for step in log.steps]
    assert track.sent_s * SECOND == pytest.approx([step.command.sent_ns for step in log.steps])


@pytest.mark.parametrize(
    ("commands", "stopped_ms"),
    [
        ([(Steer(0.1), 100), (Stop(), 300)], 300),
        ([(Steer(0.1), 100), (Stop(), 300), (Stop(), 320), (Stop(), 340)], 300),
        ([(Stop(), 50), (Steer(0.1), 100), (Stop(), 300)], 300),
        ([(Steer(0.1), 100), (Stop(), 200), (Steer(0.1), 250), (Stop(), 300)], 300),
    ],
)
def test_a_track_ends_at_the_first_stop_after_the_last_direction(log, commands, stopped_ms):
    made = with_commands(log, *commands)
    assert find_stop_ns(made) == stopped_ms * MS
    assert extract_track(made).stop_s == pytest.approx(stopped_ms / 1000)


def test_without_such_a_stop_it_ends_at_the_one_of_the_end_or_at_the_last_direction(log):
    made = with_commands(log, (Stop(), 50), (Steer(0.1), 100), (Steer(0.1), 300))
    assert find_stop_ns(made) == log.stop.sent_ns
    assert extract_track(made).stop_s == log.stop.sent_ns / SECOND
    assert extract_track(replace(made, stop=None)).stop_s == pytest.approx(0.3)


def test_the_age_of_a_frame_is_the_median_without_the_first_step(log):
    """Before the first step, robots wait for the first plan."""
    ages_ms = [900, 40, 10, 20, 30]
    steps = []
    for step, age_ms in zip(log.steps, ages_ms, strict=False):
        sent_ns = step.observation.sampled_ns + age_ms * MS
        steps.append(replace(step, command=replace(step.command, sent_ns=sent_ns)))
    assert extract_track(replace(log, steps=tuple(steps))).frame_age_s == pytest.approx(0.025)
    assert extract_track(replace(log, steps=tuple(steps[:1]))).frame_age_s is None


def test_poses_are_the_measured_ones(log):
    track = extract_track(log)
    assert np.array_equal(track.poses, log.mocap, equal_nan=True)
    assert track.time_s * SECOND == pytest.approx(log.mocap_ns)
    assert track.names == ("green", "blue", "red")
    assert track.unit == "mm"
    assert json.loads(log.start.plant.facts["true_a"]) != log.start.setup.a.tolist()


def test_robots_drive_as_commanded_until_a_stop_and_some_time_after_the_next_direction(log):
    made = with_commands(log, (Steer(0.1), 0), (Stop(), 1000), (Steer(0.2), 2000), (Stop(), 8000))
    track = extract_track(made)
    is_paused = (track.time_s >= 1) & (track.time_s < 2 + SETTLING_S)
    assert is_paused.any()
    assert np.array_equal(track.valid, log.valid & ~is_paused[:, None])


def test_a_robot_is_silent_from_the_end_of_its_watchdog_to_the_next_command_it_receives(log):
    setup = replace(log.start.setup, watchdog_s=0.5)
    made = replace(log, start=replace(log.start, setup=setup))
    sent = log.commands[0]
    delivered = [(True, False), (True, False), (False, True), (True, True), (True, True)]
    at_s = [0.0, 0.4, 0.8, 2.0, 2.4]
    commands = [
        replace(sent, action=Steer(0.1), sent_ns=round(t * SECOND), delivered=(first, True, last))
        for t, (first, last) in zip(at_s, delivered, strict=True)
    ]
    track = extract_track(replace(made, commands=tuple(commands)))
    t = track.time_s
    assert track.watchdog_s == 0.5
    first = ((t >= 0.9) & (t < 2 + SETTLING_S)) | (t >= 2.9)
    last = (t < 0.8 + SETTLING_S) | ((t >= 1.3) & (t < 2 + SETTLING_S)) | (t >= 2.9)
    assert np.array_equal(track.is_silent[:, 0], first)
    assert np.array_equal(track.is_silent[t >= 0, 2], last[t >= 0])
    assert np.array_equal(track.follows_commands, track.valid & ~track.is_silent)


def test_motion_with_the_field_off_is_refused(log):
    with pytest.raises(UsageError, match="field switched off"):
        extract_track(with_commands(log, (Steer(0.1), 0), (FieldOff(), 1000)))


def test_wheels_have_the_speeds_of_the_equations_and_none_of_a_lost_command(log):
    setup = replace(log.start.setup, wheel_radius=np.array([40.0, 45.0, 50.0]))
    left, right = np.array([100.0, 0.0, -20.0]), np.array([140.0, 90.0, 20.0])
    sent = log.commands[0]
    commands = (
        replace(sent, left=left, right=right, delivered=(True, True, True)),
        replace(sent, left=left, right=right, delivered=(True, False, True)),
        replace(sent, left=None, right=None),
    )
    made = replace(log, start=replace(log.start, setup=setup), commands=commands)
    track = extract_wheel_track(made)
    assert track.twists.shape == (2, 3, 2)
    assert track.twists[0].tolist() == [[120, 0.5], [45, 1], [0, 0.4]]
    assert np.isnan(track.twists[1, 1]).all()
    assert np.array_equal(track.twists[1, [0, 2]], track.twists[0, [0, 2]])
    with pytest.raises(UsageError, match="no wheel speeds"):
        extract_wheel_track(replace(made, commands=commands[2:]))


@given(st.lists(st.integers(1, 50), min_size=1, max_size=40), st.integers(0, 100))
def test_rows_are_the_next_ones_that_are_far_enough_from_the_last(steps, least):
    """In steps of 0.01 s, exactly on the limit, too."""
    ticks = list(accumulate(steps))
    rows = select_rows_apart(np.array(ticks) * 0.01, least * 0.01).tolist()
    assert rows[0] == 0
    for row, after in zip(rows, [*rows[1:], len(ticks)], strict=True):
        assert all(ticks[between] - ticks[row] < least for between in range(row + 1, after))
        assert after == len(ticks) or ticks[after] - ticks[row] >= least


@given(st.lists(st.tuples(st.integers(1, 9), st.floats(-5, 5)), min_size=2, max_size=12))
def test_the_integral_of_rates_is_that_of_a_fine_sum(sent):
    times = np.cumsum([step for step, _ in sent]).astype(float)
    rates = np.array([rate for _, rate in sent])
    wanted = np.arange(times[0], times[-1], 0.5)
    middle = np.arange(times[0], times[-1], 0.125) + 0.0625
    held = rates[np.searchsorted(times, middle, side="right") - 1]
    expected = [0.125 * held[middle < time].sum() for time in wanted]
    found = integrate_held_rates(times, np.column_stack([rates, -2 * rates]), wanted)
    assert found[:, 0] == pytest.approx(np.array(expected), abs=1e-9)
    assert found[:, 1] == pytest.approx(-2 * np.array(expected), abs=1e-9)
