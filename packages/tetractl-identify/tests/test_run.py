"""Tests of passes of the compiled filter: what they find, and what they must not depend on."""

from dataclasses import replace

import numpy as np
import pytest
from tetractl_identify.passes import PassPrior, TrackFrames, run_filter
from tetractl_identify.tracks import Track

pytestmark = pytest.mark.slow

A = np.array([4.0, 2.5])
SPEED = np.array([100.0, 70.0])
DEAD_TIME_S = 0.15
LONG_S = 12.0
SENT_S = np.arange(0.0137, LONG_S, 0.3)  # never together with a frame
TAUS = np.array([0.05, 0.15, 0.25])
NOISE = (0.2, 0.01)


def driven(seed):
    """Frames of two robots that follow the same random directions, with some noise."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-2, 2, len(SENT_S))
    dt = 0.01
    times = np.arange(0, LONG_S, dt)
    newest = np.maximum(np.searchsorted(SENT_S, times - DEAD_TIME_S, side="right") - 1, 0)
    pose = np.zeros((2, 3))
    path = np.empty((len(times), 2, 3))
    for k, direction in enumerate(u[newest]):
        path[k] = pose
        turn = A * np.sin(direction - pose[:, 2]) * dt
        middle = pose[:, 2] + turn / 2
        pose = pose + np.column_stack(
            [SPEED * np.cos(middle) * dt, SPEED * np.sin(middle) * dt, turn]
        )
    poses = path[::5] + rng.normal(size=(len(path[::5]), 2, 3)) * [NOISE[0], NOISE[0], NOISE[1]]
    return TrackFrames.from_track(
        Track(
            source="p.csv",
            origin="CSV",
            unit="mm",
            names=("one", "two"),
            time_s=times[::5],
            poses=poses,
            valid=np.ones(poses.shape[:2], dtype=bool),
            sent_s=SENT_S,
            direction_rad=u,
            stop_s=LONG_S,
        )
    )


ONE, TWO = driven(1), driven(2)
BOTH = np.array([0, 1])


def prior(rows):
    """Wide assumptions about robots: their true values, half unknown."""
    rows = np.asarray(rows)
    count = len(rows)
    return PassPrior(
        mean=np.column_stack([np.log(A[rows]), np.log(SPEED[rows]), np.zeros(count)]),
        std=np.tile([0.5, 0.3, 0.2], (count, 1)),
        noise=np.tile(NOISE, (count, 1)),
        walk=np.tile([1.0, 0.02], (count, 1)),
    )


def test_the_true_dead_time_is_the_likeliest_and_the_true_values_are_found():
    passed = run_filter([ONE], BOTH, prior(BOTH), TAUS)
    assert passed.likelihood.shape == (3, 2)
    assert passed.likelihood.argmax(axis=0).tolist() == [1, 1]
    a, speed, bias = passed.mean[1].T
    assert np.exp(a) == pytest.approx(A, rel=0.1)
    assert np.exp(speed) == pytest.approx(SPEED, rel=0.05)
    assert bias == pytest.approx([0, 0], abs=0.05)
    assert (passed.std[1] < prior(BOTH).std / 3).all()


def test_rows_are_robots_in_any_order_and_number():
    whole = run_filter([ONE], BOTH, prior(BOTH), TAUS)
    rows = np.array([1, 0, 1])
    some = run_filter([ONE], rows, prior(rows), TAUS)
    assert some.likelihood == pytest.approx(whole.likelihood[:, rows])
    assert some.mean == pytest.approx(whole.mean[:, rows])
    assert some.std == pytest.approx(whole.std[:, rows])


def test_the_likelihoods_of_blocks_add_up_to_that_of_all_frames():
    whole = run_filter([ONE], BOTH, prior(BOTH), TAUS)
    blocks = np.minimum(np.arange(len(ONE.time_s)) // 50, 3)
    parts = run_filter([ONE], BOTH, prior(BOTH), TAUS, blocks=[blocks])
    assert parts.block_ln_likelihoods.shape == (4, 3, 2)
    assert parts.likelihood == pytest.approx(whole.likelihood)
    assert (np.abs(parts.block_ln_likelihoods) > 0).all()


def test_a_second_track_adds_to_what_the_first_one_showed():
    first = run_filter([ONE], BOTH, prior(BOTH), TAUS)
    both = run_filter([ONE, TWO], BOTH, prior(BOTH), TAUS)
    assert (both.std[1] < first.std[1]).all()
    blocks = [np.zeros(len(track.time_s), dtype=np.int64) + k for k, track in enumerate((ONE, TWO))]
    parts = run_filter([ONE, TWO], BOTH, prior(BOTH), TAUS, blocks=blocks)
    assert parts.block_ln_likelihoods[0] == pytest.approx(first.likelihood)
    assert parts.likelihood == pytest.approx(both.likelihood)


def test_a_clock_that_starts_elsewhere_changes_nothing_of_the_true_dead_time():
    later = replace(ONE, time_s=ONE.time_s + 100.0, sent_s=ONE.sent_s + 100.0)
    moved = run_filter([later], BOTH, prior(BOTH), TAUS)
    same = run_filter([ONE], BOTH, prior(BOTH), TAUS)
    assert moved.likelihood[1] == pytest.approx(same.likelihood[1], rel=1e-6)
    assert moved.mean[1] == pytest.approx(same.mean[1], rel=1e-6)


def test_residuals_and_lost_directions_are_collected_only_if_watched():
    plain = run_filter([ONE, TWO], BOTH, prior(BOTH), TAUS)
    assert plain.heading_residuals.size == 0
    assert plain.lost.tolist() == [0, 0]
    watched = run_filter([ONE, TWO], BOTH, prior(BOTH), TAUS, watched=True)
    assert watched.likelihood == pytest.approx(plain.likelihood)
    residuals = watched.heading_residuals
    assert residuals.shape == (len(ONE.time_s) + len(TWO.time_s), 2)
    used = np.concatenate([ONE.is_used, TWO.is_used])
    assert (np.isfinite(residuals) == used).all()
    assert np.nanstd(residuals) < 2 * NOISE[1]
    assert (watched.lost < 3).all()


def test_a_robot_that_misses_directions_is_found_to_have_lost_them():
    """Every fifth direction turns by far, and the robots go on with the one before."""
    u = ONE.direction_rad.copy()
    missed = np.arange(4, len(u), 5)
    u[missed] = u[missed - 1] + np.pi / 2
    followed = ONE.direction_rad.copy()
    followed[missed] = followed[missed - 1]
    watched = run_filter([replace(ONE, direction_rad=u)], BOTH, prior(BOTH), TAUS, watched=True)
    honest = run_filter([ONE], BOTH, prior(BOTH), TAUS, watched=True)
    assert (watched.lost > honest.lost + 2).all()
