"""Robots identified from tracks made up for the tests: dead time, a, speed, noise."""

from dataclasses import replace

import numpy as np
import pytest
from support.paths import ROOT
from support.trials import three_robots

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import UsageError
from tetractl.experiment.load import load_spec
from tetractl.plant.simulation import SimPlant
from tetractl.replay.identification.fit import SampleInterval
from tetractl.replay.identification.identify import (
    IdentifiedRobots,
    RobotFound,
    identified,
    identify,
    stated,
    tables,
)
from tetractl.replay.identification.passes import TrackFrames
from tetractl.replay.identification.tracks import SETTLED_S, Track, track_of

pytestmark = pytest.mark.slow

EXPERIMENT = ROOT / "experiments" / "three_m3pi.yaml"
EXPECTED = np.array([6.0, 4.0, 3.0])
NOISY = (
    "plant.measurement_noise={position: 0.5, heading: 0.01}",
    "plant.heading_noise=0.03",
    "wheels.watchdog=null",  # at 5 Hz a lost command would stop a robot
)


def drive(seed, *sets, steps=50, period_s=0.2, directions=None):
    """Drive simulated robots in random directions, or in those given; return the plant and their
    track."""
    experiment = load_spec(EXPERIMENT, sets).experiment
    clock, setup = VirtualClock(), experiment.setup
    plant = SimPlant(experiment.plant, setup, clock, np.random.SeedSequence(seed))
    plant.open()
    samples, commands = [], []
    if directions is None:
        directions = np.random.default_rng(seed).uniform(-2, 2, steps)
    for k, u in enumerate(directions):
        clock.sleep_until(round(k * period_s * SECOND))
        plant.observe()
        command = plant.send(Steer(float(u)))
        samples += plant.samples()
        commands += [*plant.news(), command]
    clock.sleep_until(round(len(directions) * period_s * SECOND))
    stop = plant.stop()
    plant.settle()
    samples += plant.samples()
    commands += plant.news()
    seen = [one.observation for one in samples]
    return plant, Track(
        source="test",
        origin="simulation",
        unit="mm",
        names=setup.names,
        time=np.array([one.sampled_ns for one in seen]) / SECOND,
        poses=np.array([one.poses.array() for one in seen]),
        valid=np.array([one.valid for one in seen]),
        sent=np.array([one.sent_ns for one in commands]) / SECOND,
        u=np.array([one.direction for one in commands]),
        until=stop.sent_ns / SECOND,
        watchdog=setup.watchdog_s,
    )


def test_without_noise_everything_is_found_exactly():
    plant, track = drive(1, "plant.dead_time=0.083", "plant.a_error=0.25", "plant.speed_error=0.2")
    found = identify([track], EXPECTED)
    assert found.dead_time.value == pytest.approx(0.083, abs=2e-4)
    assert [one.a.value for one in found.robots] == pytest.approx(plant.a, rel=2e-3)
    assert [one.speed.value for one in found.robots] == pytest.approx(plant.speed, rel=1e-3)
    assert [one.heading_bias.value for one in found.robots] == pytest.approx([0] * 3, abs=2e-3)


def test_a_dead_time_beyond_the_first_search_is_found():
    """Regression: 0.36 s for 0.5 s, and an interval of a without the true one."""
    plant, track = drive(1, "plant.dead_time=0.5", "plant.a_error=0.25")
    found = identify([track], EXPECTED, None)
    assert found.dead_time.value == pytest.approx(0.5, abs=1e-3)
    assert [one.a.value for one in found.robots] == pytest.approx(plant.a, rel=5e-3)


def test_a_robot_that_stands_is_named():
    """Regression: a warning of NumPy."""
    _, track = drive(1)
    track.poses[:, 1] = track.poses[0, 1]
    with pytest.raises(UsageError, match="robot blue does not move"):
        identify([track], EXPECTED)


def test_robots_that_seem_to_turn_before_they_are_sent_a_direction_do_not_fit():
    _, track = drive(1)
    found = identify([replace(track, sent=track.sent + 0.3)], EXPECTED, None)
    assert all(robot.misfits for robot in found.robots)


@pytest.mark.long
@pytest.mark.parametrize("dead_time", [0.05, 0.2])
def test_noise_and_lost_commands_leave_the_truth_near_the_intervals(dead_time):
    sets = (*NOISY, f"plant.dead_time={dead_time}", "plant.a_error=0.2", "plant.lost_commands=0.05")
    plant, track = drive(3, *sets)
    found = identify([track], EXPECTED)
    intervals = [(found.dead_time, dead_time)]
    for i, robot in enumerate(found.robots):
        intervals += [
            (robot.a, plant.a[i]),
            (robot.speed, plant.speed[i]),
            (robot.heading_bias, 0.0),
            (robot.position_noise, 0.5),
            (robot.heading_noise, 0.01),
            (robot.heading_walk, 0.03),
        ]
        assert robot.a.high - robot.a.low < 0.1 * robot.a.value  # they say something
    for interval, truth in intervals:
        assert interval.low <= interval.value <= interval.high
        width = max(interval.high - interval.value, interval.value - interval.low)
        assert abs(interval.value - truth) <= 2 * width + 1e-4
    held = sum(interval.low <= truth <= interval.high for interval, truth in intervals)
    assert held >= 0.8 * len(intervals)


def test_intervals_that_hold_too_seldom_are_not_stated():
    robot = RobotFound("one", *[SampleInterval(0.0123, 0.01, 0.02)] * 6, 0, 100, ())
    found = IdentifiedRobots(
        "CSV", ("p.csv",), "mm", 9, SampleInterval(0.1, 0, 0.2), None, (robot,)
    )
    (table,) = tables(stated(found))
    text = str([*table.rows])
    assert text.count("0.0123 (0.0100 to 0.0200)") == 4 and text.count("'0.012'") == 2
    written = identified(stated(found), "now").robots["one"]
    assert (written.a.low, written.heading_noise.low, written.heading_walk.high) == (
        0.01,
        None,
        None,
    )


def test_a_lag_that_nothing_states_leaves_no_interval_of_what_it_may_spoil():
    """Regression: the tables of `export` said nothing of the wheels' lag, and `identify` printed
    2.78 (2.74 to 2.81) rad/s for a robot of 3.0."""
    value = SampleInterval(0.0123, 0.01, 0.02)
    fitting = RobotFound("one", *[value] * 6, 0, 100, ("across the path",))
    odd = replace(fitting, name="two", misfits=("heading",))
    bounded = IdentifiedRobots("CSV", ("p.csv",), "mm", 9, value, None, (fitting, fitting))
    told = stated(replace(bounded, robots=(fitting, odd), lag_unstated=True))
    for robot in told.robots:  # the dead time is that of both
        assert np.isnan([robot.a.low, robot.heading_bias.high, told.dead_time.low]).all()
        assert robot.speed == value
    (table,) = tables(told)
    assert "have no intervals" in table.note
    fits = stated(replace(bounded, lag_unstated=True))
    of_cells = stated(replace(bounded, robots=(fitting, odd)))
    for found in (fits, of_cells):
        assert found.robots[0].a == found.dead_time == value


def noise_is_right(*found):
    """Whether most intervals of the noise hold the truth of NOISY, and all are near it."""
    each = [
        (interval, truth)
        for one in found
        for robot in one.robots
        for interval, truth in (
            (robot.position_noise, 0.5), (robot.heading_noise, 0.01), (robot.heading_walk, 0.03)
        )
    ]  # fmt: skip
    near = [abs(one.value - truth) < 2 * (one.high - one.low) for one, truth in each]
    held = sum(one.low <= truth <= one.high for one, truth in each)
    return all(near) and held >= 7 / 9 * len(each)


@pytest.mark.long
def test_a_lost_command_that_stops_a_robot_by_its_watchdog_is_no_noise():
    sets = (*NOISY[:2], "plant.dead_time=0.08", "plant.lost_commands=0.05")
    found = [identify([drive(seed, *sets)[1]], EXPECTED) for seed in (9, 10, 11)]
    assert not any(robot.misfits for one in found for robot in one.robots)
    assert noise_is_right(*found)


@pytest.mark.long
def test_commands_that_follow_before_a_frame_tells_are_no_noise():
    """Directions as of a controller at 20 Hz: each sent four times, and most turn little."""
    rng = np.random.default_rng(6)
    turns = np.where(rng.uniform(size=50) < 0.15, rng.uniform(-2, 2, 50), 0.1 * rng.normal(size=50))
    sets = (*NOISY[:2], "plant.dead_time=0.08", "plant.lost_commands=0.05")
    _, track = drive(6, *sets, period_s=0.05, directions=np.repeat(np.cumsum(turns), 4))
    assert noise_is_right(identify([track], EXPECTED))


def test_robots_that_are_seen_at_times_of_their_own_have_one_dead_time():
    """Robots that measure their own poses: two of them earlier than the frame, by up to 0.1 s."""
    _, track = drive(1, "plant.dead_time=0.083")
    poses, own, late = track.poses.copy(), track.exposed.copy(), (0, 6, 12)
    for i, k in enumerate(late):
        poses[k:, i], own[k:, i] = track.poses[: len(poses) - k, i], track.time[: len(poses) - k]
    seen = replace(track, poses=poses, own=own)
    found = identify([seen], EXPECTED)
    assert found.dead_time.value == pytest.approx(0.083, abs=1e-3)
    assert [one.a.value for one in found.robots] == pytest.approx(EXPECTED, rel=0.01)
    assert not any(one.misfits for one in found.robots)


def test_the_lag_of_wheels_is_not_taken_for_a_dead_time():
    """Regression: logs of the bench gave a dead time 0.03 s too long, and a 6 % too low."""
    wheels = "plant.drive={rate: 40, lead: 0.0, lag: 0.04}"
    delay = "plant.disturbances=[{type: radio, delay: 0.01, jitter: 0.0, loss: 0.0}]"
    _, track = drive(2, "plant.camera_rate=120", "wheels.lag=0.04", wheels, delay, *NOISY)
    found = identify([replace(track, lag=0.04)], EXPECTED)
    assert found.dead_time.value == pytest.approx(0.01, abs=0.005)
    for robot, a in zip(found.robots, EXPECTED, strict=True):
        assert robot.a.value == pytest.approx(a, rel=0.04)


def test_robots_with_lagging_wheels_are_followed_from_where_they_stand():
    """Regression: how fast they turned amid their start was guessed, which cost the fit of one log
    in ten its dead time."""
    wheels = "plant.drive={rate: 40, lead: 0.0, lag: 0.04}"
    _, track = drive(2, "plant.camera_rate=120", "wheels.lag=0.04", wheels, steps=5)
    rolling, lagging = TrackFrames.of(track), TrackFrames.of(replace(track, lag=0.04))
    assert not rolling.placed[0].any()
    assert lagging.placed[0].all() and lagging.used[1:].all()
    assert 0.025 <= lagging.hold[0] <= 0.05  # at 40 Hz and at each new direction
    assert lagging.hold[1] >= lagging.hold[0] ** 2


def test_lost_commands_are_counted():
    _, track = drive(8, *NOISY, "plant.dead_time=0.06", "plant.lost_commands=0.1")
    found = identify([track], EXPECTED)
    assert 6 <= sum(robot.lost for robot in found.robots) <= 25  # of 150, 15 expected


def test_a_is_found_where_nothing_is_expected():
    _, track = drive(4, *NOISY, "plant.dead_time=0.1")
    found = identify([track], None)
    assert [one.a.value for one in found.robots] == pytest.approx([6, 4, 3], rel=0.03)


@pytest.mark.long
def test_pooled_tracks_tell_more_than_one():
    tracks = [drive(seed, *NOISY, "plant.dead_time=0.1")[1] for seed in (1, 2)]
    one, both = identify(tracks[:1], EXPECTED), identify(tracks, EXPECTED)
    assert both.commands == 100
    assert sum(robot.lost for robot in one.robots) == 0
    for less, more in zip(one.robots, both.robots, strict=True):
        assert more.a.high - more.a.low < 0.8 * (less.a.high - less.a.low)


def test_frames_that_did_not_see_a_robot_are_left_out():
    _, track = drive(6, *NOISY, "plant.dead_time=0.1")
    track.valid[300:500, 1] = False
    track.poses[300:500, 1] = 1e6  # garbage that must not be read
    found = identify([track], EXPECTED)
    assert found.robots[1].a.value == pytest.approx(4, rel=0.03)
    assert found.robots[1].intervals < found.robots[0].intervals


def test_too_little_and_other_robots_are_refused():
    _, track = drive(6, steps=3)
    with pytest.raises(UsageError, match="intervals between frames"):
        identify([track], EXPECTED)
    other = Track(
        **{name: getattr(track, name) for name in Track.__dataclass_fields__}
        | {"names": ("a", "b", "c")}
    )
    with pytest.raises(UsageError, match="robots or length unit differ"):
        identify([track, other], EXPECTED)


def test_a_model_that_does_not_fit_is_told():
    """A robot that turns faster to one side, by half as much again."""
    _, track = drive(5, *NOISY, "plant.dead_time=0.1")
    found = identify([track], EXPECTED)
    assert not any(robot.misfits for robot in found.robots)
    assert "the model fits" in tables(found)[0].note
    turned = np.diff(track.poses[:, 1, 2], prepend=track.poses[0, 1, 2])
    track.poses[:, 1, 2] += 0.5 * np.cumsum(np.maximum(turned, 0.0))
    wrong = identify([track], EXPECTED)
    assert "heading" in wrong.robots[1].misfits
    assert "the model does not fit" in tables(wrong)[0].note


def test_poses_of_a_pause_are_not_used():
    log = three_robots()
    stop = replace(log.stop, sent_ns=log.steps[9].command.sent_ns + SECOND // 10)
    drives_ns = log.steps[10].command.sent_ns + SETTLED_S * SECOND
    paused = (log.mocap_ns >= stop.sent_ns) & (log.mocap_ns < drives_ns)
    track = track_of(replace(log, commands=(*log.commands, stop)))
    assert 0 < paused.sum() < len(paused)
    assert np.array_equal(track.valid, log.valid & ~paused[:, None])
