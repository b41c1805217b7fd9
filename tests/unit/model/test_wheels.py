"""Tests of robots on wheels: the paper's (21)-(25), lag, and the compiled host."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Poses
from tetractl.model.motion.exact import step as exact
from tetractl.model.motion.rolling import KnownRobots, SentRates, note, wish
from tetractl.model.motion.wheel_equations import wheel_speeds
from tetractl.model.wheels import (
    Drivetrains,
    WheeledRobots,
    WheelHost,
    compute_body_velocity,
)
from tetractl.plant import drive_kernels as kernels

pytestmark = pytest.mark.slow


def test_the_papers_robot_by_hand():
    """At right angles to the direction, with a = 6 rad/s, 180 mm/s and wheels at 40 mm: it turns at
    6 rad/s, for which each wheel drives 6 * 40 mm/s more or less."""
    left_mm_s, right_mm_s = wheel_speeds(1.0, np.array([6.0]), np.array([180.0]), 40)
    assert (left_mm_s[0], right_mm_s[0]) == (180 - 240, 180 + 240)  # (24), (25)
    assert compute_body_velocity(left_mm_s, right_mm_s, 40) == (180, 6)  # (21)-(23)


def headings_at_rest(lag_s, sent, frames, acts_ns):
    """Headings (N,) for which `wish` computes wheel speeds, for each frame: time and headings.

    With an a and a radius of 1, half the difference of the wheels' speeds is sin(u - heading)."""
    sent_rates = SentRates.none(2)
    robots = KnownRobots(a=np.ones(2), speed=np.ones(2), radius=np.ones(2), lag_s=lag_s)
    for sent_ns, rates in sent:
        sent_rates = sent_rates.with_room()
        note(sent_rates, sent_ns, np.array([-rates, rates]), robots.radius)

    def sine_to(u, heading, seen_ns):
        left_and_right = wish(heading, np.full(2, u), seen_ns, acts_ns, robots, sent_rates)
        return np.diff(left_and_right, axis=0)[0] / 2

    headings = []
    for seen_ns, heading in frames:
        sine = -sine_to(0.0, heading, seen_ns)
        cosine = sine_to(np.pi / 2, heading, seen_ns)
        headings.append(np.arctan2(sine, cosine))
    return headings


def test_headings_ahead_are_those_in_which_lagging_robots_come_to_rest():
    """Turning rates sent at uneven times, followed with a lag, against an integration at 10 kHz."""
    rng = np.random.default_rng(4)
    lag_s = 0.04
    step_s = 1e-4
    stop_s = 0.2
    sent = {0.05: rng.normal(size=2), 0.08: rng.normal(size=2), 0.15: rng.normal(size=2)}
    wanted_by_time = sent | {stop_s: np.zeros(2)}
    heading = np.zeros(2)
    turning = np.zeros(2)
    wanted = np.zeros(2)
    headings = []  # for 0.6 s, ten lags after the stop
    for k in range(6000):
        wanted = wanted_by_time.get(round(k * step_s, 4), wanted)
        headings.append(heading)
        heading = heading + step_s * turning
        turning = turning + step_s / lag_s * (wanted - turning)

    commands = [(round(sent_s * SECOND), rates) for sent_s, rates in sent.items()]
    frames = [
        (round(seen_s * SECOND), headings[round(seen_s / step_s)])
        for seen_s in (0.02, 0.07, 0.12, 0.16)
    ]
    for heading_at_rest in headings_at_rest(lag_s, commands, frames, round(stop_s * SECOND)):
        assert heading_at_rest == pytest.approx(headings[-1], abs=2e-3)


def test_headings_ahead_without_a_lag_fall_to_the_direction_by_3():
    """A frame of the moment 0, and a command that acts 0.02 s later."""
    u = 1.2
    a = np.array([6.0, 3.0])
    speed = np.array([180.0, 150.0])
    radius = np.array([40.0, 40.0])
    robots = KnownRobots(a, speed, radius, lag_s=0.0)
    heading = np.array([0.3, -2.0])
    wished = wish(heading, np.full(2, u), 0, SECOND // 50, robots, SentRates.none(2))
    _, _, ahead = exact(0.0, 0.0, heading, u, a, speed, 0.02)
    expected = np.array(wheel_speeds(np.sin(u - ahead), a, speed, radius))
    assert wished == pytest.approx(expected, abs=1e-9)


def uneven_wheels(rng, count):
    """Wheels of so many robots, no two of them alike."""
    return Drivetrains(
        gain=rng.uniform(5, 9, (2, count)),
        dead_zone=rng.integers(0, 8, (2, count)),
        limit=rng.integers(60, 128, count),
        swap=np.zeros(count, np.bool_),
    )


@pytest.mark.parametrize("lag_s", [0.0, 0.04])
def test_a_simulated_host_computes_the_bits_of_the_labs_host(lag_s):
    """What both compute for 40 frames a second: the speeds that the wheels get by the calibration,
    and those that they get by how they truly are."""
    rng = np.random.default_rng(5)
    count = 3
    a = rng.uniform(2, 6, count)
    speed = rng.uniform(100, 300, count)
    robots = KnownRobots(a, speed, np.full(count, 40.0), lag_s)
    calibrated = uneven_wheels(rng, count)
    true = replace(calibrated, gain=2 * calibrated.gain, dead_zone=calibrated.dead_zone + 1)
    host = WheelHost(*robots, calibrated)
    trains = kernels.WheelArrays(
        rounding_errors=np.zeros((2, count)),
        gain=calibrated.gain,
        dead_zone=calibrated.dead_zone.astype(float),
        true_gain=true.gain,
        true_dead_zone=true.dead_zone.astype(float),
        limit=calibrated.limit.astype(float),
    )
    rates = SentRates.none(count)
    for k in range(40):
        seen_ns = k * SECOND // 40 + 3_000_000
        acts_ns = (k + 1) * SECOND // 40
        heading = rng.uniform(-3, 3, count)
        u = rng.uniform(-3, 3)
        drives = k % 5 > 0
        rates = rates.with_room()
        wishes = robots if drives else robots.turning()
        speeds = kernels.compute_wheel_speeds(
            heading, np.full(count, u), seen_ns, acts_ns, wishes, rates, trains
        )
        wished = host.compute_speeds(heading, u, seen_ns, acts_ns, drives)
        host.record_sent(acts_ns, wished)
        counts = host.counts(wished)
        assert speeds[0].tolist() == calibrated.speeds(counts).tolist()
        assert speeds[1].tolist() == true.speeds(counts).tolist()


def test_a_host_that_is_told_a_lag_computes_what_one_does_that_knows_it():
    a = np.array([4.0, 5.0])
    speed = np.array([150.0, 200.0])
    radius = np.full(2, 40.0)
    wheels = uneven_wheels(np.random.default_rng(5), 2)
    hosts = [WheelHost(a, speed, radius, lag_s, wheels) for lag_s in (0.133, 0.04, 0.04)]
    hosts[1].assume_lag(0.133)
    wished = []
    for host in hosts:
        host.record_sent(0, np.array([[10.0, 20.0], [60.0, 90.0]]))
        heading = np.array([0.2, -1.0])
        wished.append(host.compute_speeds(heading, 1.0, SECOND // 10, SECOND // 5).tolist())
    assert wished[1] == wished[0]
    assert wished[1] != wished[2]


LAG_S = 0.04
RADIUS = np.full(3, 40.0)
DRIVE_S = 0.2


def integrated_path(pose, wheels, targets):
    """Poses (L, 3, N) at every millisecond of DRIVE_S, by the midpoints of steps of 0.1 ms, while
    the speeds of wheels (2, N) approach their targets."""
    step_s = 1e-4
    poses = []
    for k in range(round(DRIVE_S / step_s)):
        decay = math.exp(-(k + 0.5) * step_s / LAG_S)
        speed, turning = compute_body_velocity(*(targets + (wheels - targets) * decay), RADIUS)
        course = pose[2] + turning * step_s / 2
        rates = np.array([speed * np.cos(course), speed * np.sin(course), turning])
        pose = pose + step_s * rates
        poses.append(pose)
    return np.array(poses[9::10])


def drive_in_calls(robots, count):
    """The path of robots that are driven for DRIVE_S in so many calls."""
    times_ns = np.arange(1, 201) * SECOND // 1000
    since_ns = 0
    parts = []
    for times_of_call_ns in np.array_split(times_ns, count):
        parts.append(robots.drive(since_ns, times_of_call_ns))
        since_ns = times_of_call_ns[-1]
    return np.concatenate(parts)


def test_the_path_is_that_of_an_integration_in_any_division_into_calls():
    rng = np.random.default_rng(6)
    pose = rng.normal(size=(3, 3))
    wheels = 100 * rng.normal(size=(2, 3))
    targets = 100 * rng.normal(size=(2, 3))
    expected = integrated_path(pose, wheels, targets)
    wheels_at_end = targets + (wheels - targets) * math.exp(-DRIVE_S / LAG_S)
    paths = []
    for calls in (1, 7):
        for roll in (WheeledRobots.roll, kernels.roll):  # readable and compiled
            robots = WheeledRobots(Poses(*pose), RADIUS, LAG_S, 1e-9)
            robots.roll = roll
            robots.wheels[:] = wheels
            robots.targets[:] = targets
            path = drive_in_calls(robots, calls)
            assert path == pytest.approx(expected, abs=1e-4)
            assert robots.wheels == pytest.approx(wheels_at_end, abs=1e-9)
            paths.append(path)
    assert all(path.tobytes() == paths[0].tobytes() for path in paths)
