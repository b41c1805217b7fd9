"""Tests that the compiled functions of the simulation do what the plain ones of the model do."""

import numpy as np
import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Poses
from tetractl.model.motion.rolling import KnownRobots, SentRates
from tetractl.model.wheels import Drivetrains, WheeledRobots, WheelHost
from tetractl.plant.drive_kernels import WheelArrays, compute_wheel_speeds, roll

RNG = np.random.default_rng(411)
ROBOTS = 5
A = RNG.uniform(1, 6, ROBOTS)
SPEED = RNG.uniform(50, 200, ROBOTS)
RADIUS = RNG.uniform(20, 60, ROBOTS)
DEAD_ZONE = np.array([[0, 3, 5, 8, 2], [0, 4, 5, 1, 20]])
TRUE_DEAD_ZONE = np.array([[0, 5, 2, 8, 2], [0, 4, 9, 0, 60]])
GAIN = np.full((2, ROBOTS), 2.0)
TRUE_GAIN = GAIN * RNG.uniform(0.8, 1.2, GAIN.shape)
LIMIT = np.full(ROBOTS, 127)


def trains(limit=LIMIT):
    return WheelArrays(
        rounding_errors=np.zeros((2, ROBOTS)),
        gain=GAIN.copy(),
        dead_zone=DEAD_ZONE.astype(float),
        true_gain=TRUE_GAIN.copy(),
        true_dead_zone=TRUE_DEAD_ZONE.astype(float),
        limit=limit.astype(float),
    )


def plain_host(lag_s):
    known = Drivetrains(GAIN, DEAD_ZONE, LIMIT, np.zeros(ROBOTS, dtype=bool))
    return WheelHost(A, SPEED, RADIUS, lag_s, known)


@pytest.mark.parametrize("lag_s", [0.0, 0.08])
def test_rounded_speeds_are_what_the_labs_host_sends_and_what_true_wheels_make_of_them(lag_s):
    host = plain_host(lag_s)
    truly = Drivetrains(TRUE_GAIN, TRUE_DEAD_ZONE, LIMIT, np.zeros(ROBOTS, dtype=bool))
    wheels, sent = trains(), SentRates.none(ROBOTS)
    for k in range(12):
        since_ns, acts_ns = k * SECOND // 40, (k + 2) * SECOND // 40
        heading, u = RNG.uniform(-3, 3, ROBOTS), RNG.uniform(-3, 3)
        wished = host.compute_speeds(heading, u, since_ns, acts_ns)
        counts = host.counts(wished)
        host.record_sent(acts_ns, wished)
        sent = sent.with_room()
        known = KnownRobots(A, SPEED, RADIUS, lag_s)
        directions = np.full(ROBOTS, u)
        speeds, true = compute_wheel_speeds(
            heading, directions, since_ns, acts_ns, known, sent, wheels
        )
        assert speeds == pytest.approx(host.drivetrains.speeds(counts))
        assert true == pytest.approx(truly.speeds(counts))


def test_speeds_that_are_not_rounded_are_sent_as_wished_and_scaled_by_the_true_gains():
    host = plain_host(0.0)
    heading = RNG.uniform(-3, 3, ROBOTS)
    wished = host.compute_speeds(heading, 0.4, 0, 0)
    known = KnownRobots(A, SPEED, RADIUS, 0.0)
    unrounded = trains(np.zeros(ROBOTS))
    args = (heading, np.full(ROBOTS, 0.4), 0, 0, known, SentRates.none(ROBOTS), unrounded)
    speeds, true = compute_wheel_speeds(*args)
    assert speeds.tolist() == wished.tolist()
    assert true == pytest.approx(TRUE_GAIN * wished)


def test_wheels_that_are_sent_nothing_stand_whatever_their_dead_zones():
    known = KnownRobots(A, np.zeros(ROBOTS), RADIUS, 0.0)
    heading = RNG.uniform(-3, 3, ROBOTS)
    args = (heading, heading.copy(), 0, 0, known, SentRates.none(ROBOTS), trains())
    speeds, true = compute_wheel_speeds(*args)
    assert not speeds.any()
    assert not true.any()


def test_the_compiled_motion_gives_the_bits_of_the_plain_one():
    starts = Poses(RNG.uniform(0, 900, ROBOTS), RNG.uniform(0, 900, ROBOTS), np.zeros(ROBOTS))
    plain, compiled = (WheeledRobots(starts, RADIUS, 0.05, 1e-8) for _ in range(2))
    compiled.roll = roll
    times_ns = np.arange(1, 40) * SECOND // 120
    ticks = times_ns % 2 == 0
    drawn = RNG.standard_normal((int(ticks.sum()), ROBOTS))
    targets = RNG.uniform(-200, 200, (2, ROBOTS))
    paths = []
    for robots in (plain, compiled):
        robots.targets[:] = targets
        robots.body[-1] = 1.0  # every heading swerves
        paths.append(robots.drive(0, times_ns, ticks, 0.1, drawn))
    assert paths[0].tolist() == paths[1].tolist()
