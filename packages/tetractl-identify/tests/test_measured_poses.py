"""Tests that find false poses of a tracker, and the angle between headings and motion."""

import numpy as np
import pytest
from tetractl_identify.measured_poses import measured

from tetractl.core.poses import wrap

RATE_HZ = 20
SPEED_MM_S = 100.0
DRIVE_S = 60


def drive(seed=0, rate_hz=RATE_HZ, speed=SPEED_MM_S, noise=1.0):
    """Times and poses (M, 3) of a robot that turns at a new rate each second."""
    rng = np.random.default_rng(seed)
    times = np.arange(DRIVE_S * rate_hz) / rate_hz
    turn_rate = np.repeat(rng.uniform(-1.2, 1.2, DRIVE_S), rate_hz)
    heading = np.cumsum(turn_rate) / rate_hz
    way = speed / rate_hz * np.exp(1j * heading)
    place = np.cumsum(way)
    poses = np.column_stack([2000 + place.real, place.imag, heading])
    return times, poses + noise * rng.normal(size=poses.shape) * (0.2, 0.2, 0.003)


# ---- Poses that are no measurement ----


def repeat_last(poses, begin, count):
    poses[begin : begin + count] = poses[begin - 1]


def zeros_of_lost(poses, begin, count):
    poses[begin : begin + count] = 0.0


def heading_of_zeros(poses, begin, count):
    poses[begin : begin + count, 2] = 0.0


def place_of_last(poses, begin, count):
    poses[begin : begin + count, :2] = poses[begin - 1, :2]


def turned(angle):
    def turn(poses, begin, count):
        poses[begin : begin + count, 2] += angle

    return turn


def elsewhere(poses, begin, count):
    poses[begin : begin + count, :2] += (900.0, 400.0)


WRONG = {
    "frozen for 0.2 s": (repeat_last, 4),
    "frozen for a second": (repeat_last, 20),
    "frozen for 2 s": (repeat_last, 40),
    "places frozen for half a second": (place_of_last, 10),
    "places frozen for 2 s": (place_of_last, 40),
    "a zero": (zeros_of_lost, 1),
    "zeros for a second": (zeros_of_lost, 20),
    "headings of 0 for a second": (heading_of_zeros, 20),
    "half a turn": (turned(np.pi), 1),
    "half a turn, thrice": (turned(np.pi), 3),
    "a quarter turn": (turned(np.pi / 2), 2),
    "a third of a turn": (turned(-2 * np.pi / 3), 1),
    "another body": (elsewhere, 10),
}


@pytest.mark.parametrize("case", WRONG)
def test_poses_that_are_no_measurement_are_left_out(case):
    spoil, count = WRONG[case]
    times, poses = drive()
    begins = np.arange(100, len(times) - 100, 200)
    wrong = np.zeros(len(times), dtype=bool)
    for begin in begins:
        spoil(poses, begin, count)
        wrong[begin : begin + count] = True
    kept = measured(times, poses)
    assert not kept[wrong].any()
    assert kept[~wrong].mean() > 0.99


@pytest.mark.parametrize(
    ("added", "share", "kept_share"),
    [
        ((0.0, 0.0, np.pi), 0.05, 0.02),
        ((0.0, 0.0, np.pi), 0.2, 0.02),
        ((900.0, 400.0, 0.0), 0.05, 0.0),
        ((900.0, 400.0, 0.0), 0.1, 0.0),
    ],
    ids=["one heading in twenty", "one in five", "one place in twenty", "one in ten"],
)
@pytest.mark.parametrize("rate_hz", [10, 20, 60])
def test_poses_that_are_wrong_at_random_are_left_out(added, share, kept_share, rate_hz):
    """Regression: np.unwrap turned the robot for good, turning gain -3.31 for 0.95; and of one pose
    in twenty at another place none was left out, as their ways counted as usual ones."""
    times, poses = drive(rate_hz=rate_hz)
    is_wrong = np.random.default_rng(1).uniform(size=len(times)) < share
    poses[is_wrong] += added
    poses[is_wrong, 2] = wrap(poses[is_wrong, 2])
    kept = measured(times, poses)
    assert kept[is_wrong].mean() <= kept_share
    assert kept[~is_wrong].mean() > 0.98


def stop_and_go(poses):
    """The robot stands for a second and drives on, its pose the same to the last digit."""
    poses[220:, :] = np.vstack([np.tile(poses[220], (20, 1)), poses[220:-20]])
    return poses


def straight_at_the_end(poses):
    way = SPEED_MM_S / RATE_HZ * np.arange(100)
    x, y, heading = poses[-100]
    poses[-100:, 0] = x + way * np.cos(heading)
    poses[-100:, 1] = y + way * np.sin(heading)
    poses[-100:, 2] = heading
    return poses


def turns_and_goes(poses):
    """The robot turns at one place to the last digit for 2 s of each 10, and in the last 3."""
    drives = np.arange(len(poses)) // RATE_HZ % 10 < 8
    drives[-3 * RATE_HZ :] = False
    way = np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]) * drives[:, None]
    return np.column_stack([poses[0, :2] + np.cumsum(way, axis=0), poses[:, 2]])


def in_centimetres(poses):
    return np.round(poses / (10, 10, 0.01)) * (10, 10, 0.01)


def stands_mostly(poses):
    """The robot drives in 2 s of each 10; its places differ by noise while it stands."""
    drives = np.arange(len(poses)) // RATE_HZ % 10 < 2
    steps = np.diff(poses, axis=0, prepend=poses[:1]) * drives[:, None]
    noise = 0.2 * np.random.default_rng(2).normal(size=(len(poses), 2))
    poses = poses[0] + np.cumsum(steps, axis=0)
    poses[:, :2] += noise
    return poses


def one_dash(poses):
    """It drives three times as fast for a second."""
    way = np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2])
    way[400:420] *= 3
    return np.column_stack([poses[0, :2] + np.cumsum(way, axis=0), poses[:, 2]])


def in_half_mm(poses):
    return np.round(poses / (0.5, 0.5, 0.01)) * (0.5, 0.5, 0.01)


def each_five_times(poses):
    """A camera of 20 Hz in a table of 100 Hz."""
    return np.repeat(poses[::5], 5, axis=0)


RIGHT = {
    "as it is": {},
    "without noise": {"noise": 0.0},
    "straight on at the end, without noise": {"noise": 0.0, "change": straight_at_the_end},
    "stop and go, without noise": {"noise": 0.0, "change": stop_and_go},
    "turns and goes": {"noise": 0.0, "change": turns_and_goes},
    "places in cm, slow": {"speed": 20.0, "change": in_centimetres},
    "places in cm": {"change": in_centimetres},
    "places in cm, at 5 Hz": {"rate_hz": 5, "change": in_centimetres},
    "rounded, at 200 Hz": {"rate_hz": 200, "change": in_half_mm},
    "stands mostly": {"change": stands_mostly},
    "stands mostly, slow": {"speed": 30.0, "change": stands_mostly},
    "one dash": {"change": one_dash},
    "each pose five times": {"rate_hz": 100, "change": each_five_times},
    "slow, much noise": {"speed": 3.0, "noise": 3.0},
    "fast, at 5 Hz": {"rate_hz": 5, "speed": 400.0},
}


@pytest.mark.parametrize("case", RIGHT)
def test_right_poses_are_kept(case):
    how = dict(RIGHT[case])
    change = how.pop("change", lambda poses: poses)
    times, poses = drive(**how)
    assert measured(times, change(poses)).mean() >= 0.99


# ---- The angle ----


def test_poses_that_are_stamped_late_are_kept():
    """Regression: two poses 1 ms apart were a jump, as of a robot that was carried."""
    times, poses = drive()
    late = np.arange(10, len(times) - 1, 30)
    times[late] = times[late + 1] - 1e-3
    assert measured(times, poses).all()


def test_noise_as_large_as_the_distance_between_two_frames_makes_no_jump():
    times, poses = drive(noise=30.0)
    assert measured(times, poses).mean() > 0.99
