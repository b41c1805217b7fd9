import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.core.poses import Poses
from tetractl.model.motion.exact import step as exact
from tetractl.model.motion.rolling import note, wheel_speeds, wish
from tetractl.model.wheels import (
    Drivetrains,
    SentRates,
    WheeledRobots,
    WheelHost,
    body_velocity,
)
from tetractl.plant import wheel_kernel as kernels

pytestmark = pytest.mark.slow


def test_the_papers_robot_by_hand():
    left, right = wheel_speeds(math.sin(math.pi / 2), np.array([6.0]), np.array([180.0]), 40)
    assert (left[0], right[0]) == (180 - 240, 180 + 240)  # (24), (25)
    assert body_velocity(left, right, 40) == (180, 6)  # (21)-(23)


@given(
    heading=st.floats(-10, 10),
    u=st.floats(-10, 10),
    a=st.floats(0.1, 20),
    v=st.floats(0, 500),
    r=st.floats(1, 100),
)
def test_the_wheels_turn_a_robot_like_a_cell(heading, u, a, v, r):
    left, right = wheel_speeds(math.sin(u - heading), np.array([a]), np.array([v]), r)
    speed, turning = body_velocity(left, right, r)
    assert speed[0] == pytest.approx(v, abs=1e-9)
    assert turning[0] == pytest.approx(a * math.sin(u - heading), abs=1e-9)  # (3)


def headings_at_rest(lag_s, sent, frames, until):
    """Headings (N,) for which `wish` computes wheel speeds, for each frame: time and headings."""
    sent_rates = SentRates.none(2)
    parameters = np.ones((3, 2))
    for when, rates in sent:
        sent_rates = sent_rates.with_room()
        note(when, np.array([-rates, rates]), parameters, *sent_rates)
    headings = []
    for since, heading in frames:
        args = (True, since, until, parameters, lag_s, *sent_rates)
        sine, cosine = (
            np.diff(wish(heading, np.full(2, u), *args), axis=0)[0] / 2 for u in (0.0, np.pi / 2)
        )
        headings.append(np.arctan2(-sine, cosine))
    return headings


def test_headings_ahead_are_those_in_which_lagging_robots_come_to_rest():
    """Turning rates sent at uneven times, followed with a lag, against an integration at 10 kHz."""
    rng = np.random.default_rng(4)
    lag_s = 0.04
    step = 1e-4
    sent = {0.05: rng.normal(size=2), 0.08: rng.normal(size=2), 0.15: rng.normal(size=2)}
    heading = np.zeros(2)
    turning = np.zeros(2)
    wanted = np.zeros(2)
    headings = []
    for k in range(6000):
        wanted = sent.get(round(k * step, 4), wanted if k < 2000 else np.zeros(2))
        headings.append(heading)
        heading = heading + step * turning
        turning = turning + step / lag_s * (wanted - turning)
    moments = (0.02, 0.07, 0.12, 0.16)
    times = [round(value * SECOND) for value in sent]
    commands = list(zip(times, sent.values(), strict=True))
    frames = [(round(when * SECOND), headings[round(when / step)]) for when in moments]
    rest_headings = headings_at_rest(lag_s, commands, frames, SECOND // 5)
    for value in rest_headings:
        assert value == pytest.approx(headings[-1], abs=2e-3)


def test_headings_ahead_without_a_lag_fall_to_the_direction_by_3():
    parameters = np.array([[6.0, 3.0], [180.0, 150.0], [40.0, 40.0]])
    heading = np.array([0.3, -2.0])
    wished = wish(
        heading,
        np.full(2, 1.2),
        True,
        0,
        SECOND // 50,
        parameters,
        0.0,
        *SentRates.none(2),
    )
    _, _, ahead = exact(0.0, 0.0, heading, 1.2, parameters[0], parameters[1], 0.02)
    assert wished == pytest.approx(
        np.array(wheel_speeds(np.sin(1.2 - ahead), *parameters)), abs=1e-9
    )


def robots(rng, count):
    """A host's robots with uneven wheels, as calibrated and as they are, and poses."""
    gain = rng.uniform(5, 9, (2, count))
    zone = rng.integers(0, 8, (2, count))
    limit = rng.integers(60, 128, count)
    swap = np.zeros(count, np.bool_)
    return Drivetrains(gain, zone, limit, swap), rng.uniform(-3, 3, (3, count))


@pytest.mark.parametrize("lag_s", [0.0, 0.04])
def test_a_simulated_host_computes_the_bits_of_the_labs_host(lag_s):
    rng = np.random.default_rng(5)
    count = 3
    parameters = np.array(
        [rng.uniform(2, 6, count), rng.uniform(100, 300, count), np.full(count, 40.0)]
    )
    trains, _ = robots(rng, count)
    wrong = Drivetrains(2 * trains.gain, trains.dead_zone + 1, trains.limit, trains.swap)
    host = WheelHost(*parameters, lag_s, trains)
    rows = np.array(
        [
            0 * trains.gain,
            trains.gain,
            trains.dead_zone,
            wrong.gain,
            wrong.dead_zone,
            trains.limit + 0 * trains.gain,
        ]
    )
    rates = SentRates.none(count)
    for k in range(40):
        now = (k + 1) * SECOND // 40
        since = k * SECOND // 40 + 3_000_000
        heading = rng.uniform(-3, 3, count)
        u = rng.uniform(-3, 3)
        drives = k % 5 > 0
        rates = rates.with_room()
        speeds = np.empty((2, 2, count))
        towards = np.full(count, u)
        kernels.answer(
            heading, towards, drives, since, now, parameters, lag_s, *rates, rows, speeds
        )
        wished = host.wished(heading, u, since, now, drives)
        host.sent(now, wished)
        sent = host.counts(wished)
        assert speeds[0].tolist() == trains.speeds(sent).tolist()
        assert speeds[1].tolist() == wrong.speeds(sent).tolist()


def test_the_path_is_that_of_an_integration_in_any_division_into_calls():
    """By the midpoints of steps of 0.1 ms."""
    rng = np.random.default_rng(6)
    lag_s = 0.04
    radius = np.full(3, 40.0)
    pose, wheels, targets = (
        rng.normal(size=(3, 3)),
        rng.normal(size=(2, 3)),
        rng.normal(size=(2, 3)),
    )
    wheels = 100 * wheels
    targets = 100 * targets
    times = np.arange(1, 201) * SECOND // 1000
    pose_now = pose
    step = 1e-4
    expected = []
    for k in range(2000):
        decay = math.exp(-(k + 0.5) * step / lag_s)
        speed, turning = body_velocity(*(targets + (wheels - targets) * decay), radius)
        course = pose_now[2] + turning * step / 2
        pose_now = pose_now + step * np.array(
            [speed * np.cos(course), speed * np.sin(course), turning]
        )
        expected.append(pose_now)
    end = targets + (wheels - targets) * math.exp(-0.2 / lag_s)
    paths = []
    for parts in (1, 7):
        for roll in (WheeledRobots.roll, kernels.roll):
            fleet = WheeledRobots(Poses(*pose), radius, lag_s, 1e-9)
            fleet.roll = roll
            fleet.wheels[:] = wheels
            fleet.targets[:] = targets
            since = 0
            counts = []
            for part in np.array_split(times, parts):
                counts.append(fleet.drive(since, part))
                since = part[-1]
            paths.append(np.concatenate(counts))
            assert paths[-1] == pytest.approx(np.array(expected[9::10]), abs=1e-4)
            assert fleet.wheels == pytest.approx(end, abs=1e-9)
    assert all(path.tobytes() == paths[0].tobytes() for path in paths)
