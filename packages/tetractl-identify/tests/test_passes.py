"""Tests of the filter's passes over a track: which frames are used, and the noise and speed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_identify.passes import (
    FRAME_GAP_MIN_S,
    IDENTIFIED,
    RESTART_GAP_S,
    PassPrior,
    PassResult,
    TrackFrames,
    _begin_track,
    _ResidualCollector,
    _start_filter,
    compute_median_speeds,
    compute_speed_wander,
    count_driving_intervals,
    estimate_position_noise,
)
from tetractl_identify.tracks import Track

from tetractl.control.estimation.kernels.filter_state import LAG
from tetractl.core.errors import UsageError


def frames_of(poses, time, used=None):
    """M frames of N robots, all of them used."""
    count, robots = poses.shape[:2]
    return TrackFrames(
        time_s=np.repeat(np.asarray(time, dtype=float)[:, None], robots, axis=1),
        poses=poses,
        is_used=np.ones((count, robots), dtype=bool) if used is None else used,
        is_restart=np.zeros((count, robots), dtype=bool),
        sent_s=np.array([0.0]),
        direction_rad=np.array([0.0]),
        watchdog_s=np.inf,
        lag_s=0.0,
        hold_moments=(0.0, 0.0, 0.0),
    )


def straight(speed, time, heading=0.6):
    """Poses (M, 1, 3) of a robot that drives straight."""
    way = speed * np.asarray(time)
    heading = np.full(len(way), heading)
    poses = np.column_stack([way * np.cos(heading), way * np.sin(heading), heading])
    return poses[:, None]


@given(st.floats(0.01, 5), st.integers(0, 99))
def test_the_noise_of_positions_is_that_which_was_added(noise, seed):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.04, 0.06, 4000))
    poses = np.concatenate([straight(100.0, time), straight(30.0, time, -2.0)], axis=1)
    clean = frames_of(poses.copy(), time)
    assert estimate_position_noise([clean]) == pytest.approx([0.0, 0.0], abs=1e-9)
    poses[:, 0, :2] += rng.normal(0, noise, (len(time), 2))
    assert estimate_position_noise([frames_of(poses, time)]) == pytest.approx(
        [noise, 0.0], rel=0.08, abs=1e-9
    )


def test_frames_that_are_not_used_say_nothing_of_the_noise():
    time = np.arange(400) / 20
    poses = straight(100.0, time)
    used = np.arange(400)[:, None] % 10 != 4
    poses[~used[:, 0]] += 50.0
    assert estimate_position_noise([frames_of(poses, time, used)]) == pytest.approx([0.0], abs=1e-9)


@given(st.floats(1, 400), st.floats(0.2, 3))
def test_the_usual_speed_is_the_median_of_the_used_intervals(speed, factor):
    time = np.cumsum(np.random.default_rng(1).uniform(0.04, 0.08, 300))
    steady = frames_of(straight(speed, time), time)
    other = frames_of(straight(factor * speed, time[:50]), time[:50])
    assert compute_median_speeds([steady]) == pytest.approx([speed])
    # most intervals are of the first
    assert compute_median_speeds([other, steady]) == pytest.approx([speed])
    stands = replace(steady, is_used=np.zeros((300, 1), dtype=bool))
    assert np.isinf(compute_median_speeds([stands])).all()
    assert count_driving_intervals([steady, other, stands]).tolist() == [350]


def test_a_steady_speed_does_not_wander():
    time = np.arange(600) / 20
    assert compute_speed_wander([frames_of(straight(120.0, time), time)]) == pytest.approx(
        [0.0], abs=1e-9
    )
    short = frames_of(straight(120.0, time[:15]), time[:15])
    assert compute_speed_wander([short]).tolist() == [0.0]
    hidden = frames_of(straight(120.0, time), time, np.zeros((600, 1), dtype=bool))
    assert compute_speed_wander([hidden]).tolist() == [0.0]


def test_a_speed_that_differs_between_seconds_wanders_by_its_deviation():
    rng = np.random.default_rng(4)
    time = np.arange(20 * 400) / 20
    paces = np.repeat(100 * (1 + 0.1 * rng.normal(size=400)), 20)
    way = np.concatenate([[0.0], np.cumsum(paces[:-1] / 20)])
    poses = np.column_stack([way, 0 * way, 0 * way])[:, None]
    assert compute_speed_wander([frames_of(poses, time)]) == pytest.approx([0.1], rel=0.2)
    scaled = poses * [[[1000.0, 1000.0, 1.0]]]
    in_um = compute_speed_wander([frames_of(scaled, time)])
    assert in_um == pytest.approx(compute_speed_wander([frames_of(poses, time)]))


def test_a_robot_that_drives_circles_evenly_does_not_wander():
    time = np.arange(600) / 20
    heading = 0.4 + 1.7 * time
    x = 120.0 / 1.7 * np.sin(heading)
    y = -120.0 / 1.7 * np.cos(heading)
    poses = np.column_stack([x, y, np.arctan2(np.sin(heading), np.cos(heading))])[:, None]
    assert compute_speed_wander([frames_of(poses, time)]) == pytest.approx([0.0], abs=1e-9)


def test_the_time_in_which_lost_commands_stop_a_robot_is_no_wander():
    rng = np.random.default_rng(5)
    time = np.arange(20 * 200) / 20
    stops = np.repeat(rng.random(1000) < 0.1, 4)  # a fifth of a second each
    pace = np.where(stops, 0.0, 100.0)
    way = np.concatenate([[0.0], np.cumsum(pace[:-1] / 20)])
    poses = np.column_stack([way, 0 * way, 0 * way])[:, None]
    assert compute_speed_wander([frames_of(poses, time)])[0] < 0.06


def track(time, poses, valid=None, sent=(0.0, 5.0), lag=0.0, until=np.inf):
    count, robots = poses.shape[:2]
    return Track(
        source="made.csv",
        origin="a test",
        unit="mm",
        names=tuple("abc"[:robots]),
        time_s=np.asarray(time),
        poses=poses,
        valid=np.ones((count, robots), dtype=bool) if valid is None else valid,
        sent_s=np.array(sent),
        direction_rad=np.zeros(len(sent)),
        stop_s=until,
        lag_s=lag,
    )


def test_a_robot_is_used_from_where_it_drives_and_from_the_first_direction_to_the_stop():
    time = np.arange(0, 200) / 20
    poses = straight(100.0, np.maximum(time - 4.0, 0.0))  # it stands until 4 s
    frames = TrackFrames.from_track(track(time, poses, sent=(2.0, 3.0), until=9.0))
    assert frames.time_s[0, 0] == pytest.approx(2.0)
    assert frames.time_s[-1, 0] == pytest.approx(9.0)
    acts = frames.time_s[:, 0] > 4.0 + 1e-6
    assert (frames.is_used | frames.is_restart)[:, 0].tolist() == acts.tolist()
    assert frames.is_restart.sum() == 1
    lagging = TrackFrames.from_track(track(time, poses, sent=(2.0, 3.0), lag=0.1))
    first = lagging.time_s[lagging.is_used | lagging.is_restart].min()
    assert first == pytest.approx(4.05 - 0.3)  # where it certainly stands still


def test_frames_that_follow_too_soon_are_left_out_and_a_gap_starts_a_robot_anew():
    time = np.sort(np.concatenate([np.arange(0, 100) / 20, np.arange(0, 100) / 20 + 0.01]))
    poses = straight(100.0, time)
    valid = ~((time > 2.0) & (time < 2.0 + RESTART_GAP_S + 0.1))[:, None]
    frames = TrackFrames.from_track(track(time, poses, valid))
    assert np.diff(frames.time_s[:, 0]).min() >= FRAME_GAP_MIN_S - 1e-6
    placed_s = frames.time_s[frames.is_restart]
    assert len(placed_s) == 2
    assert placed_s[1] == pytest.approx(2.0 + RESTART_GAP_S + 0.1, abs=0.05)
    assert not (frames.is_used & frames.is_restart).any()
    brief = ~((time > 2.0) & (time < 2.0 + RESTART_GAP_S - 0.12))[:, None]
    assert TrackFrames.from_track(track(time, poses, brief)).is_restart.sum() == 1


def test_rates_that_lagging_wheels_keep_are_weighted_by_their_times():
    time = np.arange(0, 200) / 20
    poses = straight(100.0, time)
    sent = (0.0, 0.1, 0.4, 0.6)
    frames = TrackFrames.from_track(track(time, poses, sent=sent, lag=0.2))
    apart = np.array([0.1, 0.3, 0.2])
    expected = [np.sum(apart ** (power + 1)) / np.sum(apart) for power in (1, 2, 3)]
    assert frames.hold_moments == pytest.approx(expected)
    assert TrackFrames.from_track(track(time, poses, sent=sent)).hold_moments == (0.0, 0.0, 0.0)


def test_a_track_without_directions_is_refused():
    time = np.arange(0, 20) / 20
    with pytest.raises(UsageError, match=r"made\.csv: the log has no direction that was sent"):
        TrackFrames.from_track(track(time, straight(100.0, time), sent=()))


def test_a_robot_that_turns_in_some_seconds_and_not_in_others_does_not_wander():
    """Its steps are chords along the heading halfway, within 0.1 % of their arcs."""
    time = np.arange(40 * 20) / 20
    rate = np.where((time // 2) % 2 == 0, 0.0, 3.0)
    heading = np.concatenate([[0.0], np.cumsum(rate[:-1] / 20)])
    middle = heading[:-1] + rate[:-1] / 40
    steps = 5.0 * np.sinc(rate[:-1] / 40 / np.pi) * np.exp(1j * middle)
    path = np.concatenate([[0j], np.cumsum(steps)])
    poses = np.column_stack([path.real, path.imag, np.angle(np.exp(1j * heading))])[:, None]
    assert compute_speed_wander([frames_of(poses, time)])[0] < 2e-3


def test_a_block_counts_only_if_the_robot_was_measured_in_most_of_it():
    time = np.arange(20 * 60) / 20
    pace = np.where((time % 1.0 < 0.5) & (time // 1 % 2 == 0), 200.0, 100.0)
    way = np.concatenate([[0.0], np.cumsum(pace[:-1] / 20)])
    poses = np.column_stack([way, 0 * way, 0 * way])[:, None]
    whole = compute_speed_wander([frames_of(poses, time)])[0]
    fast_only = ((time // 1 % 2 == 1) | (time % 1.0 < 0.5))[:, None]
    assert whole > 0.2
    assert compute_speed_wander([frames_of(poses, time, fast_only)])[0] < 0.01


# what a watch of the filter collects, and how the filter begins

U = np.array([0.5, 1.5, 2.5])


def bank_of(newest, directions, weights, headings):
    """A bank of three dead times and one robot with three hypotheses, the last for none that fits.

    The dead time in the middle has these values; the others must not matter.
    """
    count = len(directions)
    direction = np.full((3, 1, count), 9.0)
    direction[1, 0] = directions
    ln_weight = np.full((3, 1, count), -1.0)
    with np.errstate(divide="ignore"):
        ln_weight[1, 0] = np.log(weights)
    state = np.full((3, 1, count, 3), 7.0)
    state[1, 0, :, 2] = headings
    return SimpleNamespace(
        dead_time_s=np.zeros((3, 1)),
        ln_weight=ln_weight,
        state=state,
        direction=direction,
        next_command=np.array([[0], [newest + 1], [0]]),
    )


def watched(*frames, used=True):
    watch = _ResidualCollector(U, 1)
    for bank, heading in frames:
        watch.add(bank, np.array([[0.0, 0.0, heading]]), np.array([used]))
    return watch


def test_a_residual_is_that_of_the_likeliest_hypothesis():
    bank = bank_of(0, [0.5, 0.5, 0.5], [0.2, 0.7, 0.1], [1.0, 2.0, 3.0])
    (residual,) = watched((bank, 2.3)).residuals
    assert residual == pytest.approx([0.3])
    (residual,) = watched((bank, 2.3 + 2 * np.pi)).residuals
    assert residual == pytest.approx([0.3])
    (residual,) = watched((bank, 2.3), used=False).residuals
    assert np.isnan(residual).all()


@pytest.mark.parametrize(
    ("directions", "weights", "lost"),
    [
        ([1.5, 0.5, 1.5], [0.9, 0.1, 0.0], 0.1),
        ([0.5, 1.5, 1.5], [0.9, 0.1, 0.0], 0.9),
        ([1.5, 1.5, 1.5], [0.9, 0.1, 0.0], 0.0),
        ([1.5, 1.5, 0.5], [0.5, 0.3, 0.2], 0.0),  # the last slot is of no command
    ],
)
def test_a_direction_is_lost_by_the_probability_that_another_one_is_followed(
    directions, weights, lost
):
    assert watched((bank_of(1, directions, weights, [0, 0, 0]), 0.0)).lost == pytest.approx([lost])


def test_the_last_frame_of_each_direction_counts_and_those_before_the_first_do_not():
    first = bank_of(0, [9.0, 0.5, 0.5], [0.6, 0.4, 0.0], [0, 0, 0])
    later = bank_of(0, [9.0, 0.5, 0.5], [0.2, 0.8, 0.0], [0, 0, 0])
    second = bank_of(1, [9.0, 1.5, 1.5], [0.3, 0.7, 0.0], [0, 0, 0])
    before = bank_of(-1, [9.0, 0.5, 0.5], [1.0, 0.0, 0.0], [0, 0, 0])
    assert watched((before, 0.0), (first, 0.0), (later, 0.0), (second, 0.0)).lost == pytest.approx(
        [0.2 + 0.3]
    )


PRIOR = PassPrior(
    mean=np.array([[1.0, 2.0, 0.1], [1.5, 2.5, 0.2]]),
    std=np.array([[0.3, 0.2, 0.1], [0.4, 0.5, 0.6]]),
    noise=np.array([[0.5, 0.01], [0.7, 0.02]]),
    walk=np.array([[3.0, 0.04], [5.0, 0.06]]),
)
TAUS = np.array([0.1, 0.2, 0.3])


def test_a_filter_begins_with_its_prior_for_each_dead_time():
    model, bank = _start_filter(PRIOR, TAUS)
    assert (bank.dead_time_s == TAUS[:, None]).all()
    for states in bank.state[:, :, 0]:
        assert states[:, IDENTIFIED] == pytest.approx(PRIOR.mean)
    variances = np.diagonal(bank.cov[0, :, 0], axis1=1, axis2=2)
    assert variances[:, IDENTIFIED] == pytest.approx(PRIOR.std**2)
    # positions along and across have the same noise and walk
    assert model.noise == pytest.approx(np.array([[0.5, 0.7], [0.5, 0.7], [0.01, 0.02]]))
    assert model.walk[:3] == pytest.approx(np.array([[3.0, 5.0], [3.0, 5.0], [0.04, 0.06]]))
    assert not model.walk[3:].any()


@pytest.mark.parametrize("lag", [0.0, 0.2])
def test_robots_stand_until_the_first_direction_only_if_their_wheels_lag(lag):
    time = np.arange(40) / 20
    frames = replace(
        frames_of(np.concatenate([straight(100.0, time)] * 2, axis=1), time),
        sent_s=np.array([0.3, 0.9]), direction_rad=np.array([0.7, 1.1]), watchdog_s=0.25, lag_s=lag,
    )  # fmt: skip
    _, bank = _start_filter(PRIOR, TAUS)
    _begin_track(bank, frames)
    assert np.exp(bank.ln_weight).sum(axis=2) == pytest.approx(np.ones((3, 2)))
    assert (bank.ln_weight[..., 0] == 0).all()
    assert (bank.state[..., LAG] == lag).all()
    if lag:
        assert np.isnan(bank.direction).all()
        assert (bank.next_command == 0).all()
    else:
        assert (bank.direction == 0.7).all()
        assert (bank.next_command == 1).all()
    assert bank.until_s[..., 0] == pytest.approx(np.repeat(TAUS[:, None] + 0.55, 2, axis=1))


def test_the_likelihood_is_the_sum_over_the_blocks():
    blocks = np.arange(12.0).reshape(3, 2, 2)
    nothing = np.zeros(0)
    assert (
        PassResult(blocks, nothing, nothing, nothing, nothing).likelihood.tolist()
        == (blocks[0] + blocks[1] + blocks[2]).tolist()
    )
