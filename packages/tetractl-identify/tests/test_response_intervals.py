"""Tests of the parts of a fitted response: noise, curvatures, and the ends of intervals."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_identify.response import (
    PRIOR_STD,
    TIME_RESOLUTION_S,
    UNKNOWN,
    UNKNOWN_S,
    _create_lag_interval,
    _create_log_normal_interval,
    _dead_time,
    _invert_curvature,
    _noise,
    _normal,
)
from tetractl_identify.robot_response import LAG_MIN_S

NORMAL = 1.96


def ends(interval):
    return interval.low, interval.high


def test_a_normal_interval_reaches_as_far_to_either_side():
    interval = _normal(3.0, 0.5)
    assert interval.value == 3.0
    assert ends(interval) == pytest.approx((3 - NORMAL * 0.5, 3 + NORMAL * 0.5))
    assert ends(_normal(3.0, math.inf)) == (-math.inf, math.inf)


def test_the_interval_of_a_logarithm_reaches_by_the_same_factor():
    interval = _create_log_normal_interval(3.0, 0.5)
    factor = math.exp(NORMAL * 0.5)
    assert interval.value == 3.0
    assert ends(interval) == pytest.approx((3 / factor, 3 * factor))
    just_known = _create_log_normal_interval(3.0, UNKNOWN / NORMAL * 0.999)
    assert math.isfinite(just_known.high)
    assert just_known.low > 0
    assert ends(_create_log_normal_interval(3.0, UNKNOWN / NORMAL * 1.001)) == (0.0, math.inf)


def test_a_dead_time_that_nothing_limits_has_no_ends():
    known = _dead_time(0.1, UNKNOWN_S / NORMAL * 0.999)
    assert ends(known) == pytest.approx((0.1 - UNKNOWN_S, 0.1 + UNKNOWN_S), rel=0.01)
    assert ends(_dead_time(0.1, UNKNOWN_S / NORMAL * 1.001)) == (-math.inf, math.inf)


def test_no_time_is_known_better_than_recordings_resolve():
    assert ends(_dead_time(0.1, 0.0)) == pytest.approx(
        (0.1 - NORMAL * TIME_RESOLUTION_S, 0.1 + NORMAL * TIME_RESOLUTION_S)
    )
    assert ends(_dead_time(0.1, 3e-3))[1] == pytest.approx(
        0.1 + NORMAL * math.hypot(3e-3, TIME_RESOLUTION_S)
    )
    lag = _create_lag_interval(0.1, 0.0)
    assert lag.high == pytest.approx(0.1 * math.exp(NORMAL * TIME_RESOLUTION_S / 0.1))
    assert lag.low == pytest.approx(0.1 * math.exp(-NORMAL * TIME_RESOLUTION_S / 0.1))


def test_the_interval_of_the_shortest_lag_begins_at_0():
    assert _create_lag_interval(LAG_MIN_S, 0.1).low == 0.0
    assert _create_lag_interval(2 * LAG_MIN_S, 0.1).low == 0.0
    assert _create_lag_interval(2.1 * LAG_MIN_S, 0.1).low > 0
    assert _create_lag_interval(LAG_MIN_S, 0.1).high > LAG_MIN_S


def test_a_curvature_is_inverted():
    curvature = np.array([[4.0, 1.0], [1.0, 3.0]])
    assert _invert_curvature(curvature) == pytest.approx(np.linalg.inv(curvature))


def test_a_hollow_or_flat_direction_counts_by_its_magnitude_or_as_the_prior():
    hollow = _invert_curvature(np.diag([-4.0, 2.0]))
    assert hollow == pytest.approx(np.diag([0.25, 0.5]))
    flat = _invert_curvature(np.diag([0.0, 2.0]))
    assert flat == pytest.approx(np.diag([PRIOR_STD**2, 0.5]))


COUNT = 4000


def measured(noise, walk=0.0, seed=5):
    """Steps that follow their commands, between poses with noise, and the steps themselves."""
    rng = np.random.default_rng(seed)
    driven = rng.uniform(1, 3, (COUNT, 2))
    poses = rng.normal(0, noise, COUNT + 1)
    steps = driven @ [0.9, 0.1] + np.diff(poses) + rng.normal(0, walk, COUNT)
    return SimpleNamespace(neighbours=np.ones(COUNT - 1, dtype=bool)), steps, driven


@pytest.mark.parametrize(("noise", "walk"), [(0.01, 0.0), (0.3, 0.0), (0.3, 0.2)])
def test_the_noise_of_poses_shows_in_neighbouring_steps(noise, walk):
    steps, ways, driven = measured(noise, walk)
    assert _noise(steps, ways, driven) == pytest.approx(noise, rel=0.15)


def test_a_walk_alone_is_no_noise_of_poses():
    steps, ways, driven = measured(0.0, 0.3)
    assert _noise(steps, ways, driven) < 0.07


def test_outliers_do_not_count_as_noise():
    steps, ways, driven = measured(0.1)
    ways[100:COUNT:400] += 50.0
    assert _noise(steps, ways, driven) == pytest.approx(0.1, rel=0.2)


def test_only_steps_that_share_a_pose_show_its_noise():
    steps, ways, driven = measured(0.1)
    steps.neighbours[::2] = False
    assert _noise(steps, ways, driven) == pytest.approx(0.1, rel=0.15)
    steps.neighbours[:] = False
    assert _noise(steps, ways, driven) == 0.0
