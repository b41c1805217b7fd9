"""Tests of the loops of wheels: counts, rates that were sent, and paths with swerves."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.poses import Poses
from tetractl.model.motion.rolling import (
    ENTRIES_AT_FIRST,
    MOVING,
    KnownRobots,
    SentRates,
    count,
    forget,
    headings_at_rest,
    headings_turned,
    note,
    wish,
)
from tetractl.model.wheels import WheeledRobots, compute_body_velocity

MS = SECOND // 1000
SEEDS = st.integers(0, 2**32)
RADIUS = np.array([40.0, 25.0])


# ---- the rates that were sent ----


def sent_rates(times_ns, rates, true_at_first=(0.5, -2.0)):
    """Rates (K, 2) [rad/s] that take effect at the times, of which the first may have begun."""
    sent = SentRates.none(2)
    sent.times_ns[0] = times_ns[0]
    sent.rates[0] = rates[0]
    sent.true_at_first[:] = true_at_first
    for time_ns, of_robots in zip(times_ns[1:], rates[1:], strict=True):
        sent = sent.with_room()
        difference = np.array(of_robots) * RADIUS
        note(sent, time_ns, np.array([-difference, difference]), RADIUS)
    return sent


def random_rates(seed, number=6):
    rng = np.random.default_rng(seed)
    times_ns = np.cumsum(rng.integers(1, 60, number)) * MS
    return sent_rates(times_ns.tolist(), rng.uniform(-4, 4, (number, 2)).tolist()), times_ns


def turned_until_rest(heading, since_ns, acts_ns, lag_s, sent):
    """The headings at a standstill, by steps of 0.1 ms of T w' = c - w, theta' = w."""
    step_ns = MS // 10
    used = [k for k in range(len(sent.times_ns)) if sent.times_ns[k] != NEVER_NS]
    turning = sent.true_at_first.copy()
    theta = np.array(heading)
    decay = math.exp(-step_ns / SECOND / lag_s)
    end_ns = acts_ns + round(20 * lag_s * SECOND)
    for now_ns in range(int(sent.times_ns[0]), end_ns, step_ns):
        wanted = np.zeros(2)
        if now_ns < acts_ns:
            wanted = sent.rates[max(k for k in used if sent.times_ns[k] <= now_ns)]
        after = wanted + (turning - wanted) * decay
        if now_ns >= since_ns:
            theta = theta + step_ns / SECOND * (turning + after) / 2
        turning = after
    return theta


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("sees", ["the first rate", "a later rate"])
def test_headings_at_rest_are_those_of_the_lagging_wheels(seed, sees):
    sent, times_ns = random_rates(seed)
    since_ns = int(times_ns[0]) + 1 * MS if sees == "the first rate" else int(times_ns[2])
    acts_ns = int(times_ns[-1]) + 7 * MS
    expected = turned_until_rest([0.3, -1.0], since_ns, acts_ns, 0.05, sent)
    forget(sent, since_ns, 0.05)
    ours = headings_at_rest(np.array([0.3, -1.0]), since_ns, acts_ns, 0.05, sent)
    assert ours == pytest.approx(expected, abs=1e-4)


@given(SEEDS, st.integers(0, 400), st.integers(0, 400))
def test_what_is_forgotten_does_not_matter_later(seed, forgotten_ms, later_ms):
    sent, times_ns = random_rates(seed)
    twice, _ = random_rates(seed)
    forgotten_ns = int(times_ns[0]) + forgotten_ms * MS
    now_ns = forgotten_ns + later_ms * MS
    forget(twice, forgotten_ns, 0.05)
    assert twice.times_ns[1] > forgotten_ns  # only what still acts, or will, is left
    assert twice.times_ns[0] <= forgotten_ns
    assert (twice.times_ns != NEVER_NS).sum() == 1 + (times_ns > forgotten_ns).sum()
    headings = []
    for kept in (sent, twice):
        forget(kept, now_ns, 0.05)
        acts_ns = now_ns + 30 * MS
        headings.append(headings_at_rest(np.zeros(2), now_ns, acts_ns, 0.05, kept))
    assert headings[0] == pytest.approx(headings[1], abs=1e-9)


def test_a_rate_at_the_time_of_the_frame_has_replaced_the_one_before():
    sent = sent_rates([0, 20 * MS, 50 * MS], [[1.0, 1.0], [2.0, 3.0], [4.0, 5.0]])
    forget(sent, 20 * MS - 1, 0.05)
    assert sent.times_ns[:3].tolist() == [0, 20 * MS, 50 * MS]
    forget(sent, 20 * MS, 0.05)
    assert sent.times_ns[:2].tolist() == [20 * MS, 50 * MS]
    assert sent.times_ns[2] == NEVER_NS
    assert sent.rates[0] == pytest.approx([2.0, 3.0])


def test_there_is_always_room_for_one_more_rate_and_nothing_gets_lost():
    sent = SentRates.none(2)
    assert len(sent.times_ns) == ENTRIES_AT_FIRST
    assert (sent.times_ns[0], sent.rates[0].tolist()) == (0, [0.0, 0.0])  # robots stand
    assert sent.with_room() is sent
    for k in range(1, 40):
        sent = sent.with_room()
        note(sent, k * MS, np.array([[0.0, 1.0 * k], [2.0 * k, 0.0]]), RADIUS)
        assert sent.times_ns[-1] == NEVER_NS
    number = 40
    assert sent.times_ns[:number].tolist() == [k * MS for k in range(number)]
    assert (sent.times_ns[number:] == NEVER_NS).all()
    speeds = compute_body_velocity(np.array([0.0, 39.0]), np.array([78.0, 0.0]), RADIUS)
    assert sent.rates[39] == pytest.approx(speeds[1])
    assert len(sent.times_ns) <= 2 * number


A = np.array([6.0, 3.0])


def test_without_a_lag_robots_turn_by_3_until_the_command_acts():
    heading = np.array([0.3, -2.0])
    u = np.array([1.2, 0.5])
    ahead = headings_turned(heading, u, 5 * MS, 25 * MS, A)
    half_tangent = np.tan((u - heading) / 2) * np.exp(-A * 0.02)
    assert ahead == pytest.approx(u - 2 * np.arctan(half_tangent))
    assert heading.tolist() == [0.3, -2.0]


@pytest.mark.parametrize("late_ms", [0, 3])
def test_a_frame_that_is_no_older_than_the_command_is_taken_as_it_is(late_ms):
    heading = np.array([0.3, -2.0])
    ahead = headings_turned(heading, np.ones(2), 25 * MS + late_ms * MS, 25 * MS, A)
    assert ahead.tolist() == heading.tolist()


def test_the_lag_decides_which_headings_the_speeds_are_for():
    heading = np.array([0.3, -2.0])
    u = np.array([1.2, 0.5])
    speed = np.array([180.0, 150.0])
    sent = sent_rates([0, 8 * MS], [[1.0, -1.0], [2.0, 0.5]])
    at_rest = headings_at_rest(heading, 10 * MS, 30 * MS, 0.05, random_copy(sent))
    robots = KnownRobots(A, speed, RADIUS, 0.05)
    left, right = wish(heading, u, 10 * MS, 30 * MS, robots, sent)
    driven, turning = compute_body_velocity(left, right, RADIUS)
    assert driven == pytest.approx(speed)
    assert turning == pytest.approx(A * np.sin(u - at_rest))
    left, right = wish(heading, u, 10 * MS, 30 * MS, robots.turning(), sent)
    driven, turning = compute_body_velocity(left, right, RADIUS)
    assert driven == pytest.approx([0, 0], abs=1e-9)
    assert turning == pytest.approx(A * np.sin(u - at_rest))


def random_copy(sent):
    """A copy whose rates before 10 ms are forgotten."""
    copied = SentRates(*(values.copy() for values in sent))
    forget(copied, 10 * MS, 0.05)
    return copied


# ---- counts ----


def counted(speeds, owed=((0.0,), (0.0,)), gain=((10.0,), (5.0,)), dead_zone=((2,), (0,))):
    owed = np.array(owed)
    steps = count(np.array(speeds), owed, np.array(gain), np.array(dead_zone), np.array([100]))
    return steps[:, 0].tolist(), owed[:, 0].tolist()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speeds", "steps"),
    [
        ([[980.0], [500.0]], [98, 100]),  # both at their limits, which are no scaling
        ([[1960.0], [500.0]], [98, 50]),  # the left wheel asks for twice as much as it can
        ([[980.0], [1000.0]], [49, 100]),  # the right one
        ([[300.0], [200.0]], [30, 40]),
    ],
)
def test_wheels_that_are_asked_too_much_slow_down_together(speeds, steps, sign):
    found, _ = counted(sign * np.array(speeds))
    assert found == [sign * step for step in steps]


def test_what_rounding_owes_is_carried_over_unless_the_robot_stands():
    steps, owed = counted([[12.0], [7.0]])
    assert steps == [1, 1]
    assert owed == pytest.approx([0.2, 0.4])
    steps, owed = counted([[12.0], [7.0]], owed=[[0.4], [0.2]])
    assert steps == [2, 2]
    assert owed == pytest.approx([-0.4, -0.4])
    assert counted([[0.0], [0.0]], owed=[[0.4], [0.4]]) == ([0, 0], [0.0, 0.0])
    _, owed = counted([[0.0], [7.0]], owed=[[0.4], [0.2]])
    assert owed == pytest.approx([0.4, -0.4])


# ---- paths ----


def robots_of(lags=0.0, still=1e-9, wheels=(100.0, 130.0), number=2):
    poses = Poses(np.array([5.0, 6.0])[:number], np.array([7.0, 8.0])[:number], np.zeros(number))
    robots = WheeledRobots(poses, RADIUS[:number], lags, still)
    robots.wheels[0] = robots.targets[0] = wheels[0]
    robots.wheels[1] = robots.targets[1] = wheels[1]
    return robots


TIMES = np.arange(1, 7) * 10 * MS
TICKS = np.array([False, True, False, True, True, False])
DRAWN = np.array([[1.0, -1.0], [0.5, 2.0], [-3.0, 1.5]])


def test_the_headings_of_moving_robots_swerve_at_ticks_and_only_then():
    plain = robots_of().drive(0, TIMES)
    swerving = robots_of()
    swerving.body[MOVING] = 1.0, 0.0
    path = swerving.drive(0, TIMES, TICKS, 0.1, DRAWN)
    off = path[:, 2] - plain[:, 2]
    assert off[:, 0] == pytest.approx(0.1 * np.array([0, 1.0, 1.0, 1.5, -1.5, -1.5]))
    assert off[:, 1] == pytest.approx(np.zeros(6))
    assert path[:2, 0, 0] == pytest.approx(plain[:2, 0, 0])  # a swerve is seen from the next on
    unsettled = robots_of()
    unsettled.body[MOVING] = 1.0
    still = unsettled.drive(0, TIMES, TICKS, 0.0, DRAWN)
    assert still.tobytes() == plain.tobytes()


def test_a_tick_at_the_time_of_the_state_has_been_already():
    robots = robots_of()
    robots.body[MOVING] = 1.0
    times = np.array([0, 10 * MS])
    path = robots.drive(0, times, np.array([True, True]), 0.1, np.array([[9.0, 9.0], [1.0, 1.0]]))
    plain = robots_of().drive(0, times)
    assert path[0] == pytest.approx(plain[0])
    assert path[1, 2] - plain[1, 2] == pytest.approx([0.1, 0.1])


def test_each_robot_has_the_lag_of_its_own_wheels():
    """Whatever the robots before it have."""
    for lags in ([0.05, 0.2], [0.2, 0.05], [0.0, 0.05], [0.05, 0.0], [0.05, 0.05]):
        together = robots_of(np.array(lags))
        together.targets[:] = [[-50.0, 10.0], [20.0, 90.0]]
        together.drive(0, np.array([30 * MS]))
        expected = [
            target + (100.0 - target) * (math.exp(-0.03 / lag) if lag else 0.0)
            for lag, target in zip(lags, [-50.0, 10.0], strict=True)
        ]
        assert together.wheels[0] == pytest.approx(expected)


@pytest.mark.parametrize("side", [0, 1])
def test_the_path_of_a_lagging_wheel_is_the_integral_of_its_speed(side):
    """One wheel falls from 100 to 40 mm/s, the other stands: half its path is driven."""
    lag_s = 0.05
    robots = robots_of(lag_s, wheels=(0.0, 0.0))
    robots.wheels[side] = 100.0
    robots.targets[side] = 40.0
    path = robots.drive(0, np.array([80 * MS]))
    way = 40.0 * 0.08 + 60.0 * lag_s * (1 - math.exp(-0.08 / lag_s))
    turned = way / (2 * RADIUS) * (1 if side else -1)
    assert path[0, 2] == pytest.approx(turned)
    chord = np.hypot(path[0, 0] - [5.0, 6.0], path[0, 1] - [7.0, 8.0])
    assert chord == pytest.approx(way / 2 * np.sin(turned / 2) / (turned / 2))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stopped_robot_stands_once_both_wheels_are_slow(sign):
    """The faster wheel, at first with 100 mm/s, falls below 20 mm/s after 1.6 lags."""
    lag_s = 0.05
    for lags, stands in ((1.5, False), (1.7, True)):
        robots = robots_of(lag_s, still=20.0, wheels=(sign * 100.0, sign * 50.0))
        robots.targets[:] = 0.0
        robots.drive(0, np.array([round(lags * lag_s * SECOND)]))
        assert (robots.wheels == 0).all() == stands


def test_a_slow_robot_that_drives_does_not_stand():
    robots = robots_of(0.05, still=20.0, wheels=(3.0, 3.0))
    robots.targets[0] = 0.0
    robots.drive(0, np.array([100 * MS]))
    assert (robots.wheels > 0).all()


def test_slip_scales_how_far_robots_drive_and_turn():
    robots = robots_of()
    robots.scale(turn_ratios=np.array([0.5, 1.0]), speed_ratios=np.array([1.0, 0.25]))
    path = robots.drive(0, np.array([10 * MS]))
    turning = 30.0 / (2 * RADIUS) * [0.5, 1.0]
    assert path[0, 2] == pytest.approx(0.01 * turning)
    way = np.hypot(path[0, 0] - [5.0, 6.0], path[0, 1] - [7.0, 8.0])
    assert way == pytest.approx(0.01 * 115.0 * np.array([1.0, 0.25]), rel=1e-3)
